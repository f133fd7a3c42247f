"""The setting that all controllers share: machine, motion to follow, and models with known and true parameters."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from hydroopt.control.closed_loop import Controller, Run, simulate, tip
from hydroopt.control.linear_plant import Point, point
from hydroopt.control.reference import Demands, Reference, steady_speeds
from hydroopt.control.tuning import COMPLEMENTARY_SENSITIVITY, SENSITIVITY
from hydroopt.control.valve_inversion import Valves
from hydroopt.errors import ProblemError
from hydroopt.model.hanging import Hanging
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.model.workspace import SHARE, top_speed
from hydroopt.results.answer import load
from hydroopt.simulation.drive_valves import random_numbers, refuse_moving_base
from hydroopt.simulation.passive_joints import passive_motion
from hydroopt.simulation.simulate import Trajectory, forces, random_trajectory, random_truth, sampling_rate
from hydroopt.spatial.evenly_spread import halton
from hydroopt.spatial.inertia import Array
from hydroopt.support.input_file import read_json
from hydroopt.support.progress import Progress, silent

NOMINAL, REDUCED, COMPLETE, TRUE = "nominal", "reduced", "complete", "true"
MOTION_POINTS = 6
"""Points of the motion at which loops are analysed, and about which the LQG controller is designed."""
WORKSPACE_POINTS = 16
"""Postures over the joints' ranges at which loops are analysed as well."""
EDGE = 0.05
"""Part of a joint's range at each end that is left out."""


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
    motion = random_trajectory(model, duration=60.0, rate=5.0, seed=seed)
    start = complete.psi[list(model.parameters.select(small.parameters.names))]
    difference = _balances(model, motion, complete.psi) - _balances(small, motion, start)
    K = small.over(small.regressor if small.linear else small.linearised, motion.q, motion.qd, motion.qdd,
                   *([] if small.linear else [start]))[0]
    scale = small.parameters.scale
    typical = np.sqrt(np.mean(np.square(_balances(model, motion, complete.psi)), axis=0))
    change, *_ = np.linalg.lstsq((K * scale / typical[:, None]).reshape(-1, len(scale)),
                                 (difference / typical).ravel(), rcond=1e-8)
    return ModelVariant(REDUCED, "the reduced model nearest to the complete one", small, start + change * scale)


def _balances(model: Model, motion: Trajectory, psi: Array) -> Array:
    """What a motion demands of the balances (N, r); without pressure on seals where there are balances of joints."""
    if model.machine.one_each:
        return forces(model, motion, psi)
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
                                  random_truth(model, seed)), random_numbers(plant, seed))
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


@dataclass(frozen=True, eq=False)
class Setting:
    """A machine, a motion to follow and its true parameters.

    Attributes:
        plant: the machine as its controllers know it.
        motion: to follow.
        true: the machine's true model and dynamic parameters; its geometry and delays may differ from the plant's.
        true_theta: its hydraulic parameters.
        theta: hydraulic parameters that all controllers use.
        rate: of the controller [Hz].
        seed: of the sensors' errors; None for none.
        sensitivity: largest sensitivity for which gains are tuned.
        complementary_sensitivity: largest complementary one, the same for all.
        gain: factor on the tuned position gains.
        bias: by which the readings of the joints' angles are off (n,) [rad or m]; None for no bias.
    """

    plant: Plant
    motion: Trajectory
    true: ModelVariant
    true_theta: Array
    theta: Array
    rate: float
    seed: int | None = 0
    sensitivity: float = SENSITIVITY
    complementary_sensitivity: ClassVar[float] = COMPLEMENTARY_SENSITIVITY
    gain: float = 1.0
    bias: Array | None = None

    @cached_property
    def t(self) -> Array:
        """Times (N,) of the samples."""
        start, end = self.motion.t[0], self.motion.t[-1]
        return np.asarray(start + np.arange(int((end - start) * self.rate * (1 + 1e-9)) + 1) / self.rate)

    @cached_property
    def reference(self) -> Reference:
        """The motion between its samples; passive joints swing as the machine file's parameters make them.

        Raises:
            ProblemError: the base moves, or a passive joint leaves its range.
        """
        model, motion = self.plant.model, self.motion
        refuse_moving_base(self.plant, motion, "--motion")
        q, qd, qdd = passive_motion(model, motion.t, (motion.q, motion.qd, motion.qdd), model.parameters.nominal,
                                    motion.wrench)
        return Reference(replace(motion, q=q, qd=qd, qdd=qdd))

    @cached_property
    def demands(self) -> Demands:
        """References of the motion."""
        return Demands(Valves(self.plant, self.theta), self.reference, self.t)

    @cached_property
    def true_plant(self) -> Plant:
        """The true machine."""
        return self.plant if self.true.model is self.plant.model else Plant(self.true.model)

    def points(self, plant: Plant, psi: Array, theta: Array) -> list[Point]:
        """Operating points of the motion, then over the workspace, of a plant with parameters ψ and θ.

        Joints move at least at the part `SHARE` of their greatest speeds, see `steady_speeds`; passive ones hang.

        Raises:
            ProblemError: the supply cannot move the machine at a point of the motion.
        """
        machine = plant.machine
        hanging = Hanging(plant.model)
        least = SHARE * np.array([top_speed(plant, joint) if joint in plant.drivers else 0.0
                                  for joint in machine.joints])
        lower, upper = machine.ranges.T
        moments = self.t[0] + (np.arange(MOTION_POINTS) + 0.5) / MOTION_POINTS * (self.t[-1] - self.t[0])
        path = self.reference.at(moments)
        found, period = list[Point](), 1 / self.rate
        for t, q, qd in zip(moments, hanging.postures(path.q), np.where(least > 0, path.qd, 0.0), strict=True):
            speeds = steady_speeds(plant, q, qd, least)
            found.append(point(plant, f"motion at {t:.1f} s", q, speeds, psi, theta, period))
        n = len(least)
        for k, share in enumerate(halton(2 * n, WORKSPACE_POINTS)):
            direction = np.where(share[n:] < 0.5, -1.0, 1.0)
            q = hanging.postures((lower + (upper - lower) * (EDGE + (1 - 2 * EDGE) * share[:n]))[None])[0]
            try:
                found.append(point(plant, f"workspace {k + 1}", q, direction * least, psi, theta, period,
                                   on_motion=False))
            except ProblemError:  # the supply may be too weak for some postures
                continue
        return found

    def run(self, controller: Controller, progress: Progress = silent) -> Run:
        """What the true machine does with a controller.

        Raises:
            ProblemError: the motion's start cannot be held.
            SolverError: the plant could not be integrated.
        """
        return simulate(self.demands, controller, self.true_plant, self.true.psi, self.true_theta, seed=self.seed,
                        bias=self.bias, progress=progress)

    def tip_error(self, run: Run) -> Array:
        """Distance (N,) [m] of the last link's far end from where it should be."""
        return np.asarray(np.linalg.norm(
            tip(self.true_plant, run.q) - tip(self.plant, self.reference.at(run.t).q), axis=1))


def rate_of(plant: Plant, rate: float | None, motion: Trajectory) -> float:
    """Samples per second [Hz] of a controller: the given one, or the highest rate of a joint's sensor.

    Raises:
        ProblemError: at this rate the motion has no samples, or more than can be held in memory.
    """
    rate = sampling_rate(plant.machine) if rate is None else rate
    duration = float(motion.t[-1] - motion.t[0])
    if not (np.isfinite(rate) and rate > 0 and 10 <= duration * rate <= 1e6):
        raise ProblemError(f"a controller at {rate:g} Hz cannot follow a motion of {duration:g} s", where="--rate",
                           remedy="give a rate of some samples per second, such as 50 or 100 Hz")
    return rate
