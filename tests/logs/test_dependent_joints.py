"""Sensors on joints that follow loops and couplings: a rocker's angle instead of the bucket's."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hydroopt.errors import LogError
from hydroopt.logs.joint_angles import angle_channels, angle_noise, measured_angles
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import Trajectory, random_trajectory, simulate


@cache
def sensed(name: str, joint: str, dependent: str) -> tuple[Model, Trajectory]:
    """A bundled machine whose sensor of a joint sits on one that follows it."""
    data = load_machine(name).model_dump()
    data["sensors"] = [{**sensor, "channels": [channel.replace(f"{joint}.q", f"{dependent}.q")
                                               for channel in sensor["channels"]]} for sensor in data["sensors"]]
    model = Model(Machine.model_validate(data))
    return model, random_trajectory(model, duration=10.0, rate=20.0, seed=1)


@pytest.mark.parametrize(("name", "joint", "dependent"), [
    ("excavator_bucket", "bucket", "rocker"), ("scissor_lift", "left", "right"), ("forestry_crane", "first", "second")])
def test_the_joint_follows_from_the_one_that_follows_it(name: str, joint: str, dependent: str) -> None:
    model, motion = sensed(name, joint, dependent)
    log = simulate(model, motion, noise=False)
    channel = f"{dependent}.q"
    assert f"{joint}.q" not in log.channels
    assert channel in angle_channels(model, log)
    moved = [k for k, link in enumerate(model.machine.joints) if not model.machine.link(link).joint.passive]
    np.testing.assert_allclose(measured_angles(model, log)[:, moved], motion.q[:, moved], atol=1e-12)
    if log.units[channel] == "rad":
        turned = replace(log, channels={**log.channels, channel: log.channels[channel] + 2 * np.pi})
        np.testing.assert_allclose(measured_angles(model, turned), motion.q, atol=1e-12)


def test_noise_of_the_joint_is_that_of_the_sensor_through_the_mechanism() -> None:
    model, motion = sensed("excavator_bucket", "bucket", "rocker")
    errors = [measured_angles(model, log := simulate(model, motion, seed=seed)) - motion.q for seed in range(5)]
    scatter = np.std(np.concatenate(errors), axis=0)
    np.testing.assert_allclose(angle_noise(model, log), scatter, rtol=0.1)
    assert scatter[3] > 1.2 * scatter[2], "the rocker turns less than the bucket"


def test_angles_that_no_posture_has_are_named() -> None:
    """The coupler turns back while the bucket turns on, so that its angle does not tell the bucket's."""
    model, motion = sensed("excavator_bucket", "bucket", "coupler")
    with pytest.raises(LogError, match=r"no posture of bucket .* coupler.q = "):
        measured_angles(model, simulate(model, motion, noise=False))
    model, motion = sensed("excavator_bucket", "bucket", "rocker")
    log = simulate(model, motion, noise=False)
    far = replace(log, channels={**log.channels, "rocker.q": log.channels["rocker.q"] + np.pi})
    with pytest.raises(LogError, match=r"no posture of bucket .* sample 1: rocker.q = 4.036 rad.* changes steadily"):
        measured_angles(model, far)
