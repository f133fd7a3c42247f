"""Logs of machines whose seals' friction depends on pressures that depend on it, and what commands make of them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from hydroopt.cli import app
from hydroopt.errors import ProblemError
from hydroopt.logs.log_files import read_log
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine, load_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import BACK_PRESSURE, forces, random_trajectory, random_truth, simulate

TERMS = {"coulomb": 400.0, "coulomb_reverse": 300.0, "viscous": 3000.0, "viscous_reverse": 5000.0, "stribeck": 900.0,
         "stribeck_speed": 0.03, "seal": 3e-4}


def crane(**stated: float) -> Machine:
    """The log crane, with a counterweight that makes its cylinder pull, too, and other friction."""
    data = load_machine("patu655_lift").model_dump()
    data["cylinders"][0]["friction"] = stated
    data["notes"] = {path: note for path, note in data["notes"].items() if ".friction." not in path}
    data["links"][0]["body"] = {"m": 3000.0, "mc": (-1500.0, 0.0, 0.0), "inertia": (100.0, 0, 0, 2000.0, 0, 2000.0)}
    return Machine.model_validate(data)


@pytest.mark.parametrize("seal", [3e-4, 4e-3])
def test_force_and_pressures_fit_together(seal: float) -> None:
    """What the pressures show, less what such pressures add by friction, is the force of a machine without seals."""
    machine, bare = crane(**TERMS | {"seal": seal}), crane(**{k: v for k, v in TERMS.items() if k != "seal"})
    model, plain = Model(machine), Model(bare)
    motion = random_trajectory(model, duration=40.0, rate=25.0, seed=3)
    log = simulate(model, motion, noise=False)
    head, rod = machine.cylinders[0].areas
    p, q = log.channel("lift_cylinder.p_head"), log.channel("lift_cylinder.p_rod")
    speed = model.over(model.cylinder_kinematics, motion.q, motion.qd, motion.qdd)[1][:, 0, 0]
    force, friction = head * p - rod * q, seal * np.sign(speed) * (p + q)
    expected = plain.over(plain.inverse_dynamics, motion.q, motion.qd, motion.qdd, plain.parameters.nominal)[0][:, 0, 0]
    np.testing.assert_allclose(force - friction, expected, rtol=0, atol=1e-11 * np.max(np.abs(force)))
    assert np.min([p, q]) == pytest.approx(BACK_PRESSURE)
    assert np.any(p > 1.01 * BACK_PRESSURE)
    assert np.any(q > 1.01 * BACK_PRESSURE), "it pushes and pulls"


def test_the_same_by_going_round_in_circles() -> None:
    """Pressures from a force, friction from pressures, force from friction: a contraction, to its end."""
    machine, seal = crane(**TERMS), TERMS["seal"]
    model, plain = Model(machine), Model(crane(**{k: v for k, v in TERMS.items() if k != "seal"}))
    motion = random_trajectory(model, duration=10.0, rate=10.0, seed=4)
    log = simulate(model, motion, noise=False)
    head, rod = machine.cylinders[0].areas
    speed = model.over(model.cylinder_kinematics, motion.q, motion.qd, motion.qdd)[1][:, 0, 0]
    bare = plain.over(plain.inverse_dynamics, motion.q, motion.qd, motion.qdd, plain.parameters.nominal)[0][:, 0, 0]
    for k, (v, without) in enumerate(zip(speed, bare, strict=True)):
        force = without
        for _ in range(200):
            push = (force + rod * BACK_PRESSURE) / head
            pull = (head * BACK_PRESSURE - force) / rod
            force = without + np.sign(v) * seal * (max(push, BACK_PRESSURE) + max(pull, BACK_PRESSURE))
        assert head * log.channel("lift_cylinder.p_head")[k] - rod * log.channel("lift_cylinder.p_rod")[k] == (
            pytest.approx(force, rel=1e-11, abs=1e-6))


def test_standing_still_is_no_trouble() -> None:
    model = Model(crane(**TERMS))
    moving = random_trajectory(model, duration=10.0, rate=10.0, seed=4)
    still = replace(moving, qd=0 * moving.qd, qdd=0 * moving.qdd)
    plain = Model(crane())
    expected = forces(plain, still, plain.parameters.nominal)
    np.testing.assert_allclose(forces(model, still, model.parameters.nominal), expected, rtol=1e-12)


def test_seals_that_hold_the_piston_move_nothing() -> None:
    model = Model(crane(coulomb=1.0, seal=1e-4))
    psi = model.parameters.nominal.copy()
    psi[model.parameters.index("lift_cylinder.f_seal")] = 6e-3
    with pytest.raises(ProblemError, match=r"simulation: the seals of lift_cylinder .*; keep the seals well below"):
        simulate(model, random_trajectory(model, duration=5.0, rate=10.0, seed=0), psi)
    k = model.parameters.index("lift_cylinder.f_seal")
    assert model.parameters.upper[k] == machine_area(model)
    assert random_truth(model, 1)[k] < machine_area(model)


def machine_area(model: Model) -> float:
    return float(model.machine.cylinders[0].areas[1])


# --- commands


def run(*arguments: str | Path) -> str:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("sealed")
    (place / "crane.toml").write_text(dump_machine(crane(**TERMS)), encoding="utf-8")
    (place / "plain.toml").write_text(dump_machine(crane()), encoding="utf-8")
    for seed in (1, 2):
        run("simulate", place / "crane.toml", "--seed", seed, "--rate", "50", "-o", place / f"run{seed}")
    return place


@pytest.mark.slow
def test_show_simulate_and_identify_know_all_terms(place: Path) -> None:
    facts = json.loads(run("show", place / "crane.toml", "--json"))
    own = {one["name"].rpartition(".")[2]: one for one in facts["parameters"] if one["name"].startswith("lift_cyl")}
    assert set(own) == {"f_coulomb", "f_coulomb_reverse", "f_viscous", "f_viscous_reverse", "f_stribeck", "v_stribeck",
                        "f_seal"}
    assert {one["identifiability"] for one in own.values()} == {"full"}
    log = read_log(place / "run1/log.csv")
    assert {"lift_cylinder.p_head", "lift_cylinder.p_rod", "lift.q"} <= set(log.channels)
    run("identify", place / "crane.toml", place / "run1/log.csv", "--validate", place / "run2/log.csv",
        "-o", place / "known")
    content = json.loads((place / "known/estimate.json").read_text("utf-8"))
    assert "friction_choice" not in content
    found = {one["name"]: one for one in content["parameters"]}
    assert found["lift_cylinder.v_stribeck"]["value"] == pytest.approx(0.03, rel=0.4)
    assert content["fit"]["validation"]["all"]["relative"] < 0.1
    calibrated = load_machine(place / "known/patu655_lift.toml").cylinders[0].friction
    assert calibrated.seal is not None
    assert calibrated.stribeck_speed == pytest.approx(found["lift_cylinder.v_stribeck"]["value"], rel=1e-6)


@pytest.mark.slow
def test_friction_is_chosen_and_said(place: Path) -> None:
    said = run("identify", place / "plain.toml", place / "run1/log.csv", "--validate", place / "run2/log.csv",
               "--friction", "none,coulomb+viscous,coulomb+viscous+stribeck+seal", "-o", place / "chosen")
    chosen = [line.split()[1] for line in said.splitlines() if line.startswith("* ")]
    assert chosen == ["coulomb+viscous+stribeck+seal"]
    choice = json.loads((place / "chosen/estimate.json").read_text("utf-8"))["friction_choice"]
    assert [row["friction"] for row in choice["candidates"]] == ["none", "coulomb+viscous",
                                                                 "coulomb+viscous+stribeck+seal"]
    assert [row["friction"] for row in choice["candidates"] if row["chosen"]] == chosen
    keys = {"friction", "parameters", "training_error", "held_out_error", "held_out_std", "chosen", "reason"}
    assert all(set(row) == keys for row in choice["candidates"])
    assert choice["rule"] in " ".join(said.split("\n"))
    page = (place / "chosen/report.html").read_text("utf-8")
    assert page.index("<h2>Fit</h2>") < page.index("<h2>Friction terms</h2>") < page.index("<h2>Parameters</h2>")
    table = page[page.index("<h2>Friction terms</h2>"):page.index("<h2>Parameters</h2>")]
    assert all(row["friction"] in table for row in choice["candidates"])
    assert table.count("chosen</td>") == 1


@pytest.mark.slow
def test_friction_that_is_named_is_used(place: Path) -> None:
    run("identify", place / "crane.toml", place / "run1/log.csv", "--friction", "coulomb + viscous",
        "-o", place / "named")
    content = json.loads((place / "named/estimate.json").read_text("utf-8"))
    assert "friction_choice" not in content
    assert [one["name"] for one in content["parameters"] if "cylinder" in one["name"]] == [
        "lift_cylinder.f_coulomb", "lift_cylinder.f_viscous"]
