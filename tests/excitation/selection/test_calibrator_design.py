"""Designed calibrators: σ by an independent assembly of the chain, limits, certificates of shares, and refusals."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import hydroopt
from fixtures.sheets import says_what_people_keep
from hydroopt.cli import app
from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.observability import linearise
from hydroopt.excitation.selection.calibrator_design import CalibratorDesign, design_calibrator
from hydroopt.excitation.selection.calibrator_problem import SensorOffer, Workshop, calibrator_problem, fixture_of
from hydroopt.excitation.selection.calibrator_sizing import DEXTERITY, optimal_shares, whitened_rows
from hydroopt.excitation.selection.pose_problem import Postures, pose_problem
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine, read_machine
from hydroopt.results.answer import load
from hydroopt.simulation import postures
from hydroopt.simulation.pose_table import simulate_poses

WORKSHOP = Workshop(3.5, ((1.9, 0.0, -1.4), (4.0, 0.0, -0.3)), length_error=1e-3, angle_error=np.radians(0.05))


def angles_alone() -> Machine:
    """A CAT 215B without transducers of lengths and without drift."""
    machine = load_machine("cat215b")
    return machine.model_copy(update={
        "sensors": tuple(each for each in machine.sensors if not each.channels[0].endswith(".length")),
        "stages": tuple(stage.model_copy(update={"drift": 0.0}) for stage in machine.stages)})


@cache
def design() -> CalibratorDesign:
    problem = calibrator_problem(angles_alone(), 6, links=(4, 4), workshop=WORKSHOP)
    return design_calibrator(problem, starts=1, effort=0.02)


def turned(axis: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    a, b = [(1, 2), (2, 0), (0, 1)][axis]
    matrix = np.eye(4)
    matrix[a, a], matrix[a, b], matrix[b, a], matrix[b, b] = c, -s, s, c
    return matrix


def moved(*place: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = place
    return matrix


def gap(machine: Machine, numbers: dict[str, float], angles: np.ndarray) -> np.ndarray:
    """Ball less fixture (3,) [m]: Eq. 3.8 multiplied out, link by link."""
    pose, k = np.eye(4), 0
    for link in machine.chain:
        theta, d, a, alpha, beta = (numbers.get(f"{link.name}.{key}", getattr(link.joint, key))
                                    for key in ("theta", "d", "a", "alpha", "beta"))
        if link.joint.moving:
            theta, k = theta + angles[k], k + 1
        pose = pose @ moved(0, 0, d) @ turned(2, theta) @ moved(a, 0, 0) @ turned(0, alpha) @ turned(1, beta)
    return pose[:3, 3] - [numbers[f"ball.{axis}"] for axis in "xyz"]


@pytest.mark.slow
def test_deviations_are_those_of_the_numerical_jacobian_of_the_assembled_chain() -> None:
    """Unknowns: all parameters, and in each pose each angle; gaps vanish to a micrometre, sensed angles are read."""
    done, tight, step = design(), 1e-6, 1e-6
    machine, names, joints = done.machine, done.names, done.joints
    nominal = done.problem.parameters.nominal
    values = {name: float(nominal[done.problem.parameters.index(name)]) for name in names}
    sensed = [joints.index(each.removesuffix(".q")) for each in done.problem.channels]
    reading = [machine.sensor(f"{joints[k]}.q").std for k in sensed]
    information, since = done.observability.prior.copy(), dict[str, str]()
    for group in done.problem.groups:
        for joint in group.moves:
            since.pop(joint, None)
        for joint in group.locked:
            since.setdefault(joint, f"{joint}.locked.{group.stage}")
        free = [*sensed, *map(joints.index, group.moves)]
        for q in done.q[done.stage == group.stage]:
            by_q = np.array([(gap(machine, values, q + step * e) - gap(machine, values, q - step * e)) / (2 * step)
                             for e in np.eye(len(q))]).T
            columns = np.zeros((3, len(names)))
            for k, name in enumerate(names):
                joint = name.partition(".")[0]
                if ".locked." in name:
                    columns[:, k] = by_q[:, joints.index(joint)] * (since.get(joint) == name)
                elif not joint.endswith("cylinder"):
                    up, down = ({**values, name: values[name] + sign * step} for sign in (1, -1))
                    columns[:, k] = (gap(machine, up, q) - gap(machine, down, q)) / (2 * step)
            own = np.vstack([columns / tight, np.zeros((len(sensed), len(names)))])
            angles = np.vstack([by_q[:, free] / tight, np.eye(len(sensed), len(free)) / np.array(reading)[:, None]])
            left = own - angles @ np.linalg.lstsq(angles, own, rcond=None)[0]
            information += left.T @ left
    std = dict(zip(names, np.sqrt(np.diag(np.linalg.inv(information))), strict=True))
    for name, expected in done.length_deviations.items():
        assert expected == pytest.approx(std[name], rel=1e-3)


@pytest.mark.slow
def test_no_other_choice_of_candidate_poses_would_be_much_better() -> None:
    done = design()
    largest = max(done.length_deviations[name] / asked for name, asked in done.length_std.items())
    assert done.bound <= largest <= 1.5 * done.bound


@pytest.mark.slow
def test_poses_close_within_all_limits_and_none_is_singular() -> None:
    done = design()
    machine, model = done.machine, done.problem.model
    low, high = model.ranges.T
    fixture = np.array(machine.fixtures[0].position)
    gaps = model.over(model.closure, model.parameters.nominal, done.q, np.repeat([fixture], len(done.q), axis=0))[0]
    assert np.max(np.abs(gaps)) < 1e-9
    moving = [k for k, joint in enumerate(done.joints) if joint not in done.problem.groups[0].locked]
    assert np.all((done.q >= low - 1e-9)[:, moving])
    assert np.all((done.q <= high + 1e-9)[:, moving])
    stroke = np.array([each.stroke for each in machine.cylinders])
    part = model.over(model.strokes, model.parameters.nominal, done.q)[0][:, :, 0] / stroke
    assert np.all((part > postures.RESERVE - 1e-3) & (part < 1 - postures.RESERVE + 1e-3))
    ends = model.over(model.far_ends, model.parameters.nominal, done.q)[0]
    carried = [link.name for link in machine.chain].index("stick")
    assert np.all(ends[:, 2, carried:-1] > machine.ground + WORKSHOP.clearance - 1e-3)
    turns = model.over(model.loop_by_angles, model.parameters.nominal, done.q,
                       np.repeat([fixture], len(done.q), axis=0))[1]
    motion = turns[:, :, postures.sensed_joints(model)]
    square = motion @ motion.transpose(0, 2, 1)
    assert np.all(np.linalg.det(square) / (np.trace(square, axis1=1, axis2=2) / 3) ** 3 > DEXTERITY - 1e-3)
    low_site, high_site = np.array(WORKSHOP.site)
    assert np.all((fixture >= low_site - 1e-9) & (fixture <= high_site + 1e-9))


def test_the_sheet_keeps_people_safe() -> None:
    """Also from what the calibrator adds to the machine's reach."""
    done = design()
    says_what_people_keep(done.sheet(), done.watch)
    assert done.watch.attached > 0
    assert f"{done.watch.attached:.2f} m of which hang at its tip" in " ".join(done.sheet().split())


def test_what_own_errors_cost_is_what_an_exact_number_saves() -> None:
    done = design()
    dearest = done.own_errors[0]
    exact = done.problem.fixing(**{dearest.name: float(done.problem.parameters.nominal[
        done.problem.parameters.index(dearest.name)])})
    again = linearise(Postures(exact, done.q).calibration, exact.parameters.nominal, done.q)
    assert again.jacobian.shape[0] == len(done.q)
    assert dearest.factor >= done.own_errors[-1].factor >= 1 - 1e-9
    assert all(done.exact_deviations[name] <= std + 1e-12 for name, std in done.length_deviations.items())


def test_symbolic_rows_are_those_of_linearised_poses() -> None:
    done = design()
    problem = pose_problem(done.machine, 1)
    q = done.q[[0, 6, 12]]
    calibration = Postures(problem, q).calibration
    linear = linearise(calibration, calibration.start, q)
    for k in range(3):
        rows = np.array(whitened_rows(calibration, k)(calibration.start, q[k]))
        expected = linear.jacobian[k][:, calibration.free]
        np.testing.assert_allclose(rows @ rows.T, expected.T @ expected, atol=1e-9 * np.max(expected**2))


def test_no_shares_are_better_than_the_bound() -> None:
    rng = np.random.default_rng(0)
    rows, pick = rng.normal(size=(2, 15, 2, 4)) * [1, 2, 0.3, 1], np.eye(4)[:, :3]
    found = optimal_shares(rows, 1e-6 * np.eye(4), pick, 10.0, 2000)
    assert found.bound <= np.max(found.variance) <= 1.25 * found.bound  # the power mean of three is up to 1.2 times it
    for _ in range(300):
        share = rng.dirichlet(np.full(15, 0.1), size=2)
        flat = (np.sqrt(10 * share)[:, :, None, None] * rows).reshape(-1, 4)
        assert np.max(np.diag(np.linalg.inv(1e-6 * np.eye(4) + flat.T @ flat))[:3]) >= found.bound


def test_the_machine_file_carries_the_calibrator() -> None:
    done = design()
    read = read_machine(done.files()["cat215b.toml"])
    assert (read.calibrator, read.fixtures, read.sensors) == (
        done.machine.calibrator, done.machine.fixtures, done.machine.sensors)
    measured = simulate_poses(hydroopt.KinematicModel(read), done.postures).poses
    assert hydroopt.calibration_problem(read, measured).parameters.names == done.problem.parameters.names


@pytest.mark.slow
def test_same_seed_same_design() -> None:
    done = design()
    again = design_calibrator(calibrator_problem(angles_alone(), 6, links=(4, 4), workshop=WORKSHOP), starts=1,
                              effort=0.02)
    assert again.values == done.values
    np.testing.assert_array_equal(again.q, done.q)


def test_cheaper_constructions_come_first() -> None:
    problem = calibrator_problem("cat215b", 6, length_std=1.0, sensors=(SensorOffer(1e-3, 5.0), SensorOffer(2e-3, 1.0)),
                                 links=(3, 4))
    assert [(cost, each.links, each.sensors[0].cost) for cost, each in problem.constructions()] == [
        (6.0, 3, 1.0), (8.0, 4, 1.0), (18.0, 3, 5.0), (24.0, 4, 5.0)]
    assert calibrator_problem("cat215b", 6, keep=("grapple",), links=(1, 2)).links == (2, 2)


@pytest.mark.slow
def test_the_cheapest_that_suffices_reaches_what_is_asked_for() -> None:
    problem = calibrator_problem(angles_alone(), 20, length_std=0.02, links=(3, 4),
                                 sensors=(SensorOffer(np.radians(0.1), 5.0), SensorOffer(np.radians(0.5), 1.0)))
    done = design_calibrator(problem, starts=1, effort=0.3)
    assert done.reached
    assert done.cost == problem.cost(done.construction)
    assert done.cost <= 3 * 6 + 6  # no more than one link above the fewest with the better sensors


@pytest.mark.slow
def test_the_command_writes_drawing_parts_and_machine(tmp_path: Path) -> None:
    ran = CliRunner().invoke(app, ["design-calibrator", "cat215b", "-n", "3", "--links", "4", "--starts", "1",
                                   "--effort", "0.02", "-o", str(tmp_path)], catch_exceptions=False)
    assert ran.exit_code == 0
    assert "calibrator of 4 links on 'stick'" in ran.output
    assert load(tmp_path).details()["cost"] == 8.0
    assert load_machine(tmp_path / "cat215b.toml").calibrator.links[-1].name == "calibrator_4"
    drawing = (tmp_path / "calibrator.svg").read_text("utf-8")
    assert "calibrator_4" in drawing
    assert drawing in (tmp_path / "report.html").read_text("utf-8")


@pytest.mark.parametrize(("machine", "options", "sentence"), [
    ("patu655", {}, "it states no calibrator, so that nothing says which link carries it"),
    ("cat215b", {"keep": ("cab",)}, "keep 'cab': the machine's own calibrator has no such link; use grapple_swing"),
    ("cat215b", {"links": (7, 8)}, "links: 7 to 8 links are not possible; give a range within 3 to 6"),
    ("cat215b", {"links": (1, 2)}, "links: 1 to 2 links are not possible; give a range within 3 to 6"),
    ("cat215b", {"length_std": {"stick.d": 1e-3}}, "length 'stick.d': this is not an uncertain length of a link"),
    ("cat215b", {"length_std": 0.0}, "the accuracy 0 m is not positive; give a positive length"),
    ("cat215b", {"length_std": float("nan")}, "the accuracy nan m is not positive; give a positive length"),
    ("cat215b", {"sensors": (SensorOffer(0.0),)}, "accuracy of a sensor: 0 is not possible; give a positive number"),
    ("cat215b", {"link_cost": -1.0}, "cost of a link: -1 is not possible; give a number from 0 on"),
    ("cat215b", {"workshop": Workshop(3.0, ((1, 0, 0), (0, 0, 0)))}, "place of the ball along x: 1 m is above 0 m"),
    pytest.param("cat215b", {"workshop": Workshop(0.05, ((8, 8, 0), (9, 9, 0)))},
                 "no calibrator closes the loop within its limits", marks=pytest.mark.slow),
    pytest.param("cat215b", {"length_std": 1e-6, "links": (4, 4)},
                 "leaves a length at .* times the accuracy asked for; ask for less", marks=pytest.mark.slow)])
def test_bad_input_is_refused_in_one_sentence(machine: str, options: dict, sentence: str) -> None:
    with pytest.raises(ProblemError, match=sentence):
        design_calibrator(calibrator_problem(machine, 3, **({"links": (3, 3)} | options)), starts=1, effort=0.02)


def test_the_fixture_keeps_its_name() -> None:
    assert design().machine.fixtures[0].name == fixture_of(angles_alone()) == "ball"
