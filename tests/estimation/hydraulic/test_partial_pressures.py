"""Valves and oil from logs that lack pressures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydroopt.errors import LogError
from hydroopt.estimation.hydraulic.problem import UNREAD, hydraulic_problem
from hydroopt.logs.log import Log
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.results.diagnostic import of_kind
from hydroopt.simulation.drive_valves import drive
from hydroopt.solving import solve

PLANT = Plant(Model(load_machine("patu655_lift")))
PRESSURES = PLANT.machine.cylinders[0].chambers


@pytest.fixture(scope="module")
def log() -> Log:
    t = np.arange(160) / 50
    return drive(PLANT, t, 5.7 + np.cos(2 * t)[:, None], np.array([0.2]), seed=1)


def lacking(log: Log, *channels: str) -> Log:
    return replace(log, channels={name: x for name, x in log.channels.items() if name not in channels})


def test_one_chamber_alone_tells_of_the_valve(log: Log) -> None:
    whole, partly = (solve(hydraulic_problem(PLANT.machine, [each])) for each in (log, lacking(log, PRESSURES[1])))
    for name, one in whole.parameters.items():
        other = partly.parameters[name]
        if one.value and one.std and other.value is not None and other.std:
            assert abs(other.value - one.value) < 2 * other.std
    (said,) = of_kind(partly.diagnostics, "pressure not measured in a log")
    assert said.subject == (PRESSURES[1],)
    assert not of_kind(whole.diagnostics, "pressure not measured in a log")


def test_samples_without_a_pressure_do_not_count(log: Log) -> None:
    holes = np.where(np.arange(log.size) < 40, np.nan, log.channels[PRESSURES[0]])
    problem = hydraulic_problem(PLANT.machine, [replace(log, channels={**log.channels, PRESSURES[0]: holes})])
    (each,) = problem.balanced
    assert np.all(np.isfinite(each.readings.values))
    assert np.sum(each.readings.variance[:, 1] == UNREAD**2) == 40
    assert np.all(np.abs(solve(problem).adjustment.correction[0][:40, 1]) < UNREAD)


def test_an_actuator_without_any_pressure_is_refused(log: Log) -> None:
    with pytest.raises(LogError, match=r"there is no channel 'lift_cylinder\.p_head'"):
        hydraulic_problem(PLANT.machine, [lacking(log, *PRESSURES)])
