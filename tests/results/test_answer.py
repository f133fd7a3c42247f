"""An answer is saved, loaded, refused when damaged, and says the same afterwards."""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest

from hydroopt.errors import ProblemError
from hydroopt.machine.machine_file import load_machine
from hydroopt.results import json_file
from hydroopt.results.answer import Answer, load
from hydroopt.results.diagnostic import Diagnostic, Meaning, of_kind
from hydroopt.results.fit import Fit
from hydroopt.results.parameter_table import ParameterTable, row
from hydroopt.results.status import Status
from hydroopt.results.verdict import Claim, Purpose, Usable


class Example(Answer):
    """The least that a job has to say."""

    job = json_file.Job.IDENTIFICATION
    machine = load_machine("patu655_lift")
    machine_id, method, status = json_file.MachineId("crane", "", "ab" * 32), "sdp", Status.SUSPECT
    diagnostics = (Diagnostic.of("worse than zero", ("lift_cylinder",), {"relative": 1.31}, (
        "{subject} is predicted worse than by zero ({relative:.0f %} error)."),
        "Check signs.", Meaning.CONTRADICTION),)
    parameters = ParameterTable([
        row("lift.m", "mass", "kg", nominal=120.0, prior_std=12.0, value=125.0, std=3.0, ci95=(119.1, 130.9)),
        row("lift.mc_z", "first moment", "kg*m", nominal=0.0, identifiability="none")])
    fit: Mapping[str, Mapping[str, Fit]] = {"train": {"lift_cylinder": Fit(210.0, 0.98, 0.05, "N")}}
    claims = (Claim(Purpose.MASS, "lift.m", Usable.YES, 5.9, "kg", 0.047),)
    inputs = ({"path": "log.csv", "sha256": None, "samples": 10, "role": "train"},)

    def details(self) -> Mapping[str, Any]:
        return {"seed": 3}

    def files(self) -> Mapping[str, str]:
        return {"parameters.csv": self.parameters.to_csv()}


def test_what_is_loaded_says_the_same(tmp_path: Path) -> None:
    answer = Example()
    answer.save(tmp_path, wall_s=1.5)
    loaded = load(tmp_path)
    assert repr(loaded) == repr(answer)
    assert str(loaded) == str(answer)
    assert loaded.parameters == answer.parameters
    assert loaded.diagnostics == answer.diagnostics
    assert loaded.status is Status.SUSPECT
    assert loaded.fit == answer.fit
    assert loaded.details() == answer.details()
    assert loaded["lift.m"].value == 125.0
    assert loaded.verdict == answer.verdict
    loaded.save(tmp_path / "again", wall_s=1.5)
    first, second = (json.loads((folder / "estimate.json").read_text()) for folder in (tmp_path, tmp_path / "again"))
    assert {**first, "created": ""} == {**second, "created": ""}
    assert (tmp_path / "again" / "parameters.csv").read_text() == (tmp_path / "parameters.csv").read_text()


class Design(Example):
    """An answer of another job, whose table a user fills in."""

    job = json_file.Job.POSE_PLAN

    def files(self) -> Mapping[str, str]:
        return {"poses.csv": "to measure", "sheet.txt": "to print"}


def test_the_next_answer_leaves_nothing_of_the_one_before_but_what_is_the_user_s(tmp_path: Path) -> None:
    (tmp_path / "tracking.csv").write_text("the user's, though answers have files of this name")
    Design().save(tmp_path, pages={"c/crane.c": "code"})
    (tmp_path / "poses.csv").write_text("measured")
    Example().save(tmp_path)
    assert {file.name for file in tmp_path.rglob("*") if file.is_file()} == {
        "estimate.json", "parameters.csv", "poses.csv", "tracking.csv"}


def test_no_file_elsewhere_is_removed_or_read_whatever_an_answer_lists(tmp_path: Path) -> None:
    (tmp_path / "mine.csv").write_text("mine")
    Example().save(tmp_path / "out")
    content = json.loads((tmp_path / "out/estimate.json").read_text())
    content["files"] |= dict.fromkeys(["../mine.csv", str(tmp_path / "mine.csv")], sha256(b"mine").hexdigest())
    (tmp_path / "out/estimate.json").write_text(json.dumps(content))
    assert load(tmp_path / "out").files().keys() == {"parameters.csv"}
    Example().save(tmp_path / "out")
    assert (tmp_path / "mine.csv").read_text() == "mine"


@pytest.mark.parametrize(("text", "what"), [
    ("", "damaged"), ("[]", "damaged"), ("{}", "damaged"), ("[" * 100_000, "damaged"),
    ('{"schema": 1, "machine": {}}', "its schema is 1"), ('{"schema": 3, "machine": {}}', "damaged"),
    ('{"schema": 3, "job": "x", "status": "ok", "machine": {"name": "a", "parameter_set": "", "sha256": "b"}}',
     "damaged")])
def test_damage_is_refused_in_a_sentence(tmp_path: Path, text: str, what: str) -> None:
    (tmp_path / "estimate.json").write_text(text)
    with pytest.raises(ProblemError, match=what) as caught:
        load(tmp_path)
    assert "estimate.json" in str(caught.value)


def test_an_empty_folder_and_an_unknown_parameter_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ProblemError, match="holds no estimate"):
        load(tmp_path)
    with pytest.raises(ProblemError, match=r"did you mean lift\.m"):
        Example()["lift.n"]


def test_a_table_without_parameters_has_its_columns() -> None:
    frame = ParameterTable(()).to_frame()
    assert len(frame) == 0
    assert {"value", "low", "high"} <= set(frame.columns)


def test_information_from_data_is_the_part_that_the_prior_does_not_explain() -> None:
    told = row("a", "mass", "kg", prior_std=2.0, std=1.0)
    assert told.information_from_data == 0.75
    assert row("a", "mass", "kg", std=1.0).information_from_data == 1.0
    assert row("a", "mass", "kg", prior_std=2.0, std=2.5).information_from_data == 0.0
    assert row("a", "mass", "kg", prior_std=2.0).information_from_data is None


def test_diagnostics_are_found_by_kind_and_by_what_they_mean() -> None:
    found = Example.diagnostics
    assert of_kind(found, "worse than zero") == found == Example().contradictions
    assert not of_kind(found, "no validation data")
