"""The motion that a log describes: a designed one as it stands, a measured one smoothed."""

import numpy as np
import pytest

from hydroopt import Log, LogError, Machine, Model, load_machine, random_trajectory
from hydroopt.simulation.reference_motion import reference_motion
from hydroopt.simulation.simulate import Trajectory

CAT = load_machine("cat215b")
DESIGNED = random_trajectory(Model(CAT), duration=20, rate=50, seed=2)


def log(machine: Machine, motion: Trajectory) -> Log:
    channels = {f"{joint}.{kind}": getattr(motion, kind)[:, k] for k, joint in enumerate(machine.joints)
                for kind in ("q", "qd", "qdd")}
    return Log("motion", motion.t, channels)


def test_a_designed_motion_is_taken_as_it_stands() -> None:
    found = reference_motion(CAT, log(CAT, DESIGNED))
    for kind in ("t", "q", "qd", "qdd"):
        np.testing.assert_array_equal(getattr(found, kind), getattr(DESIGNED, kind))


@pytest.mark.parametrize("kind", ["q", "qd", "qdd"])
def test_readings_with_noise_are_smoothed(kind: str) -> None:
    """As if the log had positions alone."""
    rng = np.random.default_rng(0)
    noise = {key: (key == kind) * size * rng.standard_normal(DESIGNED.q.shape)
             for key, size in (("q", 1e-3), ("qd", 0.1), ("qdd", 5.0))}
    read = Trajectory(DESIGNED.t, *(getattr(DESIGNED, key) + noise[key] for key in ("q", "qd", "qdd")))
    whole = log(CAT, read)
    channels = {name: values for name, values in whole.channels.items() if name.endswith(".q")}
    alone = Log("positions", whole.t, channels)
    found = reference_motion(CAT, whole)
    np.testing.assert_array_equal(found.qd, reference_motion(CAT, alone).qd)
    assert not np.array_equal(found.qd, read.qd)


def test_a_motion_beyond_a_joint_is_refused() -> None:
    beyond = Trajectory(DESIGNED.t, DESIGNED.q + 10, DESIGNED.qd, DESIGNED.qdd)
    with pytest.raises(LogError, match=r"swing\.q leaves the joint's range at sample 1"):
        reference_motion(CAT, log(CAT, beyond))
