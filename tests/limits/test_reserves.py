"""Reserves are kept as they are stated, under uncertain parameters too, and impossible ones are refused."""

from __future__ import annotations

import numpy as np
import pytest

from hydroopt import Model, load_machine, random_trajectory
from hydroopt.errors import HydrooptError
from hydroopt.limits.limits import Limits, courses
from hydroopt.limits.reserves import Reserves
from hydroopt.limits.uncertain import UncertainParameters
from hydroopt.simulation.simulate import forces

CAT = Model(load_machine("cat215b"))


@pytest.mark.parametrize(("stated", "named"), [
    ("100 %", "leaves nothing"), ("-5 %", "is not possible"), ("tipping=120 %", "leaves nothing"),
    ("clearance=-1 m", "cannot be kept"), ("certainty=100 %", "cannot be kept"), ("colour=3 %", "no reserve 'colour'"),
    ("clearance=3", "m"), ("much", "number")])
def test_impossible_reserves_are_refused(stated: str, named: str) -> None:
    with pytest.raises(HydrooptError, match=named):
        Reserves.stated([stated])


def test_parts_without_a_kind_mean_flow_pressure_and_tipping() -> None:
    assert Reserves.stated(["20 %", "pressure=5 %"])[:4] == (0.2, 0.05, 0.2, 0.3)


def test_pressures_are_the_quantiles_of_drawn_parameters() -> None:
    """By forces of 4000 draws of all uncertain parameters, at ten states of a random motion."""
    motion = random_trajectory(CAT, duration=5, rate=2, seed=3)
    known, rng = UncertainParameters.stated(CAT), np.random.default_rng(1)
    drawn = known.mean + rng.standard_normal((4000, known.root.shape[1])) @ known.root.T
    boom = [each.name for each in CAT.machine.actuators].index("boom_cylinder")
    force = np.array([forces(CAT, motion, psi)[:, boom] for psi in drawn])
    (area, other), limits = CAT.machine.actuators[boom].areas, Limits(CAT)
    row = [row.name for row in limits.rows].index("boom_cylinder p_head")
    values = limits.values(motion.q, motion.qd, motion.qdd)[:, row] * limits.scale[row]
    head = (force + other * limits.back_pressure) / area
    np.testing.assert_allclose(np.mean(head <= values, axis=0), 0.99, atol=0.006)


def test_reserves_narrow_what_limits_allow() -> None:
    limits, itself = Limits(CAT, Reserves(certainty=0.5)), Limits(CAT, Reserves.none())
    state = np.array([[0.1, -0.4, 1.9]])
    kept, bare = (courses(each, state, 0 * state, 0 * state) for each in (limits, itself))
    assert kept["pump flow"].use.upper == pytest.approx(0.9 * bare["pump flow"].use.upper)
    assert kept["boom_cylinder p_head"].use.upper == pytest.approx(0.9 * bare["boom_cylinder p_head"].use.upper)
    assert kept["stick above ground"].use.lower == pytest.approx(
        bare["stick above ground"].use.lower + 0.3 + kept["stick above ground"].use.margin)
    assert kept["distance of stick to cab"].use.lower == pytest.approx(
        0.3 + kept["distance of stick to cab"].use.margin)
    foot, weight = CAT.machine.footprint, 9.81 * sum(
        CAT.parameters.nominal[block.start] for block in CAT.parameters.bodies.values())
    assert kept["tipping over edge 1"].use.lower == pytest.approx(0.1 * 1.2 * (weight + 9.81 * foot.mass), rel=1e-3)


def test_a_resting_machine_is_judged_alike_moving_and_stopped() -> None:
    """Rows of the same name; what a motion adds is in one of them only."""
    limits = Limits(CAT, Reserves.none())
    rows = [k for k, row in enumerate(limits.rows) if row.name == "tipping over edge 2"]
    assert len(rows) == 2
    rng = np.random.default_rng(0)
    q, qd, qdd = (rng.uniform(-0.3, 0.3, (5, 3)) for _ in range(3))
    still, moving = limits.values(q, 0 * q, 0 * q)[:, rows], limits.values(q, qd, qdd)[:, rows]
    np.testing.assert_allclose(still[:, 0], still[:, 1], atol=1e-12)
    np.testing.assert_allclose(moving[:, 1], still[:, 1], atol=1e-12)
    assert np.max(np.abs(moving[:, 0] - still[:, 0])) > 1e-3
