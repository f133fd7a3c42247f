"""Dry friction in cylinders that span several joints has the direction of their own motion."""

from collections.abc import Callable

import numpy as np
import pytest

import hydroopt as ho
from hydroopt.estimation.dynamic.experiment import Experiment, experiment
from hydroopt.estimation.dynamic.friction_sign import OVERSHOOT, Courses
from hydroopt.estimation.dynamic.misfit.hypotheses import AngleLate
from hydroopt.estimation.dynamic.misfit.view import View
from hydroopt.simulation.simulate import Trajectory

STEWART = ("stewart_platform", [(6,), (7,), (8,), (9,), (10,), (11,)])
Speeds = Callable[[np.ndarray, np.ndarray], np.ndarray]


@pytest.fixture(scope="module")
def loader() -> tuple[Experiment, Speeds]:
    """A wheel loader's log, and the speed of its tilt cylinder by differences of the cylinder's length."""
    model = ho.Model(ho.load_machine("wheel_loader"))
    log = ho.simulate(model, ho.random_trajectory(model, duration=20.0, rate=50.0, seed=1), seed=1)
    tilt = [each.name for each in model.machine.pinned].index("tilt_cylinder")

    def length(q: np.ndarray) -> np.ndarray:
        return np.asarray(model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)[0][:, tilt, 0])

    return experiment(model, log), lambda q, qd: (length(q + 1e-5 * qd) - length(q - 1e-5 * qd)) / 2e-5


def test_a_sample_counts_where_the_cylinder_moves(loader: tuple[Experiment, Speeds]) -> None:
    """By the joint alone some samples were taken at which the cylinder stands still, and others left out."""
    made, speed = loader
    motion = made.motion
    own, taken = speed(motion.q, motion.qd), made.known[:, 1]
    least = OVERSHOOT * np.sqrt(np.mean(own**2))
    assert np.min(np.abs(own[taken])) > 0.99 * least
    assert np.mean(taken[np.abs(own) > 1.2 * least]) > 0.99
    joint = np.abs(motion.qd[:, 1]) / np.sqrt(np.mean(motion.qd[:, 1] ** 2)) > OVERSHOOT
    assert np.any(taken & ~joint)
    assert np.any(~taken & joint)


def test_a_fault_has_no_derivative_where_the_cylinder_reverses(loader: tuple[Experiment, Speeds]) -> None:
    made, speed = loader
    view = View.of(made, made.model.parameters.nominal)
    fault = AngleLate(name="delay lift.q", group="delay", subject=("lift.q",), words="late", std=(0.05,), linear=False,
                      joint=0)
    up, down = fault.state(view, fault.scale / 20), fault.state(view, -fault.scale / 20)
    turned = np.sign(speed(*up[:2])) != np.sign(speed(*down[:2]))
    assert np.any(turned & (np.sign(up[1][:, 1]) == np.sign(down[1][:, 1])))
    by_size = fault.sensitivity(view)[:, 1]
    assert np.all(by_size[turned] == 0)
    assert np.max(np.abs(by_size)) < 20 * np.sqrt(np.mean(by_size**2))  # no step of friction over a step of the size
    slow = fault.unsteady(view, fault.scale)[:, 1]
    moved = np.abs(speed(*fault.state(view, fault.scale)[:2]))
    assert np.max(moved[slow]) < np.min(moved[~slow]) * (1 + 1e-9)


@pytest.mark.parametrize(("name", "columns"), [
    ("wheel_loader", [(0,), (2,)]), pytest.param(*STEWART, marks=pytest.mark.slow),
    ("forestry_crane", [(k,) for k in range(7)])])
def test_each_balance_follows_what_has_its_friction(name: str, columns: list[tuple[int, ...]]) -> None:
    assert list(Courses.of(ho.Model(ho.load_machine(name))).of_balances) == columns


def test_a_cylinder_moves_with_the_lift_alone() -> None:
    """The bucket's joint stands still, its cylinder does not: by the joint no sample told of its force."""
    model, t = ho.Model(ho.load_machine("wheel_loader")), np.arange(1500) / 50
    low, high = model.machine.ranges.T
    q, qd, qdd = np.tile((low + high) / 2, (t.size, 1)), np.zeros((t.size, 2)), np.zeros((t.size, 2))
    size, turn = 0.3 * (high - low)[0], 2 * np.pi / 6
    q[:, 0] += size * np.sin(turn * t)
    qd[:, 0], qdd[:, 0] = size * turn * np.cos(turn * t), -size * turn**2 * np.sin(turn * t)
    made = experiment(model, ho.simulate(model, Trajectory(t, q, qd, qdd), seed=1))
    assert np.mean(made.known[made.inside], axis=0) == pytest.approx([0.9, 0.9], abs=0.05)


def test_pieces_count_the_same_samples(loader: tuple[Experiment, Speeds], in_pieces: Callable[[int], None]) -> None:
    whole, _ = loader
    in_pieces(601)
    pieces = experiment(whole.model, whole.log)
    assert len(pieces.log.spans) > 1
    np.testing.assert_array_equal(pieces.known & pieces.inside[:, None], whole.known & whole.inside[:, None])
