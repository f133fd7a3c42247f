"""Gross mistakes in a log are named before any fit; sound logs are left in peace."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from hydroopt.checks.agreement import agreement
from hydroopt.checks.alternatives import alternatives
from hydroopt.checks.plausibility import examine
from hydroopt.logs.log import Log
from hydroopt.logs.log_files import read_log
from hydroopt.machine.machine_file import load_machine, read_machine
from hydroopt.model.model import Model
from hydroopt.results.diagnostic import of_kind
from hydroopt.simulation.simulate import random_trajectory, random_truth, simulate

Channels = Mapping[str, np.ndarray]


@pytest.fixture(scope="module")
def cat215b() -> Model:
    return Model(load_machine("cat215b"))


@pytest.fixture(scope="module")
def sound(cat215b: Model) -> Log:
    motion = random_trajectory(cat215b, duration=16.0, rate=50.0, seed=11)
    return simulate(cat215b, motion, random_truth(cat215b, 12), seed=13)


def scaled(names: Callable[[str], bool], factor: float) -> Callable[[Channels], Channels]:
    return lambda channels: {name: factor * x if names(name) else x for name, x in channels.items()}


def exchanged(one: str, other: str) -> Callable[[Channels], Channels]:
    return lambda channels: {**channels, one: channels[other], other: channels[one]}


def from_level(channels: Channels) -> Channels:
    return {**channels, "stick.q": channels["stick.q"] + channels["boom.q"]}


def without_lengths(log: Log) -> Log:
    return replace(log, channels={name: x for name, x in log.channels.items() if ".length" not in name})


MISTAKES = {
    "the sign of boom.q reversed": scaled(lambda name: name == "boom.q", -1.0),
    "swing.q, boom.q, stick.q in deg": scaled(lambda name: name.endswith(".q"), 180 / np.pi),
    "all pressures in bar": scaled(lambda name: ".p_" in name, 1e-5),
    "boom_cylinder.p_head and boom_cylinder.p_rod exchanged": exchanged("boom_cylinder.p_head", "boom_cylinder.p_rod"),
    "boom.q and stick.q exchanged": exchanged("boom.q", "stick.q"),
    "boom_cylinder.p_rod and stick_cylinder.p_head exchanged": exchanged("boom_cylinder.p_rod",
                                                                         "stick_cylinder.p_head"),
    "stick.q counted from the level, not from the link before": from_level,
    "boom.q counted from a zero 180 deg away": lambda channels: {**channels, "boom.q": channels["boom.q"] + np.pi},
    "swing.q, boom.q, stick.q in deg and all pressures in bar": lambda channels: scaled(
        lambda name: name.endswith(".q"), 180 / np.pi)(scaled(lambda name: ".p_" in name, 1e-5)(channels)),
}


def test_a_reversed_sign_is_named_without_lengths(cat215b: Model, sound: Log) -> None:
    reading, log = "the sign of boom.q reversed", without_lengths(sound)
    found = examine(cat215b, replace(log, channels=MISTAKES[reading](log.channels)))
    assert [each.evidence.get("reading") for each in found] == [reading]


def test_gaps_are_no_mistake(cat215b: Model, sound: Log) -> None:
    """Positions jump from one stretch to the next; that is no noise."""
    kept = np.arange(sound.size) % 70 < 64
    log = replace(sound, t=sound.t[kept], channels={name: x[kept] for name, x in sound.channels.items()},
                  sample=sound.sample[kept], segment=np.cumsum(~kept)[kept] // 6)
    assert len(set(log.segment)) == 12
    assert examine(cat215b, log) == ()


@pytest.mark.slow
@pytest.mark.parametrize("lengths", [True, False])
def test_each_mistake_is_named(cat215b: Model, sound: Log, lengths: bool) -> None:
    log = sound if lengths else without_lengths(sound)
    for reading, mistake in MISTAKES.items():
        found = examine(cat215b, replace(log, channels=mistake(log.channels)))
        assert [each.evidence.get("reading") for each in found] == [reading]


def test_a_reading_that_agrees_better_but_not_well_is_said_to(cat215b: Model, sound: Log) -> None:
    """Sense and zero of an angle are wrong at once, which no reading of the list mends."""
    log = without_lengths(sound)
    found = examine(cat215b, replace(log, channels={**log.channels, "stick.q": 3.2 - log.channels["stick.q"]}))
    assert found
    assert all("agrees better, though not well" in each.text for each in found if each.kind == "log misread")


@pytest.mark.slow
def test_milliseconds_taken_for_seconds_are_named(cat215b: Model, sound: Log) -> None:
    found = examine(cat215b, replace(sound, t=1e3 * sound.t))
    assert [(each.kind, each.evidence["reading"]) for each in found] == [("log misread", "the time in milliseconds")]


@pytest.mark.slow
def test_what_no_data_can_tell_apart_is_named_together(cat215b: Model, sound: Log) -> None:
    """The swing has no gravity: its sign and its chambers' order are one and the same to its forces."""
    found = examine(cat215b, replace(sound, channels=scaled(lambda name: name == "swing.q", -1.0)(sound.channels)))
    assert [set(each.subject) for each in found] == [{"swing.q", "swing_motor.p_a", "swing_motor.p_b"}]


def test_a_length_beside_its_angle_is_said(cat215b: Model, sound: Log) -> None:
    off = {**sound.channels, "boom_cylinder.length": sound.channels["boom_cylinder.length"] + 0.2}
    found = examine(cat215b, replace(sound, channels=off))
    assert [(each.kind, each.subject) for each in found] == [("length contradicts angle", ("boom_cylinder.length",))]


def test_readings_change_what_they_name_and_nothing_else(cat215b: Model, sound: Log) -> None:
    for other in alternatives(cat215b, sound):
        read = other.of(sound)
        changed = {name for name, x in sound.channels.items() if not np.array_equal(x, read.channels[name])}
        changed |= set() if np.array_equal(read.t, sound.t) else {"t"}
        assert changed == set(other.channels), other.words


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cat215b", "patu655_lift", "kr300", "ur10"])
def test_sound_logs_of_other_truths_raise_nothing(name: str) -> None:
    model = Model(load_machine(name))
    for seed in range(10):
        motion = random_trajectory(model, duration=16.0, rate=50.0, seed=seed)
        assert examine(model, simulate(model, motion, random_truth(model, seed), seed=seed)) == ()


ARM = """
name = "arm"
orientation = ["90 deg", "0 deg", "0 deg"]
sensors = [{ channels = ["lift.q", "reach.q"], accuracy = "0.05 deg" },
           { channels = ["lift.tau", "reach.tau"], accuracy = "20 N*m" }]
drives = [{ name = "lift_drive", joint = "lift" },
          { name = "reach_drive", joint = "reach", friction = { coulomb = "FRICTION", viscous = "100 N*m*s/rad" } }]
[[links]]
name = "lift"
joint = { type = "revolute", a = "2.8 m", lower = "0 rad", upper = "1 rad" }
BODY 320 12 260 290
[[links]]
name = "reach"
joint = { type = "revolute", lower = "-2 rad", upper = "-0.4 rad" }
BODY 150 9 140 145
"""


def arm(factor: float, sigma: str = "", friction: str = "0 N*m") -> Model:
    """The arm with bodies so many times as heavy, or with placeholders in their place."""
    def body(found: re.Match[str]) -> str:
        m, *moments = (factor * float(word) for word in found[1].split()) if factor else (0.03, 1.0, 1.0, 1.0)
        values = {"m": f"'{m} kg'", "com": f"['{1.2 * bool(factor)} m', '0 m', '0 m']", "inertia_com": str([
            f"{value} kg*m^2" for value in (moments[0], 0, 0, moments[1], 0, moments[2])])}
        unit = {"m": "kg", "com": "m", "inertia_com": "kg*m^2"}
        known = {key: f", sigma = '{sigma if '%' in sigma else f'{sigma} {unit[key]}'}'" * bool(sigma) for key in unit}
        return "body = { " + ", ".join(f"{key} = {{ value = {values[key]}{known[key]} }}" for key in unit) + " }"

    return Model(read_machine(re.sub("BODY (.*)", body, ARM).replace("FRICTION", friction)))


@pytest.fixture(scope="module")
def rubbing() -> Log:
    """A log of the arm with friction that its models lack."""
    truth = arm(1.0, friction="900 N*m")
    return simulate(truth, random_trajectory(truth, duration=20.0, rate=25.0, seed=1), seed=1)


@pytest.mark.parametrize(("factor", "sigma"), [(9.0, "100 %"), (0.0, ""), (0.0, "500")])
def test_a_log_that_the_stated_sigmas_explain_is_not_accused(rubbing: Log, factor: float, sigma: str) -> None:
    """Nominal forces nine times too large within a sigma of 100 %, and placeholders, refute no reading of forces."""
    assert not of_kind(examine(arm(factor, sigma), rubbing), "log misread")


@pytest.mark.parametrize("sigma", ["", "10 %"])
def test_a_log_beyond_the_sigmas_is_accused(rubbing: Log, sigma: str) -> None:
    beyond = replace(rubbing, channels=scaled(lambda name: name.endswith(".tau"), 1e3)(rubbing.channels))
    accused = of_kind(examine(arm(1.0, sigma), beyond), "log misread")
    assert [each.subject for each in accused] == [("lift.tau", "reach.tau")]


@pytest.mark.filterwarnings("error")
def test_a_log_of_two_samples_is_examined(cat215b: Model, sound: Log) -> None:
    assert not [each for each in examine(cat215b, sound.slice(0, 2)) if each.kind == "log misread"]


@pytest.mark.slow
def test_parts_of_a_real_run_are_not_accused() -> None:
    """In parts that hardly reverse, friction that the model lacks outweighs what priors admit, whatever the reading."""
    folder = Path(__file__).parents[2] / "data" / "kr300"
    run, model = read_log(folder / "run_A.mat", mapping=folder / "map.toml"), Model(load_machine("kr300"))
    for parts in (2, 3, 4, 5):
        edges = np.linspace(0, run.size, parts + 1).astype(int)
        for first, last in pairwise(edges.tolist()):
            assert not of_kind(examine(model, run.slice(first, last)), "log misread"), (parts, first)


PENDULUM = """
name = "pendulum"
orientation = ["90 deg", "0 deg", "0 deg"]
[[sensors]]
channels = ["boom.q", "hook.q"]
accuracy = "0.1 deg"
[[sensors]]
channels = ["lift.p_head", "lift.p_rod"]
accuracy = "0.5 bar"
[[links]]
name = "boom"
joint = { type = "revolute", a = "3 m", lower = "0 deg", upper = "60 deg" }
[links.body]
m = { value = "200 kg", sigma = "10 %" }
com = { value = ["1.4 m", "0 m", "0 m"], sigma = "0.1 m" }
inertia_com = { value = ["2 kg*m^2", "0 kg*m^2", "0 kg*m^2", "150 kg*m^2", "0 kg*m^2", "150 kg*m^2"], sigma = "50 %" }
[[links]]
name = "hook"
[links.joint]
type = "revolute"
passive = true
a = "0.6 m"
lower = "-190 deg"
upper = "10 deg"
friction = { viscous = "300 N*m*s/rad" }
[links.body]
m = { value = "150 kg", sigma = "10 %" }
com = { value = ["0.5 m", "0 m", "0 m"], sigma = "0.1 m" }
inertia_com = { value = ["9 kg*m^2", "0 kg*m^2", "0 kg*m^2", "9 kg*m^2", "0 kg*m^2", "9 kg*m^2"], sigma = "50 %" }
[[cylinders]]
name = "lift"
bore = "100 mm"
rod_diameter = "56 mm"
dead_length = "0.8 m"
stroke = "0.6 m"
barrel = { link = "base", pin = ["0.26 m", "-1.04 m", "0 m"] }
rod = { link = "boom", pin = ["0.3 m", "-0.1 m", "0 m"] }
"""


@pytest.mark.slow
def test_passive_joints_hide_no_mistake() -> None:
    """Nothing is read at a hinge that swings: what is left there is no contradiction, and refutes no other reading."""
    model = Model(read_machine(PENDULUM))
    log = simulate(model, random_trajectory(model, duration=20.0, rate=25.0, seed=1), random_truth(model, 2), seed=3)
    judged = agreement(model, log)
    assert judged is not None
    assert judged.missed.keys() == {"lift"}
    assert judged.worst < 1
    assert not examine(model, log)
    for mistake in (scaled(lambda name: name.endswith(".q"), 180 / np.pi), exchanged("lift.p_head", "lift.p_rod"),
                    scaled(lambda name: ".p_" in name, 1e-5)):
        wrong = without_lengths(replace(log, channels=dict(mistake(log.channels))))
        (found,) = of_kind(examine(model, wrong), "log misread")
        changed = {name for name, x in wrong.channels.items() if not np.array_equal(x, log.channels[name])}
        assert set(found.subject) == changed
