"""The folder of an identification: complete, strict, consistent with itself, loaded again, or not there at all."""

from __future__ import annotations

import csv
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydroopt.errors import ProblemError, SolverError
from hydroopt.estimation.dynamic.estimate import Estimate, inputs_of
from hydroopt.estimation.dynamic.identification import body_groups
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.logs.log_files import read_log
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine, load_machine, read_machine
from hydroopt.model.model import Model
from hydroopt.report.identification import render
from hydroopt.results import json_file
from hydroopt.results.answer import load
from hydroopt.results.diagnostic import of_kind
from hydroopt.results.json_file import COMMON
from hydroopt.simulation.simulate import random_trajectory, simulate

CONTRACT = {*COMMON, "base_parameters", "conditioning", "physical_consistency", "seed"}
EXTRA = {"fit_by_model", "fixed", "constraints", "priors", "total_masses", "weights", "active_constraints", "intervals",
         "notes", "test_of_fit", "freed", "split_half", "between_logs", "prior_test"}
FILES = {"estimate.json", "report.html", "parameters.csv", "base_parameters.csv", "fit.csv", "information.csv",
         "cat215b.toml"}


@pytest.fixture(scope="module")
def estimate(tmp_path_factory: pytest.TempPathFactory) -> Estimate:
    machine = load_machine("cat215b")
    model, place = Model(machine), tmp_path_factory.mktemp("logs")
    logs = []
    for seed in (1, 2):
        simulate(model, random_trajectory(model, duration=20.0, rate=25.0, seed=seed), seed=seed).write(
            place / f"{seed}.csv"
        )
        logs.append(read_log(place / f"{seed}.csv"))
    return identify(identification_problem(machine, logs[:1], logs[1:]), seed=5)


@pytest.fixture(scope="module")
def left(estimate: Estimate, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("run") / "new" / "folder"
    estimate.save(place, pages={"report.html": render(estimate)}, wall_s=1.5)
    return place


@pytest.fixture(scope="module")
def content(left: Path) -> dict[str, Any]:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")
    found: dict[str, Any] = json.loads((left / "estimate.json").read_text("utf-8"), parse_constant=refuse)
    return found


def rows(file: Path) -> list[dict[str, str]]:
    with file.open(encoding="utf-8", newline="") as lines:
        return list(csv.DictReader(lines))


def test_files_are_complete_and_nothing_else_is_left(left: Path) -> None:
    assert {file.name for file in left.iterdir()} == FILES
    assert load_machine(left / "cat215b.toml").name == "cat215b"


def test_keys_are_those_of_the_contract(content: dict[str, Any]) -> None:
    assert set(content) == CONTRACT | EXTRA
    assert set(content["machine"]) >= {"name", "sha256"}
    for one in content["inputs"]:
        assert set(one) >= {"path", "sha256", "samples"}
    for one in content["parameters"]:
        assert set(one) == {"name", "kind", "unit", "nominal", "prior_std", "value", "std", "ci95", "bound",
                            "identifiability", "information_from_data"}
        assert one["identifiability"] in {"full", "combination", "none", "not excited"}
    for one in content["base_parameters"]:
        assert set(one) == {"expression", "unit", "value", "std"}
    for one in content["total_masses"]:
        assert set(one) == {"link", "bodies", "unit", "value", "std", "ci95"}
    assert set(content["fit"]) == {"train", "validation"}
    for table in content["fit"].values():
        for one in table.values():
            assert set(one) == {"rms", "vaf", "relative", "unit"}
    assert set(content["conditioning"]) >= {"rank", "condition_number"}
    for one in content["physical_consistency"].values():
        assert set(one) == {"consistent", "min_eigenvalue"}
        assert one["consistent"] == (one["min_eigenvalue"] >= 0)


def test_values_are_those_of_the_estimate(content: dict[str, Any], estimate: Estimate) -> None:
    assert (content["method"], content["status"], content["seed"], content["wall_s"]) == ("sdp", "ok", 5, 1.5)
    assert content["machine"]["sha256"] == estimate.problem.model.machine.sha256
    for one in content["inputs"]:
        assert one["sha256"] == hashlib.sha256(Path(one["path"]).read_bytes()).hexdigest()
        assert one["samples"] == 500
    by_name = {one["name"]: one for one in content["parameters"]}
    for k, name in enumerate(estimate.problem.parameters.names):
        one = by_name[name]
        assert one["value"] == (None if np.isnan(estimate.value[k]) else estimate.value[k])
        assert (one["ci95"] is None) == bool(np.isnan(estimate.ci95[k, 0]))
        assert (one["bound"] or "") == estimate.bound[k]
    assert by_name["swing.I_xx"]["std"] is None
    assert len(content["base_parameters"]) == content["conditioning"]["rank"] == estimate.identifiability.rank
    error = np.concatenate([e.force[e.inside] - p[e.inside] for e, p in zip(
        estimate.problem.validation, estimate.predictions["validation"], strict=True)])
    assert content["fit"]["validation"]["boom_cylinder"]["rms"] == pytest.approx(np.sqrt(np.mean(error[:, 1] ** 2)))
    assert content["fit"]["validation"]["swing_motor"]["unit"] == "N*m"


def test_tables_say_the_same(content: dict[str, Any], left: Path) -> None:
    table = rows(left / "parameters.csv")
    assert [row["name"] for row in table] == [one["name"] for one in content["parameters"]]
    for row, one in zip(table, content["parameters"], strict=True):
        for key in ("nominal", "value", "std"):
            assert row[key] == ("" if one[key] is None else repr(one[key]))
        assert [row["low"], row["high"]] == (["", ""] if one["ci95"] is None else [repr(v) for v in one["ci95"]])
        assert row["bound"] == (one["bound"] or "")
    base = rows(left / "base_parameters.csv")
    assert [row["expression"] for row in base] == [one["expression"] for one in content["base_parameters"]]
    assert [float(row["value"]) for row in base] == [one["value"] for one in content["base_parameters"]]
    fit = {(row["data"], row["channel"]): float(row["rms"]) for row in rows(left / "fit.csv")
           if row["model"] == "complete"}
    assert fit == {
        (data, channel): one["rms"] for data, table in content["fit"].items() for channel, one in table.items()
    }


def test_saving_again_replaces_and_leaves_the_estimate_alone(estimate: Estimate, tmp_path: Path) -> None:
    def tables() -> dict[str, bytes]:
        return {file.name: file.read_bytes() for file in tmp_path.iterdir()
                if file.name not in ("report.html", "estimate.json")}

    def content() -> dict[str, Any]:
        return json.loads((tmp_path / "estimate.json").read_text()) | {"created": ""}

    estimate.save(tmp_path)
    before, first = tables(), content()
    estimate.save(tmp_path)
    assert (tables(), content()) == (before, first)
    assert first["wall_s"] is None


def test_what_is_loaded_says_the_same_and_saves_the_same(estimate: Estimate, left: Path, tmp_path: Path) -> None:
    loaded = load(left)
    for text in (repr, str):
        assert text(loaded) == text(estimate)
    assert len(repr(estimate)) < 120
    for name in ("parameters", "diagnostics", "status", "fit", "method", "inputs"):
        assert getattr(loaded, name) == getattr(estimate, name), name
    assert loaded.details() == json.loads(json.dumps(estimate.details()))
    assert loaded.machine == read_machine(dump_machine(estimate.machine))
    loaded.save(tmp_path, wall_s=1.5)
    assert {file.name for file in tmp_path.iterdir()} == FILES
    for file in FILES - {"estimate.json"}:
        assert (tmp_path / file).read_bytes() == (left / file).read_bytes(), file
    first, second = (json.loads((place / "estimate.json").read_text()) for place in (left, tmp_path))
    assert first | {"created": ""} == second | {"created": ""}


def test_information_from_data_is_what_the_prior_lacks(estimate: Estimate) -> None:
    rows = [one for one in estimate.parameters.rows if one.std is not None and one.prior_std]
    assert rows
    for one in rows:
        assert one.information_from_data == pytest.approx(max(0.0, 1 - (one.std / one.prior_std) ** 2))
    free = identify(estimate.problem, "wls")
    assert {one.information_from_data for one in free.parameters.rows if one.std is not None} == {1.0}


def test_a_place_that_is_no_folder_is_refused(estimate: Estimate, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ProblemError, match=r"(is a file|cannot be written)"):
        estimate.save(tmp_path / "file")


def test_failure_is_marked(estimate: Estimate, tmp_path: Path) -> None:
    error = SolverError("it ran out of iterations", where="identification of cat215b", remedy="start elsewhere")
    json_file.write_failure(tmp_path, json_file.Job.IDENTIFICATION, estimate.machine_id, "nlp",
                            inputs_of(estimate.problem), error)
    assert [file.name for file in tmp_path.iterdir()] == ["estimate.json"]
    said = json.loads((tmp_path / "estimate.json").read_text("utf-8"))
    assert (said["status"], said["method"], said["reason"]) == ("failed", "nlp", str(error))
    assert "parameters" not in said


def test_an_impossible_machine_is_not_exported(estimate: Estimate, tmp_path: Path) -> None:
    impossible = identify(estimate.problem, "wls")
    assert min(impossible.consistency.values()) < 0
    impossible.save(tmp_path)
    assert {file.name for file in tmp_path.iterdir()} == FILES - {"cat215b.toml", "report.html"}
    (found,) = of_kind(load(tmp_path).diagnostics, "bodies not physically consistent")
    assert found.evidence["min_eigenvalue"] == min(impossible.consistency.values())
    assert set(found.subject) == {owner for owner, smallest in impossible.consistency.items() if smallest < 0}
    with pytest.raises(ProblemError, match="cannot exist"):
        _ = impossible.machine


def test_seals_that_cannot_be_are_said_and_not_exported(tmp_path: Path) -> None:
    data = load_machine("patu655_lift").model_dump()
    data["cylinders"][0]["friction"]["seal"] = 1e-4
    model = Model(Machine.model_validate(data))
    log = simulate(model, random_trajectory(model, duration=10, rate=25, seed=1), seed=1)
    widest = model.parameters.upper[model.parameters.index("lift_cylinder.f_seal")]
    estimate = identify(identification_problem(model, [log]).fix("lift_cylinder.f_seal", widest), intervals=False)
    estimate.save(tmp_path)
    (found,) = of_kind(estimate.diagnostics, "no calibrated machine")
    assert found.text.startswith("No calibrated machine is written: the seals hold")
    assert not (tmp_path / "patu655_lift.toml").exists()


@pytest.mark.slow
def test_an_earlier_result_is_not_left_beside_a_new_one(tmp_path: Path) -> None:
    """The calibrated machine of one method must not pass for that of the next, which has none."""
    machine = load_machine("cat215b")
    model = Model(machine)
    log = simulate(model, random_trajectory(model, duration=20, rate=25, seed=1), seed=1)
    problem = identification_problem(machine, [log])
    identify(problem, "sdp", intervals=False).save(tmp_path)
    assert (tmp_path / "cat215b.toml").exists()
    identify(problem, "wls").save(tmp_path)
    assert not (tmp_path / "cat215b.toml").exists()
    assert json.loads((tmp_path / "estimate.json").read_text())["method"] == "wls"


@pytest.mark.parametrize(("name", "found"), [("panda_mukca", False), ("cat215b", True)])
def test_bodies_without_a_stated_confidence_are_not_contradicted(name: str, found: bool) -> None:
    """Sound simulated logs of an arm whose file states none named all its bodies as the cause of a misfit."""
    machine = load_machine(name)
    assert bool(body_groups(Model(machine).parameters, machine)) is found
