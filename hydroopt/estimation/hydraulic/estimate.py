"""The answer of an identification of valves, oil and friction: parameters, free runs, the calibrated machine."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from hydroopt.estimation.hydraulic import shooting
from hydroopt.estimation.hydraulic.diagnostics import parameter_diagnostics, unexplained_channels
from hydroopt.estimation.hydraulic.dynamics import Record
from hydroopt.estimation.hydraulic.problem import HydraulicProblem
from hydroopt.estimation.hydraulic.shooting import ShootingEstimate
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine
from hydroopt.model.workspace import Sweep, workspace_sweeps
from hydroopt.results.answer import Answer
from hydroopt.results.diagnostic import Diagnostic
from hydroopt.results.fit import Fit
from hydroopt.results.json_file import Job, MachineId
from hydroopt.results.parameter_table import ParameterTable, row
from hydroopt.results.tables import csv_text, number
from hydroopt.results.verdict import Action, NextStep, Purpose, Use, judged
from hydroopt.results.wording import Kind
from hydroopt.spatial.inertia import Array

METHOD = "multiple shooting"
SETTLED = 1.0
"""Seconds at the beginning of a validation log from which its first states are estimated."""


@dataclass(frozen=True, eq=False)
class Run:
    """One stretch of a log beside its free run: states (N, nx) and outputs (N, ny)."""

    record: Record
    states: Array
    outputs: Array


@dataclass(frozen=True, eq=False, repr=False)
class HydraulicEstimate(Answer):
    """Valves, oil and friction identified from logs.

    Attributes:
        problem: what was solved.
        shooting: the solution with its intervals; each channel's σ is raised to what the residuals show.

    Example:
        >>> import hydroopt as ho
        >>> plant = ho.Plant(ho.Model(ho.load_machine("patu655_lift")))
        >>> t = np.arange(160) / 50
        >>> log = ho.drive(plant, t, 5.7 + np.cos(2 * t)[:, None], np.array([0.2]), seed=1)
        >>> estimate = ho.solve(ho.hydraulic_problem(plant.machine, [log]))
        >>> print(estimate.status, round(6e4 * estimate["lift_cylinder.rated_flow"].value), "L/min")
        ok 62 L/min
    """

    job = Job.HYDRAULICS

    problem: HydraulicProblem
    shooting: ShootingEstimate

    @property
    def machine_id(self) -> MachineId:
        """Which machine it is about."""
        return MachineId.of(self.problem.plant.machine)

    @property
    def method(self) -> str:
        """How it was computed."""
        return METHOD

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What the logs lack, what counts as exact, channels that the model does not explain, and parameters that the
        data do not determine."""
        held = self.problem.held_bodies
        exact = (Diagnostic(Kind.BODIES_HELD_EXACT, held, {}),) if held else ()
        lost = (Diagnostic(Kind.PRESSURE_NOT_MEASURED, channels, {"log": where})
                for where, channels in self.problem.lost_pressures.items())
        return (*lost, *exact, *unexplained_channels(self.problem.channels, self.misfit),
                *parameter_diagnostics(self.shooting))

    @cached_property
    def parameters(self) -> ParameterTable:
        """The parameters by name, with priors, values, intervals and identifiability."""
        found, stated = self.shooting, self.problem.parameters
        variance = np.diag(stated.information)
        prior_std = np.where(variance > 0, 1 / np.sqrt(np.where(variance > 0, variance, 1.0)), np.nan)
        return ParameterTable([
            row(name, stated.kinds[k], stated.units[k], nominal=float(stated.nominal[k]),
                prior_std=float(prior_std[k]), value=float(found.theta[k]), std=float(found.std[k]),
                ci95=found.ci95[k].tolist(), bound=stated.nearest_bound(k, found.theta[k]) if found.at_bound[k] else "",
                identifiability=found.category(name))
            for k, name in enumerate(stated.names)])

    @cached_property
    def uses(self) -> tuple[Use, ...]:
        """Which channels a run from the commands alone follows."""
        held_out = self.fit.get("validation")
        condition = "RMS of a free run from commands alone over a held-out log" if held_out else ""
        untested = "" if held_out else "no log was held out"
        return tuple(judged(Purpose.VALVES, channel, fit.rms, fit.unit, fit.of_range or 0.0, condition=condition,
                            untested=untested) for channel, fit in (held_out or self.fit["train"]).items())

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """What would test or improve it, or how to use it."""
        steps = []
        if self.problem.held_bodies:
            steps.append(NextStep(Action.CHECK, "Identify bodies, too: --bodies. Intervals here count them as exact."))
        steps.append(NextStep(Action.USE, "Tune controllers with 'hydroopt control' and this folder's machine file.")
                     if "validation" in self.fit else
                     NextStep(Action.CHECK, "Hold data out to test the free run: --validate LOG, or --holdout 0.3."))
        return tuple(steps)

    @property
    def inputs(self) -> tuple[Mapping[str, Any], ...]:
        """The logs it is from."""
        return self.problem.inputs

    def details(self) -> Mapping[str, Any]:
        """Conditioning, and the σ by which each channel was weighted."""
        problem, found, parameters = self.problem, self.shooting, self.problem.parameters
        units = problem.plant.machine.channel_units
        sizes = np.linalg.eigvalsh(found.data * np.outer(parameters.scale, parameters.scale))
        return {"base_parameters": [],
                "conditioning": {
                    "rank": int(np.sum(sizes > 1e-12 * sizes[-1])), "parameters": len(parameters),
                    "condition_number": number(np.sqrt(sizes[-1] / sizes[0]) if sizes[0] > 0 else np.inf),
                    "residual_scale": number(found.residual_scale)},
                "physical_consistency": {},
                "weights": {channel: {"sigma": float(sigma), "sensor_sigma": float(sensor), "unit": units[channel]}
                            for channel, sigma, sensor in zip(problem.channels, found.problem.sigma, problem.sigma,
                                                              strict=True)}}

    def files(self) -> Mapping[str, str]:
        """The calibrated machine, tables of parameters and fit, and the free runs, in SI.

        Raises:
            SolverError: a free run diverged.
        """
        return {f"{self.machine_name}.toml": dump_machine(self.machine), "parameters.csv": self.parameters.to_csv(),
                "fit.csv": csv_text([{"data": data, "channel": channel, **fit.as_dict()}
                                     for data, table in self.fit.items() for channel, fit in table.items()]),
                "free_run.csv": csv_text(list(self._samples()))}

    def _samples(self) -> Iterator[dict[str, Any]]:
        """Every sample of all logs: commands, readings, and the free run."""
        inputs = self.shooting.problem.dynamics.inputs
        for data, runs in self.runs.items():
            for k, run in enumerate(runs):
                for i, t in enumerate(run.record.t):
                    sample: dict[str, Any] = {"data": data, "stretch": k + 1, "t [s]": float(t)}
                    sample |= {name: float(u) for name, u in zip(inputs, run.record.u[i], strict=True)}
                    for channel, read, value in zip(self.problem.channels, run.record.y[i], run.outputs[i],
                                                    strict=True):
                        sample |= {channel: number(read), f"{channel} free": float(value)}
                    yield sample

    @cached_property
    def runs(self) -> Mapping[str, tuple[Run, ...]]:
        """Free runs over what was fitted, ``train``, and what was held out, ``validation``."""
        records = self.shooting.problem.records
        found = {"train": tuple(self.run(r, points[0]) for r, points in zip(records, self.shooting.solution.points,
                                                                            strict=True))}
        held_out = [record for log in self.problem.validation for record in self.problem.records(log)]
        return found | {"validation": tuple(self.run(r, self.first_states(r)) for r in held_out)}

    def run(self, record: Record, first: Array) -> Run:
        """The machine from first states (nx,) on, driven by a record's commands and supply.

        Raises:
            SolverError: the states diverge.
        """
        return Run(record, *self.shooting.free_run(record, first))

    def first_states(self, record: Record) -> Array:
        """States (nx,) at the beginning of a record, estimated from its first second with the identified parameters.

        Raises:
            SolverError: none fits.
        """
        count = max(2, int(np.searchsorted(record.t, record.t[0] + SETTLED)))
        short = replace(record, t=record.t[:count], u=record.u[:count], y=record.y[:count], guess=record.guess[:count])
        theta, known = self.shooting.theta, self.shooting.problem
        held = replace(known.parameters, nominal=theta, lower=theta, upper=theta)
        found = shooting.multiple_shooting(replace(known, parameters=held, records=(short,)))
        first: Array = found.solution.points[0][0]
        return first

    @cached_property
    def fit(self) -> Mapping[str, Mapping[str, Fit]]:
        """Free runs by data set and channel."""
        return {name: free_run_fit(self.problem, runs) for name, runs in self.runs.items() if runs}

    @property
    def misfit(self) -> Array:
        """(ny,) RMS of each channel's residuals in units of its sensor's σ."""
        left = np.concatenate(self.shooting.residuals) * self.shooting.problem.sigma / self.problem.sigma
        return np.asarray(np.sqrt(np.nanmean(left**2, axis=0)))

    @property
    def machine(self) -> Machine:
        """The machine with the identified values and their confidences; a prior for other logs.

        Of bodies, which forces identify only in combinations, the confidences stay what they were.
        """
        return _calibrated(self)

    @cached_property
    def sweeps(self) -> tuple[Sweep, ...]:
        """Frequency, damping and gain of every joint over the workspace; empty without a stated supply pressure."""
        psi, theta = (np.asarray(part).ravel() for part in self.problem.split(self.shooting.theta))
        return workspace_sweeps(self.problem.plant, psi, theta)


def identify_hydraulics(problem: HydraulicProblem, start: Array | None = None) -> HydraulicEstimate:
    """Identify valves, oil and friction by multiple shooting.

    The problem is solved twice: the second time each channel's σ is raised to what the residuals of the first show,
    their correlation included, so that unmodelled dynamics do not make the intervals too narrow.

    Args:
        problem: see `hydraulic_problem`.
        start: parameters (p,) of the initial guess; nominal if None.

    Raises:
        SolverError: IPOPT failed, or its answer failed the check.

    Example:
        See `HydraulicEstimate`.
    """
    first = shooting.multiple_shooting(problem.shooting, start)
    return HydraulicEstimate(problem, shooting.multiple_shooting(first.reweighted, first))


def free_run_fit(problem: HydraulicProblem, runs: Sequence[Run]) -> dict[str, Fit]:
    """Figures of free runs by channel."""
    read = np.concatenate([run.record.y for run in runs])
    error = np.concatenate([run.outputs for run in runs]) - read
    units = problem.plant.machine.channel_units
    table = {}
    for k, channel in enumerate(problem.channels):
        present = np.isfinite(read[:, k])
        if not np.any(present):
            continue
        table[channel] = Fit.of(error[present, k], read[present, k], units[channel], free_run=True)
    return table


def _calibrated(estimate: HydraulicEstimate) -> Machine:
    problem, machine = estimate.problem, estimate.problem.plant.machine
    source = f"identified from {', '.join(log.path or log.name for log in problem.logs)}"
    numbers, values, notes = machine.numbers, {}, {}
    theta = np.clip(estimate.shooting.theta, problem.parameters.lower, problem.parameters.upper)  # a solver's rounding
    for name, value, std in zip(problem.parameters.names, theta.tolist(), estimate.shooting.std.tolist(), strict=True):
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
                note = machine.notes.get(numbers[name].path)
                if note is None and (of_com := machine.notes.get(f"{owner}.body.{was}")) and of_com.relative:
                    note = of_com  # an absolute confidence of a centre of mass is none of a first moment
                if note is not None:
                    notes[name] = note.model_copy(update={"source": source})
    return machine.with_values(values, notes)
