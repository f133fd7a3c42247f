"""Cranes with a load that swings freely: what the correction for noise of angles does, also where it is stated wrong.

None of them played a part in the making of the correction (`hydroopt/estimation/dynamic/regressor_noise.py`).
"""

import tempfile
from contextlib import AbstractContextManager, nullcontext
from functools import cache
from unittest.mock import patch

import numpy as np

from hydroopt import Machine, Model, read_machine
from hydroopt.errors import HydrooptError
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.simulation.simulate import random_trajectory, random_truth, simulate
from hydroopt.study.run import run as computed
from hydroopt.study.study import Study, Value, Values, seeds

CELLS, SEED = 8, 20
"""Cranes of each kind, drawn from the confidences of their file, and the seed of their seeds."""
DURATION, RATE = 33.28, 50.0
"""Length [s] of each motion, and samples per second [Hz]."""
STATED = {"right": 1.0, "half": 2.0, "double": 0.5}
"""What the file states of the angles' noise, and the true noise as a multiple of that."""
TRIALS = (("right", "with"), ("right", "without"), ("half", "with"), ("double", "with"))
"""What is stated, and whether the correction is applied, of what is tried."""

LOG = """
based_on = "forestry_crane"
name = "log_in_grapple"
[[links]]
name = "swing"
joint = { friction = { viscous = { value = "60 N*m*s/rad", sigma = "60 N*m*s/rad" } } }
[[links]]
name = "sway"
joint = { friction = { viscous = { value = "60 N*m*s/rad", sigma = "60 N*m*s/rad" } } }
[[links]]
name = "rotator"
[links.body]
m = { value = "850 kg", sigma = "20 %" }
com = { value = ["0 m", "0 m", "0.9 m"], sigma = "0.1 m" }
[links.body.inertia_com]
value = ["1060 kg*m^2", "0 kg*m^2", "0 kg*m^2", "160 kg*m^2", "0 kg*m^2", "1040 kg*m^2"]
sigma = "30 %"
"""
LIGHT = """
based_on = "forestry_crane"
name = "light_tool"
[[links]]
name = "swing"
joint = { friction = { viscous = { value = "5 N*m*s/rad", sigma = "5 N*m*s/rad" } } }
[[links]]
name = "sway"
joint = { friction = { viscous = { value = "5 N*m*s/rad", sigma = "5 N*m*s/rad" } } }
[[links]]
name = "rotator"
[links.body]
m = { value = "90 kg", sigma = "20 %" }
com = { value = ["0 m", "0 m", "0.3 m"], sigma = "0.05 m" }
[links.body.inertia_com]
value = ["6 kg*m^2", "0 kg*m^2", "0 kg*m^2", "5 kg*m^2", "0 kg*m^2", "3 kg*m^2"]
sigma = "30 %"
"""
HOOK = """
based_on = "knuckle_boom_crane"
name = "load_on_hook"
bandwidth = "2 Hz"
[[links]]
name = "telescope"
joint = { alpha = "-90 deg" }
[[links]]
name = "swing"
parent = "telescope"
[links.joint]
type = "revolute"
passive = true
theta = "-90 deg"
a = "0.2 m"
alpha = "90 deg"
lower = "-200 deg"
upper = "120 deg"
friction = { viscous = { value = "12 N*m*s/rad", sigma = "12 N*m*s/rad" } }
[links.body]
m = { value = "14 kg", sigma = "20 %" }
com = { value = ["0.1 m", "0 m", "0 m"], sigma = "0.02 m" }
[links.body.inertia_com]
value = ["0.02 kg*m^2", "0 kg*m^2", "0 kg*m^2", "0.08 kg*m^2", "0 kg*m^2", "0.08 kg*m^2"]
sigma = "30 %"
[[links]]
name = "hook"
parent = "swing"
[links.joint]
type = "revolute"
passive = true
a = "1.2 m"
lower = "-80 deg"
upper = "80 deg"
friction = { viscous = { value = "12 N*m*s/rad", sigma = "12 N*m*s/rad" } }
[links.body]
m = { value = "420 kg", sigma = "20 %" }
com = { value = ["1.0 m", "0 m", "0 m"], sigma = "0.08 m" }
[links.body.inertia_com]
value = ["35 kg*m^2", "0 kg*m^2", "0 kg*m^2", "50 kg*m^2", "0 kg*m^2", "60 kg*m^2"]
sigma = "30 %"
[[sensors]]
channels = ["slew.q", "main.q", "knuckle.q", "swing.q", "hook.q"]
accuracy = "0.1 deg"
[[sensors]]
channels = ["telescope.q"]
accuracy = "3 mm"
[[sensors]]
channels = ["slewing_rack.p_a", "slewing_rack.p_b", "main_cylinder.p_head", "main_cylinder.p_rod",
            "knuckle_cylinder.p_head", "knuckle_cylinder.p_rod", "telescope_cylinder.p_head",
            "telescope_cylinder.p_rod"]
accuracy = "1.5 bar"
"""
KINDS = {"log": (LOG, 2.0), "light": (LIGHT, 1.5), "hook": (HOOK, 1.0)}
"""A log of 4.5 m in the grapple, a light tool without much of a brake, a load on the hook of a knuckle-boom crane; and
the accuracy of their angles over that of the file that they are based on."""


def swinging(name: str, cells: int = CELLS) -> dict:
    """Coverage and growth of what swings, with and without the correction, by what is stated of the noise."""
    own = tuple({"kind": name, "seed": seed} for seed in seeds(SEED, cells))
    with tempfile.TemporaryDirectory() as folder:
        table = computed(Study("swinging", cell, own, {"machine": _model(name, 1.0).machine.sha256}), folder, workers=2)
    found: dict = {f"{name}_machines": len(table)}
    for key in table.results[0]:
        values = table.column(key)
        values = values[np.isfinite(values)]
        found[f"{name}_{key}"] = float(values.mean()) if values.size else None
        if key.endswith("grown") and values.size > 1:
            found[f"{name}_{key}_std_error"] = float(values.std(ddof=1) / np.sqrt(values.size))
    return {key: value if value is None else round(value, 4) for key, value in found.items()}


def cell(*, kind: str, seed: int) -> Values:
    """A crane of the kind on a random motion: whether there is an answer, and one without a warning, shares of its
    intervals that hold, and by how many standard deviations parameters of what swings are too large in the mean."""
    of_truth, of_motion, of_noise, of_sampling = seeds(seed, 4)
    model, found = _model(kind, 1.0), dict[str, Value]()
    truth = random_truth(model, of_truth)
    motion = random_trajectory(model, duration=DURATION, rate=RATE, seed=of_motion)
    swings = np.array([each.startswith(_swinging(model.machine)) for each in model.parameters.names])
    logs = {stated: simulate(_model(kind, factor), motion, truth, seed=of_noise) for stated, factor in STATED.items()}
    for stated, way in TRIALS:
        try:
            with _without() if way == "without" else nullcontext():
                estimate = identify(identification_problem(model, [logs[stated]]), seed=of_sampling)
        except (HydrooptError, np.linalg.LinAlgError):
            found |= {f"{stated}_{way}_{key}": value for key, value in {
                "answers": 0, "ok": 0, "coverage": None, "others": None, "grown": None}.items()}
            continue
        low, high = estimate.ci95.T
        shown, inside = np.isfinite(low), (low <= truth) & (truth <= high)
        sized = shown & swings & (model.parameters.nominal != 0)
        grown = np.sign(truth[sized]) * (estimate.value - truth)[sized] / estimate.std[sized]
        found |= {f"{stated}_{way}_{key}": float(value) for key, value in {
            "answers": 1, "ok": estimate.status == "ok", "coverage": np.mean(inside[shown & swings]),
            "others": np.mean(inside[shown & ~swings]), "grown": np.mean(grown)}.items()}
    return found


def _without() -> AbstractContextManager[object]:
    """A context in which nothing is corrected."""
    return patch("hydroopt.estimation.dynamic.experiment.undriven", lambda balances: ())


def _swinging(machine: Machine) -> tuple[str, ...]:
    """How names of parameters begin that swing freely: those of passive links and of what they carry."""
    found: list[str] = []
    for link in machine.links:
        if link.joint.passive or link.parent in found:
            found.append(link.name)
    return tuple(f"{link}." for link in found)


@cache
def _model(kind: str, factor: float) -> Model:
    """A crane whose angles are read with so many times the stated noise."""
    text, accuracy = KINDS[kind]
    machine = read_machine(text)
    sensors = tuple(each.model_copy(update={"accuracy": accuracy * factor * each.accuracy})
                    if each.channels[0].endswith(".q") else each for each in machine.sensors)
    return Model(machine.model_copy(update={"sensors": sensors}))
