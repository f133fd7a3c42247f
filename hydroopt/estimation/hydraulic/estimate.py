"""Valves, oil and friction identified: free runs, the calibrated machine, and what is in doubt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hydroopt.estimation.hydraulic import shooting
from hydroopt.estimation.hydraulic.dynamics import Record
from hydroopt.estimation.hydraulic.problem import HydraulicProblem
from hydroopt.estimation.hydraulic.shooting import ShootingEstimate
from hydroopt.machine.components import Note
from hydroopt.machine.machine import Machine
from hydroopt.results.fit import Fit
from hydroopt.spatial.inertia import Array

SETTLED = 1.0
"""Seconds at the beginning of an unseen log from which its first states are estimated."""


@dataclass(frozen=True)
class FreeRun(Fit):
    """How well a channel is predicted from commands and supply alone.

    Besides RMS and VAF the largest error [`unit`], and the RMS as a part of the range that the channel covers.
    """

    largest: float
    of_range: float


@dataclass(frozen=True, eq=False)
class Run:
    """One stretch of a log beside its free run: states (N, nx) and outputs (N, ny)."""

    record: Record
    states: Array
    outputs: Array


@dataclass(frozen=True, eq=False)
class HydraulicEstimate:
    """A solved problem.

    Attributes:
        problem: what was solved.
        shooting: the answer with its intervals; σ of each channel as large as what was left unexplained showed.
    """

    problem: HydraulicProblem
    shooting: ShootingEstimate
    status: str = "ok"

    def __getitem__(self, name: str) -> float:
        """Value of a parameter."""
        return self.shooting[name]

    @cached_property
    def runs(self) -> Mapping[str, tuple[Run, ...]]:
        """Free runs over what was fitted, ``train``, and what was held out, ``validation``."""
        records = self.shooting.problem.records
        found = {"train": tuple(self.run(r, points[0]) for r, points in zip(records, self.shooting.at.points,
                                                                            strict=True))}
        unseen = [record for log in self.problem.validation for record in self.problem.records(log)]
        return found | {"validation": tuple(self.run(r, self.first_states(r)) for r in unseen)}

    def run(self, record: Record, first: Array) -> Run:
        """The machine from first states (nx,) on, driven by a record's commands and supply.

        Raises:
            SolverError: the states run away.
        """
        return Run(record, *self.shooting.free_run(record, first))

    def first_states(self, record: Record) -> Array:
        """States (nx,) at the beginning of a record, from its first second and what is known of the machine.

        Raises:
            SolverError: none fits.
        """
        count = max(2, int(np.searchsorted(record.t, record.t[0] + SETTLED)))
        short = replace(record, t=record.t[:count], u=record.u[:count], y=record.y[:count], guess=record.guess[:count])
        theta, known = self.shooting.theta, self.shooting.problem
        held = replace(known.parameters, nominal=theta, lower=theta, upper=theta)
        first: Array = shooting.multiple_shooting(replace(known, parameters=held, records=(short,))).at.points[0][0]
        return first

    @cached_property
    def fit(self) -> dict[str, dict[str, FreeRun]]:
        """Free runs by data set and channel."""
        return {name: free_run_fit(self.problem, runs) for name, runs in self.runs.items() if runs}

    @property
    def doubts(self) -> tuple[str, ...]:
        """What the data cannot tell, and where the model does not explain them, in plain words."""
        left = [f"{channel} differs from the model by {factor:.1f} times its sensor's error"
                for channel, factor in zip(self.problem.channels, self.misfit, strict=True) if factor > MISFIT]
        return (*left, *self.shooting.doubts)

    @property
    def misfit(self) -> Array:
        """(ny,) RMS of each channel's residuals in units of its sensor's σ."""
        left = np.concatenate(self.shooting.residuals) * self.shooting.problem.sigma / self.problem.sigma
        return np.asarray(np.sqrt(np.nanmean(left**2, axis=0)))

    @property
    def machine(self) -> Machine:
        """The machine with what was identified, and its confidences; a prior for other logs.

        Of bodies, which forces show only in combinations, the confidences stay what they were.
        """
        return _calibrated(self)

    def __str__(self) -> str:
        lines = [f"{self.problem.plant.machine.name}: valves, oil and friction: {self.status}"]
        for name, table in self.fit.items():
            for channel, fit in table.items():
                lines.append(f"  {name:<10} {channel:<24} free run RMS {fit.rms:10.4g} {fit.unit:<4} largest "
                             f"{fit.largest:10.4g}  {100 * fit.of_range:6.2f} % of the range  "
                             f"VAF {100 * fit.vaf:6.2f} %")
        return "\n".join(lines)


MISFIT = 1.5
"""How many times a sensor's error the residuals have to be for the model to count as not explaining them."""


def identify_hydraulics(problem: HydraulicProblem, start: Array | None = None) -> HydraulicEstimate:
    """Identify valves, oil and friction by multiple shooting.

    Solved twice: the second time with each channel's σ as large as the residuals of the first show, and residuals that
    repeat themselves counted as one, so that what the model lacks does not make intervals too narrow.

    Raises:
        SolverError: no trustworthy answer.
    """
    first = shooting.multiple_shooting(problem.shooting, start)
    return HydraulicEstimate(problem, shooting.multiple_shooting(first.reweighted, first))


def free_run_fit(problem: HydraulicProblem, runs: Sequence[Run]) -> dict[str, FreeRun]:
    """Figures of free runs by channel."""
    read = np.concatenate([run.record.y for run in runs])
    error = np.concatenate([run.outputs for run in runs]) - read
    units = problem.plant.machine.channel_units
    table = {}
    for k, channel in enumerate(problem.channels):
        there = np.isfinite(read[:, k])
        if not np.any(there):
            continue
        y, e = read[there, k], error[there, k]
        rms, spread = float(np.sqrt(np.mean(e**2))), float(np.ptp(y))
        size = float(np.sqrt(np.mean(y**2)))
        table[channel] = FreeRun(
            rms, float(1 - np.var(e) / np.var(y)) if spread else float("nan"), rms / size if size else float("inf"),
            units[channel], float(np.max(np.abs(e))), rms / spread if spread else float("inf"))
    return table


def _calibrated(estimate: HydraulicEstimate) -> Machine:
    problem, machine = estimate.problem, estimate.problem.plant.machine
    source = f"identified from {', '.join(log.path or log.name for log in problem.logs)}"
    numbers, values, notes = machine.numbers, {}, {}
    for name, value, std in zip(problem.parameters.names, estimate.shooting.theta.tolist(),
                                estimate.shooting.std.tolist(), strict=True):
        if name in numbers:  # directions of the bodies' parameters have no address
            values[name] = value
            sigma = {"sigma": std, "relative": False} if np.isfinite(std) else {}
            notes[name] = machine.notes.get(numbers[name].path, Note()).model_copy(update=sigma | {"source": source})
    if problem.bodies.shape[1]:
        parameters = problem.plant.model.parameters
        psi = np.asarray(problem.split(estimate.shooting.theta)[0]).ravel()
        for owner, columns in parameters.bodies.items():
            values |= dict(zip(parameters.names[columns], psi[columns].tolist(), strict=True))
            for element, was in (("m", "m"), ("mc_x", "com"), ("I_xx", "inertia_com")):
                name = f"{owner}.{element}"
                note = machine.notes.get(f"{owner}.body.{was}") or machine.notes.get(numbers[name].path)
                if note is not None:
                    notes[name] = note.model_copy(update={"source": source})
    return machine.with_values(values, notes)
