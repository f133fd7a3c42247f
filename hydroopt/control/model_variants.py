"""Models given to controllers: with nominal, reduced, complete and true parameters."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.input_file import read_json
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.results.answer import load
from hydroopt.simulation import simulate
from hydroopt.simulation.drive_valves import random_numbers
from hydroopt.spatial.inertia import Array

NOMINAL, REDUCED, COMPLETE, TRUE = "nominal", "reduced", "complete", "true"


class ModelVariant(NamedTuple):
    """A model with the parameters that a controller uses, or with the true ones.

    Attributes:
        name: `NOMINAL`, `REDUCED`, `COMPLETE` or `TRUE`.
        text: origin of the parameters, in words.
        model: complete, or reduced.
        psi: its parameters (p,).
    """

    name: str
    text: str
    model: Model
    psi: Array


class Truth(NamedTuple):
    """The true parameters of a simulated machine: of bodies and friction, and of valves and oil (t,)."""

    variant: ModelVariant
    theta: Array


def reduced(complete: ModelVariant, *, seed: int = 0) -> ModelVariant:
    """The reduced model nearest to a complete one, as identification from exact forces would give it.

    Its parameters absorb barrels and rods as far as possible: least squares over the forces of a random motion, with
    the minimum-norm change where the solution is not unique.
    """
    model, small = complete.model, Model(complete.model.machine, actuator_inertia=False)
    motion = simulate.random_trajectory(model, duration=60.0, rate=5.0, seed=seed)
    start = complete.psi[list(model.parameters.select(small.parameters.names))]
    difference = _balances(model, motion, complete.psi) - _balances(small, motion, start)
    K = small.over(small.regressor if small.linear else small.linearised, motion.q, motion.qd, motion.qdd,
                   *([] if small.linear else [start]))[0]
    scale = small.parameters.scale
    typical = np.sqrt(np.mean(np.square(_balances(model, motion, complete.psi)), axis=0))
    change, *_ = np.linalg.lstsq((K * scale / typical[:, None]).reshape(-1, len(scale)),
                                 (difference / typical).ravel(), rcond=1e-8)
    return ModelVariant(REDUCED, "the reduced model nearest to the complete one", small, start + change * scale)


def _balances(model: Model, motion: simulate.Trajectory, psi: Array) -> Array:
    """What a motion demands of the balances (N, r); without pressure on seals where there are balances of joints."""
    if model.machine.one_each:
        return simulate.forces(model, motion, psi)
    still = [np.zeros((len(motion.t), len(model.machine.actuators)))] if model.needs_pressure else []
    return np.asarray(model.over(model.inverse_dynamics, motion.q, motion.qd, motion.qdd, *still, psi)[0][:, :, 0])


def nominal_of(estimate: Path, complete: Model) -> ModelVariant | None:
    """The nominal parameters of an estimate's machine; None if it did not estimate dynamic parameters.

    Args:
        estimate: its folder.
        complete: the model of its machine.

    Raises:
        ProblemError: the folder holds no estimate.
    """
    psi, positions = complete.parameters.nominal.copy(), complete.parameters.positions
    rows = [row for name, row in load(estimate).parameters.items() if name in positions]
    for row in rows:
        if row.nominal is not None:
            psi[positions[row.name]] = row.nominal
    return ModelVariant(NOMINAL, "the machine file before identification", complete, psi) if rows else None


def truth(source: str, plant: Plant, *, seed: int) -> Truth:
    """The true parameters of a simulated machine.

    A truth.json that states no valves and oil leaves them as in the machine file.

    Args:
        source: 'nominal', 'random' within the file's confidences, or a truth.json that `simulate` wrote.
        plant: the machine.
        seed: of a random truth.

    Raises:
        ProblemError: there is no such file, or it is of another machine.
        IdentifiabilityError: hardly any body within the stated confidences is physically consistent.
    """
    model, theta = plant.model, plant.parameters.nominal
    if source == "nominal":
        return Truth(ModelVariant(TRUE, "the machine file itself", model, model.parameters.nominal), theta)
    if source == "random":
        return Truth(ModelVariant(TRUE, "drawn from the confidences of the machine file", model,
                                  simulate.random_truth(model, seed)), random_numbers(plant, seed))
    if not os.path.isfile(source):
        raise ProblemError(f"'{source}' is not a truth", where="--truth",
                           remedy="use nominal, random, or the truth.json that simulate wrote")
    content = read_json(source, ProblemError)
    values, machine = content.get("parameters"), content.get("machine")
    names = model.parameters.names
    try:
        psi = np.array([float(values[name]) for name in names])  # type: ignore[index]
        theta = np.array([float(values.get(name, default)) for name, default in  # type: ignore[union-attr]
                          zip(plant.parameters.names, theta, strict=True)])
    except (TypeError, KeyError, ValueError):
        missing = next((name for name in names if not isinstance(values, dict) or name not in values), names[0])
        raise ProblemError(f"the truth of '{machine}' does not state '{missing}'", where=source,
                           remedy=f"simulate {model.machine.name} with the same parameters") from None
    if not (np.all(np.isfinite(psi)) and np.all(np.isfinite(theta))):
        raise ProblemError("a true parameter is not a number", where=source, remedy="simulate again")
    return Truth(ModelVariant(TRUE, "that of the simulated log", model, psi), theta)
