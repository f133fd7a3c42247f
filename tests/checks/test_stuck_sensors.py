"""Sensors that are stuck, scatter or exceed relief pressure are named; sound ones, at rest or saturated, are not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fixtures.tiers import tiered
from hydroopt.checks.plausibility import examine
from hydroopt.checks.sensors import beyond_relief, scattering, stuck_sensors
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.log_check import check_logs
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.estimation.dynamic.training_logs import contradictions
from hydroopt.logs.log import Log
from hydroopt.logs.log_files import read_log
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory, random_truth, simulate

PRESSURES = [("cat215b", "boom_cylinder.p_head"), ("cat215b", "boom_cylinder.p_rod"), ("cat215b", "swing_motor.p_a"),
             ("wheel_loader", "tilt_cylinder.p_head"), ("wheel_loader", "lift_cylinder.p_rod")]


def sound(name: str, seed: int = 1) -> tuple[Model, Log]:
    model = Model(load_machine(name))
    motion = random_trajectory(model, duration=20.0, rate=50.0, seed=seed)
    return model, simulate(model, motion, random_truth(model, seed), seed=seed)


def changed(log: Log, channel: str, values: np.ndarray) -> Log:
    return replace(log, channels={**log.channels, channel: values})


def held(x: np.ndarray, start: int, stop: int) -> np.ndarray:
    made = x.copy()
    made[start:stop] = made[start]
    return made


@pytest.mark.parametrize(("name", "channel"), PRESSURES)
@pytest.mark.parametrize("span", [(500, 1000), (0, 500), (300, 450)])
def test_a_stuck_pressure_is_named_first(name: str, channel: str, span: tuple[int, int]) -> None:
    model, log = sound(name)
    stuck = changed(log, channel, held(log.channels[channel], *span))
    found = check_logs(model, [stuck])
    assert found.status == "suspect"
    (first,) = found.contradictions
    assert (first.kind, first.subject) == ("sensor stuck", (channel,))
    assert found.verdict.cause.startswith(f"{channel} is stuck at ")
    assert first.evidence["count"] == pytest.approx(span[1] - span[0], abs=0.01 * log.size)


def test_the_answer_names_the_stuck_sensor_first() -> None:
    model, log = sound("wheel_loader")
    stuck = changed(log, "lift_cylinder.p_head", held(log.channels["lift_cylinder.p_head"], 500, 1000))
    answer = identify(identification_problem(model, [stuck]), intervals=False)
    assert answer.status == "suspect"
    assert answer.diagnostics[0].subject == ("lift_cylinder.p_head",)
    assert answer.content()["verdict"]["cause"].startswith("lift_cylinder.p_head is stuck at ")


def test_samples_that_are_held_out_are_examined_too() -> None:
    model, log = sound("patu655_lift")
    head = held(log.channels["lift_cylinder.p_head"], 600, 900)
    train, held_out = changed(log, "lift_cylinder.p_head", head).split(0.7)
    problem = identification_problem(model, [replace(train, sha256="1")], validation=[replace(held_out, sha256="1")])
    (found,) = contradictions(model, (*problem.experiments, *problem.validation))
    assert (found.kind, found.evidence["count"]) == ("sensor stuck", 300)


@pytest.mark.parametrize("name", tiered(["cat215b", "wheel_loader", "ur10", "forestry_crane"],
                                        lambda name: name != "forestry_crane"))
def test_sound_sensors_are_left_in_peace(name: str) -> None:
    for seed in (1, 2, 3):
        model, log = sound(name, seed)
        assert not list(stuck_sensors(model.machine, log, "run"))
        assert not list(scattering(model.machine, log, "run"))
        assert not list(beyond_relief(model.machine, log, "run"))


def test_rest_clipping_and_coarse_steps_are_no_stuck_sensor() -> None:
    model, log = sound("cat215b")
    head = log.channels["boom_cylinder.p_head"]
    at_rest = {name: held(x, 400, 800) for name, x in log.channels.items()}
    empty = np.maximum(head - np.quantile(head, 0.5), 0.0)
    coarse = 2e6 * np.round(head / 2e6)
    for sane in (replace(log, channels=at_rest), changed(log, "boom_cylinder.p_head", empty),
                 changed(log, "boom_cylinder.p_head", coarse)):
        assert not list(stuck_sensors(model.machine, sane, "run"))


@pytest.mark.parametrize(("name", "channel"), PRESSURES)
def test_a_pressure_ten_times_too_large_is_named_with_its_unit(name: str, channel: str) -> None:
    model, log = sound(name)
    found = examine(model, changed(log, channel, 10.0 * log.channels[channel]))
    assert channel in found[0].subject
    assert found[0].kind in ("log misread", "sensor scatters beyond its accuracy")
    assert "bar where MPa is stated" in found[0].evidence["reading"]


def test_noise_five_times_as_stated_and_pressures_beyond_relief_are_named() -> None:
    model, log = sound("cat215b")
    rng, rod = np.random.default_rng(0), "boom_cylinder.p_rod"
    sensor = model.machine.sensor(rod)
    assert sensor is not None
    noisy = changed(log, rod, log.channels[rod] + 8 * sensor.std * rng.standard_normal(log.size))
    (found,) = scattering(model.machine, noisy, "run")
    assert (found.kind, found.subject) == ("sensor scatters beyond its accuracy", (rod,))
    assert found.evidence["ratio"] == pytest.approx(np.hypot(8, 1), rel=0.1)
    (found,) = beyond_relief(model.machine, changed(log, rod, log.channels[rod] + 6e7), "run")
    assert (found.kind, found.subject) == ("beyond relief pressure", (rod,))


def test_a_stuck_angle_without_a_second_reading_is_shown_by_its_jump() -> None:
    model, log = sound("cat215b")
    alone = replace(log, channels={name: x for name, x in log.channels.items() if ".length" not in name})
    (found,) = examine(model, changed(alone, "boom.q", held(log.channels["boom.q"], 300, 500)))
    assert (found.kind, found.subject) == ("sensor stuck", ("boom.q",))
    assert "then jumps by" in found.text


@pytest.mark.parametrize("every", [3, 10])
def test_angles_that_the_logger_repeats_are_named_and_dropped(every: int, tmp_path: Path) -> None:
    model, log = sound("wheel_loader")
    rows = np.arange(log.size) // every * every
    slow = replace(log, channels={name: x[rows] if name.endswith((".q", ".length")) else x
                                  for name, x in log.channels.items()})
    (found,) = examine(model, slow)
    assert (found.kind, found.evidence["every"]) == ("sensor held", every)
    slow.write(tmp_path / "slow.csv")
    kept = read_log(tmp_path / "slow.csv", treatment={"held": "drop"})
    np.testing.assert_array_equal(kept.t, log.t[::every])
    assert examine(model, kept) == ()


def test_what_was_not_mapped_is_the_first_thing_to_do() -> None:
    model, log = sound("wheel_loader")
    lacking = replace(log, channels={name: x for name, x in log.channels.items() if name != "lift_cylinder.p_rod"})
    found = check_logs(model, [lacking])
    assert found.verdict.next_steps[0].text.startswith("Map or record lift_cylinder.p_rod: without, no equation of")
