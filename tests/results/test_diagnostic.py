"""A diagnostic states itself; a terminal shows those of the data apart, and folds groups into one line."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from string import Formatter

import pytest

import hydroopt
from hydroopt.results.diagnostic import Diagnostic, Meaning
from hydroopt.results.verdict import noted

NO_VALIDATION = Diagnostic("no validation data", (), {}, "No log was held out.")


def groups(*several: tuple[str, ...]) -> list[Diagnostic]:
    return [Diagnostic.of("not separable", names, {"effects": "gravity", "variance_inflation": 200.0},
                          "Not separable: {effects} ({subject}).", "Only together: reverse the motion.",
                          Meaning.PROPERTY) for names in several]


@pytest.mark.parametrize("meaning", Meaning)
def test_what_contradicts_an_answer_is_not_a_property_of_its_machine(meaning: Meaning) -> None:
    found = Diagnostic("a", (), {}, "", meaning=meaning)
    assert not (found.contradicts and found.about_machine)


def test_notes_of_one_kind_are_one_line_with_their_number() -> None:
    found = [*groups(("boom.m", "stick.m"), ("boom.mc_x", "boom.mc_y", "stick.mc_x")), NO_VALIDATION]
    first, *others = noted(found, "", 200, 10)
    assert " ".join(first.split()) == "note No log was held out."
    assert " ".join(" ".join(others).split()) == (
        "note Not separable: gravity (boom.m, stick.m). One more like it. Only together: reverse the motion.")


def test_contradictions_are_all_printed_but_not_twice() -> None:
    wrong = [Diagnostic("misread", (name,), {}, f"{name} is reversed.", "Turn it.", Meaning.CONTRADICTION)
             for name in ("boom.q", "stick.q", "swing.q")]
    notes = [Diagnostic(str(k), (), {}, f"Note {k}.") for k in range(9)]
    printed = [line.strip() for line in noted([*notes, *wrong], wrong[0].text, 80, 3)]
    assert printed == ["and         stick.q is reversed.", "and         swing.q is reversed.", "note        Note 0.",
                       "8 kinds of notes more are in the JSON file and the report"]


def stated() -> Iterator[tuple[str, set[str], set[str]]]:
    """Where a diagnostic is made of texts and evidence that stand there: the fields of its texts, and what fills them.
    """
    for file in sorted(Path(hydroopt.__file__).parent.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "of"
                    and ast.unparse(node.func) == "Diagnostic.of"):
                continue
            _, _, evidence, *texts = node.args
            if isinstance(evidence, ast.Dict) and None not in evidence.keys:
                templates = [text.value for text in texts if isinstance(text, ast.Constant)]
                yield (f"{file.name}:{node.lineno}",
                       {name for text in templates for _, name, _, _ in Formatter().parse(text) if name},
                       {"subject", *(ast.literal_eval(key) for key in evidence.keys if key is not None)})


def test_evidence_fills_every_sentence() -> None:
    found = list(stated())
    assert len(found) > 100
    assert not [where for where, fields, filled in found if not fields <= filled]
