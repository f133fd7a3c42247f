"""The runner of studies: bounds, verdicts and the table of all."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import json
from collections.abc import Sequence
from pathlib import Path

import pytest

from hydroopt.machine.machine_file import bundled
from studies.__main__ import FAILS, HERE, HOLDS, QUICK, Row, checked, markdown, rows
from studies.chains import run as chains
from studies.chains.jobs import Job, Outcome


@pytest.mark.parametrize(("value", "limits", "bound", "verdict"), [
    (0.3, {"max": 0.5, "min": 0.1, "why": "measured"}, "≤ 0.5, ≥ 0.1", HOLDS), (0.3, {"max": 0.2}, "≤ 0.2", FAILS),
    (True, {"equals": True}, "= True", HOLDS), (None, {"min": 0}, "≥ 0", FAILS), (3, {}, "", HOLDS),
    (2, {"min": 3, "expected_failure": "one seed"}, "≥ 3", "expected failure: one seed")])
def test_a_value_is_held_against_its_bounds(value: object, limits: dict, bound: str, verdict: str) -> None:
    assert checked(value, limits) == (bound, verdict)


@pytest.mark.parametrize(("code", "expected"), [
    ("return {'b': 2, 'a': 1}", [("a", 1, HOLDS), ("b", 2, "")]), ("return {}", [("a", None, FAILS)]),
    ("return None", [("all", None, "skipped: a data set or a tool that it needs is missing")]),
    ("1 / 0", [("all", None, f"{FAILS}: ZeroDivisionError")])])
def test_a_study_gives_rows_whatever_happens(code: str, expected: list, tmp_path: Path) -> None:
    (tmp_path / "run.py").write_text(f"def run():\n    {code}\n")
    (tmp_path / "expected.json").write_text(json.dumps({"a": {"equals": 1}}))
    assert [(row.quantity, row.value, row.verdict) for row in rows(tmp_path)] == expected


def test_a_part_of_a_study_is_held_against_its_own_bounds(tmp_path: Path) -> None:
    (tmp_path / "run.py").write_text("def run(*parts):\n    return {part: len(part) for part in parts or 'ab'}\n")
    (tmp_path / "expected.json").write_text(json.dumps({"a": {"equals": 1}, "b": {"equals": 3}}))
    assert [(row.quantity, row.verdict) for row in rows(tmp_path)] == [("a", HOLDS), ("b", FAILS)]
    assert [(row.quantity, row.verdict) for row in rows(tmp_path, ["a"])] == [("a", HOLDS)]


def test_every_bundled_machine_has_a_bound_in_the_study_of_all_jobs() -> None:
    assert set(bundled()) <= json.loads((HERE / "chains" / "expected.json").read_text("utf-8")).keys()


def test_what_a_machine_gave_is_kept_while_code_and_machine_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                                 capsys: pytest.CaptureFixture[str]) -> None:
    ran: list[str] = []

    def outcomes(jobs: Sequence[Job], folder: Path) -> list[Outcome]:
        ran.append(jobs[0].command[-3])
        return [Outcome("show", 2, "", 1.0, "no such machine")]

    monkeypatch.setattr(chains, "OUT", tmp_path)
    monkeypatch.setattr(chains, "outcomes", outcomes)
    monkeypatch.setattr(chains, "_code", lambda: b"this code")
    assert chains.run("ur10", "kr300")["kr300"] == "show refused"
    assert chains.run("ur10", "kr300", "ur10e")["kr300"] == "show refused"
    assert ran == ["ur10", "kr300", "ur10e"]
    monkeypatch.setattr(chains, "_code", lambda: b"other code")
    chains.run("ur10")
    assert ran[3:] == ["ur10"]


def test_the_seconds_of_a_study_stand_once() -> None:
    table = markdown([Row("one", "a", 0.5, "≤ 1", HOLDS, 3.2), Row("one", "b", None, "", FAILS, 3.2)])
    assert table.splitlines()[2:] == ["| one | a | 0.5 | ≤ 1 | holds | 3 |", "| one | b |  |  | **fails** |  |"]


def test_quick_studies_exist_and_all_have_bounds() -> None:
    there = {path.parent.name for path in HERE.glob("*/run.py")}
    assert set(QUICK) <= there
    assert there == {path.parent.name for path in HERE.glob("*/expected.json")}


def test_studies_import_what_exists() -> None:
    wrong = []
    for file in sorted(HERE.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and str(node.module).partition(".")[0] in ("hydroopt", "studies"):
                module = importlib.import_module(str(node.module))
                for name in (alias.name for alias in node.names if not hasattr(module, alias.name)):
                    if importlib.util.find_spec(f"{node.module}.{name}") is None:
                        wrong.append(f"{file.relative_to(HERE)}: {node.module}.{name}")
    assert not wrong
