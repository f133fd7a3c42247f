"""Motions of machines with passive joints: these hang in every posture, and all limits are kept while they swing."""

import numpy as np
import pytest

import hydroopt as ho
from fixtures.drives import crane
from hydroopt.excitation.motion.basis import Fourier
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import read_machine
from hydroopt.model.hanging import Hanging
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import centre_of_mass


def test_what_hangs_has_its_centre_of_mass_below_its_pin() -> None:
    model = Model(crane(), actuator_inertia=False)
    machine, rng = model.machine, np.random.default_rng(3)
    low, high = machine.ranges.T
    q = Hanging(model).postures(rng.uniform(low, high, (50, len(low))))
    assert machine.joints[-1] == "grapple"
    ends = model.over(model.forward_kinematics, q)
    pose, before = ends[-1], ends[-2]
    assert machine.links[-1].body is not None
    # the far end lies 0.8 m along x of the frame in which the centre of mass is stated
    centre = centre_of_mass(machine.links[-1].body.phi) - [0.8, 0.0, 0.0]
    below = pose[:, :3, 3] + pose[:, :3, :3] @ centre - before[:, :3, 3]
    axis = before[:, :3, 2]
    across = np.cross(axis, [0.0, 0.0, 1.0])  # horizontal, in the plane in which it swings
    free = (q[:, -1] > low[-1] + 1e-6) & (q[:, -1] < high[-1] - 1e-6)
    assert free.sum() > 25
    assert np.max(np.abs(np.sum(across * below, axis=1)[free])) < 1e-6
    assert np.max(below[free, 2]) < -0.3


CHAIN = """
name = "chain"
orientation = ["90 deg", "0 deg", "0 deg"]
[[links]]
name = "arm"
joint = { type = "revolute", a = "1 m", lower = "10 deg", upper = "80 deg" }
[[links]]
name = "upper"
joint = { type = "revolute", a = "1 m", lower = "-130 deg", upper = "20 deg", passive = true }
body = { m = "10 kg", com = ["0.5 m", "0 m", "0 m"], inertia_com = ["0.1 kg*m^2", "0 kg*m^2", "0 kg*m^2", "1 kg*m^2", "0 kg*m^2", "1 kg*m^2"] }
[[links]]
name = "lower"
joint = { type = "revolute", a = "1 m", lower = "-90 deg", upper = "90 deg", passive = true }
body = { m = "30 kg", com = ["0.4 m", "0 m", "0 m"], inertia_com = ["0.1 kg*m^2", "0 kg*m^2", "0 kg*m^2", "1 kg*m^2", "0 kg*m^2", "1 kg*m^2"] }
[[drives]]
name = "motor"
joint = "arm"
"""  # noqa: E501


@pytest.mark.parametrize("start", [(-0.5, -0.3), (-1.0, 1.0), (-2.0, 1.3)])
def test_the_lower_of_two_links_hangs_down_where_the_upper_one_rests_on_its_stop(start: tuple[float, float]) -> None:
    """The upper stands at -130 deg of the arm, 80 deg up: it cannot reach -170 deg, at which it would hang."""
    model = Model(read_machine(CHAIN), actuator_inertia=False)
    (q,) = Hanging(model).postures(np.array([[np.radians(80), *start]]))
    assert q[1] == pytest.approx(np.radians(-130), abs=1e-12)
    assert q[2] == pytest.approx(np.radians(-40), abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_limits_are_kept_while_a_passive_joint_swings(seed: int) -> None:
    data = crane().model_dump()
    data["links"][-1]["joint"] |= {"max_speed": None, "max_acceleration": None}
    problem = ho.excitation_problem(Machine.model_validate(data), Fourier(period=8.0, harmonics=3), rate=50.0)
    motion = ho.solve(problem, starts=1, search_seconds=20.0, seed=seed)
    assert min(use.room for use in motion.limits) >= 0
    # the balance of what nothing drives holds in the simulated motion, not in the design
    (force,) = motion.problem.information.model.over(
        problem.information.model.inverse_dynamics, motion.trajectory.q, motion.trajectory.qd, motion.trajectory.qdd,
        np.tile(problem.information.model.parameters.nominal, (len(motion.trajectory.t), 1)))
    (grapple,) = [k for k, each in enumerate(problem.machine.balances) if not each.actuators]
    assert np.max(np.abs(force[:, grapple, 0])) < 1e-8 * np.max(np.abs(force))
    assert motion.gain > 1
    assert motion.excited == len(motion.names)


SLOPED = """
name = "sloped"
base_motion = { pitch = { lower = "-10 deg", upper = "10 deg" } }

[[links]]
name = "boom"
parent = "base"
joint = { type = "revolute", a = "2 m", lower = "-20 deg", upper = "50 deg" }

[[drives]]
name = "motor"
joint = "boom"
"""


def test_a_passive_joint_cannot_rest() -> None:
    with pytest.raises(ho.ProblemError, match="nothing holds the passive joint 'grapple' at rest"):
        ho.excitation_problem(crane(), Fourier(period=6.0, harmonics=2), resting={"grapple": 0.1})


def test_a_machine_without_parameters_is_refused() -> None:
    with pytest.raises(ho.IdentifiabilityError, match="no motion identifies a parameter"):
        ho.excitation_problem(read_machine(SLOPED), Fourier(period=6.0, harmonics=2))


def test_a_moving_base_rests_level_or_as_stated() -> None:
    machine, basis = read_machine(SLOPED + 'friction = { viscous = "5 N*m*s/rad" }'), Fourier(period=6.0, harmonics=2)
    assert ho.excitation_problem(machine, basis).resting == {"base_pitch": 0.0}
    assert ho.excitation_problem(machine, basis, resting={"base_pitch": 0.1}).resting == {"base_pitch": 0.1}
