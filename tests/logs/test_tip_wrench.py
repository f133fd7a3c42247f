"""A log that states the wrench at the tip: what simulation adds to the forces, identification takes out again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from hydroopt.cli import app
from hydroopt.errors import HydrooptError, LogError, ProblemError
from hydroopt.estimation.dynamic.experiment import experiment
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.estimation.hydraulic.problem import hydraulic_problem
from hydroopt.logs.forces_from_pressures import forces
from hydroopt.logs.log import Log
from hydroopt.logs.log_files import read_log
from hydroopt.logs.tip_wrench import free_forces, tip_wrench
from hydroopt.machine.description import WRENCH
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.simulation.drive_valves import commands_for
from hydroopt.simulation.reference_motion import reference_motion
from hydroopt.simulation.simulate import Trajectory, random_trajectory, random_truth, simulate
from hydroopt.solving import solve
from oracles.complex_machine import ComplexMachine

Array = np.ndarray
EXCAVATOR = Model(load_machine("cat215b"))


def touched(model: Model, seed: int = 1, duration: float = 33.0, rate: float = 50.0) -> Trajectory:
    """A random motion during which the tip is pulled about."""
    motion = random_trajectory(model, duration=duration, rate=rate, seed=seed)
    phase = 2 * np.pi * motion.t[:, None] / np.array([3.1, 4.3, 5.7, 2.9, 3.7, 6.1])
    return replace(motion, wrench=np.repeat([2e4, 4e3], 3) * np.sin(phase + np.arange(6)))


@pytest.fixture(scope="module")
def contact() -> tuple[Trajectory, Log]:
    motion = touched(EXCAVATOR)
    return motion, simulate(EXCAVATOR, motion, noise=False)


def test_simulated_forces_contain_the_wrench_by_virtual_work(contact: tuple[Trajectory, Log]) -> None:
    motion, log = contact
    plain = simulate(EXCAVATOR, replace(motion, wrench=None), noise=False)
    assert not set(WRENCH) & set(plain.channels)
    np.testing.assert_array_equal(np.column_stack([log.channel(name) for name in WRENCH]), motion.wrench)
    added = forces(EXCAVATOR, log, motion.q) - forces(EXCAVATOR, plain, motion.q)
    second = ComplexMachine(EXCAVATOR.machine)
    for k in (0, 500, 1600):
        q = motion.q[k]
        expected = np.linalg.solve(second.transmission(q).T, -second.tip_jacobian(q).T @ motion.wrench[k]).real
        largest = np.abs(forces(EXCAVATOR, log, motion.q)).max()
        np.testing.assert_allclose(added[k], expected, rtol=0, atol=1e-9 * largest)
    np.testing.assert_allclose(free_forces(EXCAVATOR, log, motion.q), forces(EXCAVATOR, plain, motion.q), rtol=0,
                               atol=1e-9 * np.abs(added).max())


def test_wrench_is_read_back_from_the_pressures(contact: tuple[Trajectory, Log]) -> None:
    """What acts on the tip without a moment shows in the forces of a calibrated machine."""
    motion = replace(contact[0], wrench=contact[0].wrench * [1, 1, 1, 0, 0, 0])
    log, model = simulate(EXCAVATOR, motion, noise=False), EXCAVATOR
    found = model.over(model.tip_wrench, motion.q, motion.qd, motion.qdd, forces(model, log, motion.q),
                       model.parameters.nominal)[0][:, :, 0]
    np.testing.assert_allclose(found, motion.wrench, rtol=0, atol=1e-6)


def test_identification_is_exact_with_the_wrench_and_wrong_without() -> None:
    """Without noise the forces of an unseen motion are predicted as well as if nothing had touched the tip."""
    model = Model(load_machine("patu655_lift"))
    truth = random_truth(model, seed=4)
    motion = touched(model, duration=30.0, rate=50.0)
    motion = replace(motion, wrench=motion.wrench * 0.2)
    logs = {"with": simulate(model, motion, truth, noise=False),
            "free": simulate(model, replace(motion, wrench=None), truth, noise=False)}
    blind = {name: values for name, values in logs["with"].channels.items() if name not in WRENCH}
    logs["without"] = replace(logs["with"], channels=blind, units={name: logs["with"].units[name] for name in blind})
    unseen = random_trajectory(model, duration=20.0, rate=25.0, seed=9)
    expected = model.over(model.inverse_dynamics, unseen.q, unseen.qd, unseen.qdd, truth)[0]
    error = {}
    for name, log in logs.items():
        psi = solve(identification_problem(model, [log]), method="wls").psi
        found = model.over(model.inverse_dynamics, unseen.q, unseen.qd, unseen.qdd, psi)[0]
        error[name] = float(np.sqrt(np.mean((found - expected)**2) / np.mean(expected**2)))
    assert error["with"] < 2 * error["free"] + 1e-6
    assert error["without"] > 100 * error["with"]


def test_experiment_says_what_was_taken_out(contact: tuple[Trajectory, Log]) -> None:
    made = experiment(EXCAVATOR, contact[1])
    assert any("a wrench at the tip is measured, with forces of up to" in note for note in made.notes)
    assert not any("not used" in note and "tip." in note for note in made.notes)


def test_log_in_pieces_gives_the_same_forces(in_pieces: Callable[[int], None]) -> None:
    model = Model(load_machine("patu655_lift"))
    log = simulate(model, touched(model, duration=40.0), noise=True, seed=3)
    whole = experiment(model, log)
    in_pieces(400)
    assert len(log.spans) > 1
    np.testing.assert_allclose(experiment(model, log).force, whole.force, rtol=1e-9)


def test_a_force_alone_acts_at_the_tip_itself() -> None:
    zero, one = np.zeros(3), np.ones(3)
    log = Log("hold", np.arange(3.0), {"tip.fx": zero, "tip.fy": zero, "tip.fz": -9.81 * one})
    np.testing.assert_array_equal(tip_wrench(log), np.tile([0, 0, -9.81, 0, 0, 0], (3, 1)))
    assert tip_wrench(Log("free", np.arange(3.0), {"boom.q": zero})) is None


@pytest.mark.parametrize(("given", "missing"), [
    (("tip.fx",), "tip.fy, tip.fz"), (("tip.fx", "tip.fy", "tip.fz", "tip.my"), "tip.mx, tip.mz"),
    (("tip.mx", "tip.my", "tip.mz"), "tip.fx, tip.fy, tip.fz")])
def test_part_of_a_wrench_is_refused(given: tuple[str, ...], missing: str, contact: tuple[Trajectory, Log]) -> None:
    channels = {name: values for name, values in contact[1].channels.items() if name not in WRENCH or name in given}
    log = replace(contact[1], channels=channels, units={name: contact[1].units[name] for name in channels})
    with pytest.raises(LogError, match=f"lacks {missing};"):
        identification_problem(EXCAVATOR, [log])


def test_units_of_a_wrench_are_checked(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t [s],tip.fx [kN],tip.fy [N*m]\n0,1,2\n1,1,2\n")
    with pytest.raises(HydrooptError, match=r"tip\.fy.*N"):
        read_log(tmp_path / "log.csv")


def test_what_takes_no_wrench_refuses_it() -> None:
    model = Model(load_machine("patu655_lift"))
    motion = touched(model, duration=4.0)
    with pytest.raises(ProblemError, match="wrench at the tip"):
        commands_for(Plant(model), motion)
    log = simulate(model, motion)
    channels = dict(log.channels) | {"lift_cylinder.u": np.zeros(log.size)}
    with pytest.raises(LogError, match="not part of the valves' model"):
        hydraulic_problem(model.machine, [Log("valves", log.t, channels)])


def test_simulation_follows_the_wrench_of_a_log(tmp_path: Path) -> None:
    model = Model(load_machine("patu655_lift"))
    motion = touched(model, duration=10.0)
    path = {"lift.q": motion.q[:, 0], "lift.qd": motion.qd[:, 0], "lift.qdd": motion.qdd[:, 0]}
    log = Log("path", motion.t, path | dict(zip(WRENCH, motion.wrench.T, strict=True)))
    np.testing.assert_array_equal(reference_motion(model.machine, log).wrench, motion.wrench)
    log.write(tmp_path / "path.csv")
    done = CliRunner().invoke(app, ["simulate", "patu655_lift", "--motion", str(tmp_path / "path.csv"), "--no-noise",
                                    "-o", str(tmp_path / "run"), "--quiet"])
    assert done.exit_code == 0, done.output
    made = read_log(tmp_path / "run" / "log.csv")
    expected = simulate(model, motion, noise=False)
    np.testing.assert_allclose(made.channel("tip.fz"), motion.wrench[:, 2], rtol=1e-9)
    head = "lift_cylinder.p_head"
    np.testing.assert_allclose(made.channel(head), expected.channel(head), rtol=1e-6)
