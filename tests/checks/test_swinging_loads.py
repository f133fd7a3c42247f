"""Logs of machines whose joints swing freely agree with their file, though nothing is read there."""

from dataclasses import replace

import pytest

from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.machine.machine_file import read_machine
from hydroopt.model.model import Model
from hydroopt.results.diagnostic import of_kind
from hydroopt.results.wording import Kind
from hydroopt.simulation.simulate import random_trajectory, random_truth, simulate

LOG = """
based_on = "forestry_crane"
name = "log_in_grapple"
[[links]]
name = "rotator"
[links.body]
m = { value = "850 kg", sigma = "20 %" }
com = { value = ["0 m", "0 m", "0.9 m"], sigma = "0.1 m" }
inertia_com = { value = ["1060 kg*m^2", "0 kg*m^2", "0 kg*m^2", "160 kg*m^2", "0 kg*m^2", "1040 kg*m^2"], sigma = "30 %" }
"""


@pytest.mark.slow
def test_a_heavy_load_is_no_exchange_of_pressures() -> None:
    """The forces that the file's bodies make at a hinge, of which none is read, had decided which pressures are which."""
    model = Model(read_machine(LOG))
    log = simulate(model, random_trajectory(model, duration=33.28, rate=50.0, seed=1), random_truth(model, 1), seed=1)
    found = identify(identification_problem(model, [log]), intervals=False)
    assert not of_kind(found.diagnostics, Kind.LOG_MISREAD)
    swapped = {"boom_cylinder.p_head": "boom_cylinder.p_rod", "boom_cylinder.p_rod": "boom_cylinder.p_head"}
    wrong = replace(log, channels={**log.channels, **{name: log.channels[other] for name, other in swapped.items()}})
    assert of_kind(identify(identification_problem(model, [wrong]), intervals=False).diagnostics, Kind.LOG_MISREAD)
