"""What one log becomes: which channels are read, in which units, with which noise, and what is said of the rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydroopt.errors import LogError, ProblemError
from hydroopt.estimation.dynamic.experiment import experiment
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.logs.joint_angles import angle_noise
from hydroopt.logs.log import Log
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import read_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory, simulate

TELESCOPE = {
    "name": "telescope",
    "links": [{"name": "tele", "parent": "base",
               "joint": {"type": "prismatic", "lower": 0.0, "upper": 2.0, "friction": {"coulomb": 0.0}}}],
    "drives": [{"name": "drive", "joint": "tele"}]}


@pytest.fixture(scope="module")
def telescope() -> tuple[Model, Log]:
    model = Model(Machine.model_validate(TELESCOPE))
    return model, simulate(model, random_trajectory(model, duration=33.28, rate=20, seed=1))


@pytest.fixture(scope="module")
def log(cat215b: Model) -> Log:
    return simulate(cat215b, random_trajectory(cat215b, duration=33.28, rate=20, seed=1), seed=1)


def without(log: Log, *ends: str) -> Log:
    return replace(log, channels={name: x for name, x in log.channels.items() if not name.endswith(ends)})


def in_unit(log: Log, channel: str, unit: str) -> Log:
    return replace(log, units={**log.units, channel: unit})


def test_an_angle_on_a_sliding_joint_is_refused(telescope: tuple[Model, Log]) -> None:
    model, log = telescope
    assert experiment(model, log).force.shape == (log.t.size, 1)
    for channel, unit, want in (("tele.q", "rad", "'m'"), ("tele.tau", "N*m", "'N'")):
        with pytest.raises(LogError, match="prismatic") as refusal:
            experiment(model, in_unit(log, channel, unit))
        said = str(refusal.value)
        assert said.startswith("simulated: ")
        assert all(word in said for word in (f"'{channel}'", f"'{unit}'", want, "'tele'"))


def test_a_length_on_a_turning_joint_is_refused(cat215b: Model, log: Log) -> None:
    with pytest.raises(LogError, match=r"'boom\.q' is of the kind 'm'.*revolute and needs 'rad'"):
        experiment(cat215b, in_unit(log, "boom.q", "m"))


def test_channels_not_used_are_named(cat215b: Model, log: Log) -> None:
    rates = {"boom.qd": np.zeros(log.t.size), "boom_valve.u": np.zeros(log.t.size)}
    more = replace(log, channels={**log.channels, **rates})
    (said,) = [note for note in experiment(cat215b, more).notes if note.startswith("not used")]
    assert said == "not used: boom_cylinder.length, stick_cylinder.length, boom.qd, boom_valve.u"
    assert not any("not used" in note for note in experiment(cat215b, without(log, ".length")).notes)


def test_measured_lengths_are_compared_with_the_geometry(cat215b: Model, log: Log) -> None:
    wave = 0.003 * np.sqrt(2) * np.sin(log.t)
    off = replace(log, channels={**log.channels, "boom_cylinder.length": log.channel("boom_cylinder.length")
                                 + 0.0074 + wave - np.mean(wave)})
    (boom, stick) = [note for note in experiment(cat215b, off).notes if "differs from the geometry" in note]
    assert boom.startswith("boom_cylinder.length differs from the geometry by 7.")
    mean, std = (float(word) for word in boom.replace(" mm", "").split() if word[0].isdigit())
    assert mean == pytest.approx(7.4, abs=0.2)
    assert std == pytest.approx(np.hypot(3.0, 1.6), abs=0.5)  # the wave, and the noise of length and angle
    mean, std = (float(word) for word in stick.replace(" mm", "").split() if word.lstrip("-")[0].isdigit())
    assert abs(mean) < 0.2
    assert std < 2.5
    by_length = experiment(cat215b, without(log, "boom.q", "stick.q"))
    assert not any("differs from the geometry" in note for note in by_length.notes)


def test_pressures_go_before_a_force(cat215b: Model, log: Log) -> None:
    both = replace(log, channels={**log.channels, "boom_cylinder.force": np.zeros(log.t.size)})
    np.testing.assert_array_equal(experiment(cat215b, both).force, experiment(cat215b, log).force)
    assert any("boom_cylinder.force" in note for note in experiment(cat215b, both).notes if "not used" in note)


def test_noise_of_an_angle_that_comes_from_a_length(cat215b: Model, log: Log) -> None:
    """Monte Carlo: the scatter of the angle about the true one."""
    rng = np.random.default_rng(0)
    motion = random_trajectory(cat215b, duration=33.28, rate=20, seed=1)
    true = simulate(cat215b, motion, noise=False)
    sensor = cat215b.machine.sensor("boom_cylinder.length")
    assert sensor is not None
    noisy = true.channel("boom_cylinder.length") + rng.normal(0, sensor.std, true.t.size)
    scatter = np.std(np.asarray(cat215b.triangles["boom_cylinder"][1](noisy)).ravel() - motion.q[:, 1])
    noise = angle_noise(cat215b, without(log, "boom.q"))
    assert noise[1] == pytest.approx(scatter, rel=0.1)
    resolver = cat215b.machine.sensor("boom.q")
    assert resolver is not None
    np.testing.assert_array_equal(noise[[0, 2]], resolver.std)


def test_a_joint_without_stated_sensor_is_cross_validated_alone(cat215b: Model, log: Log) -> None:
    some = [s.model_copy(update={"channels": ("swing.q", "stick.q")}) if "boom.q" in s.channels else s
            for s in cat215b.machine.sensors]
    model = Model(cat215b.machine.model_copy(update={"sensors": tuple(some)}))
    np.testing.assert_array_equal(np.isnan(angle_noise(model, log)), [False, True, False])
    notes = [note for note in experiment(model, log).notes if "smoothing spline" in note]
    assert ["cross-validation" in note for note in notes] == [False, True, False]


def test_noise_of_a_force_is_that_of_the_sensor_that_the_log_has(cat215b: Model, log: Log) -> None:
    data = cat215b.machine.model_dump()
    data["sensors"] = [*data["sensors"], {"channels": ("boom_cylinder.force",), "accuracy": 300.0,
                                          "distribution": "gaussian"}]
    model = Model(Machine.model_validate(data))
    direct = replace(without(log, "boom_cylinder.p_rod"), channels={
        **without(log, "boom_cylinder.p_rod").channels, "boom_cylinder.force": np.zeros(log.t.size)})
    by_pressure = force_noise(model)
    np.testing.assert_array_equal(force_noise(model, log), by_pressure)
    np.testing.assert_array_equal(force_noise(model, direct), [by_pressure[0], 300.0, by_pressure[2]])
    assert np.isnan(force_noise(cat215b, direct)[1])


def test_a_machine_without_bodies_and_friction_is_refused_in_a_sentence() -> None:
    machine = read_machine(
        'name = "arm"\n[[links]]\nname = "lift"\n'
        'joint = { type = "revolute", a = "1 m", lower = "0 deg", upper = "60 deg" }\n'
        '[[drives]]\nname = "drive"\njoint = "lift"\n')
    log = simulate(Model(machine), random_trajectory(Model(machine), duration=5, rate=20, seed=1), seed=1)
    for refused in (lambda: experiment(Model(machine), log), lambda: identification_problem(machine, [log])):
        with pytest.raises(ProblemError, match="arm: the machine file states neither bodies nor friction"):
            refused()
