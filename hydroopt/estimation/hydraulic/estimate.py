"""The answer of an identification of valves and oil: parameters, diagnostics, free runs, the calibrated machine."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hydroopt.estimation.hydraulic.adjustment import Adjustment, adjust
from hydroopt.estimation.hydraulic.bounded_gaussian import SHARE, BoundedGaussian, WeakDirection
from hydroopt.estimation.hydraulic.free_run import Run, free_runs
from hydroopt.estimation.hydraulic.problem import SUPPLY, HydraulicProblem
from hydroopt.machine.calibrated_numbers import with_calibrated
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine
from hydroopt.model.workspace import Sweep, workspace_sweeps
from hydroopt.results.answer import Answer
from hydroopt.results.diagnostic import Diagnostic, Meaning
from hydroopt.results.fit import Fit
from hydroopt.results.json_file import Job, MachineId
from hydroopt.results.parameter_table import ParameterTable, row
from hydroopt.results.tables import csv_text, number
from hydroopt.results.verdict import Action, Claim, NextStep, Purpose, judged
from hydroopt.spatial.inertia import Array

MISFIT = 1.5
"""Ratio of residuals and what sensors' errors leave, from which on the model does not explain an actuator."""
LATE, BARELY = 4.0, 1e-3
"""How many of its standard deviations a delay must be off to be named, and how far [s] at least: the model's flows
within an interval are no more exact."""
NOTHING = 1e-6
"""Part of the prior's information below which the data carry none."""


def unexplained_actuators(actuators: Sequence[str], misfit: Array) -> Iterator[Diagnostic]:
    """Actuators whose residuals, in units (a,) of what sensors' errors leave, the model does not explain."""
    for actuator, factor in zip(actuators, misfit, strict=True):
        if factor > MISFIT:
            yield Diagnostic.of("flow not explained by the model", (actuator,), {"factor": float(factor)}, (
                "The flow of {subject} differs from the model by {factor:.1f} times what its sensors' errors leave; "
                "the intervals are widened."),
                "Check the sensors' accuracy and the signs of commands, and whether edges and directions differ "
                "(flow_pa, dead_band_reverse).", Meaning.CONTRADICTION)


def late_commands(actuators: Sequence[str], later: Array) -> Iterator[Diagnostic]:
    """Actuators whose commands arrive at another time than the machine file states, by `Adjustment.later` (a, 2)."""
    for actuator, (by, std) in zip(actuators, later, strict=True):
        if abs(by) > max(LATE * std, BARELY):
            yield Diagnostic.of("commands arrive at another time than stated", (actuator,), {
                "by": float(abs(by)), "std": float(std), "sense": "later" if by > 0 else "earlier"},
                "The commands of {subject} arrive about {by:.2g} s {sense} than the machine file's delay says (± "
                "{std:.1g} s); spool and intervals are wrong by that.",
                "State a 'sigma' of its valve's 'delay', which is then identified, or correct the clocks of the log.",
                Meaning.CONTRADICTION)


def exact_delays(actuators: Sequence[str], later: Array) -> Iterator[Diagnostic]:
    """Actuators whose delay is not identified, by `Adjustment.later` (a, 2)."""
    some = [k for k in range(len(actuators)) if np.isfinite(later[k, 1]) and LATE * later[k, 1] > BARELY]
    if some:
        yield Diagnostic.of("delay taken as exact", tuple(actuators[k] for k in some), {
            "least": float(LATE * np.max(later[some, 1]))},
            "The delays of {subject} count as exact, since the machine file states no 'sigma' of them; these logs "
            "would show an error from {least:.2g} s on, and smaller ones end in the spools' numbers.",
            "State a 'sigma' of each valve's 'delay', which is then identified.")


def parameter_diagnostics(estimate: BoundedGaussian) -> tuple[Diagnostic, ...]:
    """Parameters that the data do not determine, and those at a bound."""
    return (*(_weak(estimate, each) for each in estimate.weak_directions),
            *(_at_bound(estimate, int(k)) for k in np.flatnonzero(estimate.at_bound)))


def _weak(estimate: BoundedGaussian, weak: WeakDirection) -> Diagnostic:
    """A direction on which the data carry little information."""
    parameters, theta, members = estimate.parameters, estimate.theta, weak.members
    names = tuple(parameters.names[k] for k in members)
    informed = all(parameters.information[k, k] > 0 for k in members)
    evidence = {"information": weak.information, "determined_by": "the prior" if informed else "nothing"}
    if len(names) == 1:
        if weak.information < NOTHING:
            return Diagnostic.of("no information in the data", names, evidence, (
                "The logs carry no information on {subject}; {determined_by} determines it."),
                "Record a motion that excites it, or remove its sigma.", Meaning.PROPERTY)
        k = members[0]
        reach = 1.96 * abs(weak.direction[k]) / np.sqrt(weak.information)
        return Diagnostic.of("little information in the data", names, {
            **evidence, "low": float(max(theta[k] - reach, parameters.lower[k])),
            "high": float(min(theta[k] + reach, parameters.upper[k])), "unit": parameters.units[k]},
            "The logs alone admit {subject} from {low:.3g} to {high:.3g} {unit}; {determined_by} determines it within.",
            meaning=Meaning.PROPERTY)
    if len(names) == 2 and np.all(theta[members] != 0):
        relative = weak.direction[members] / theta[members]
        if abs(abs(relative[0] / relative[1]) - 1) < SHARE:
            form = "ratio" if relative[0] * relative[1] > 0 else "product"
            return Diagnostic.of("only a ratio or product identifiable", names, evidence | {"form": form}, (
                "The logs determine only the {form} of {subject}; {determined_by} determines each."),
                meaning=Meaning.PROPERTY)
    return Diagnostic.of("only a combination identifiable", names, evidence, (
        "The logs determine {subject} only in combination; {determined_by} determines each."),
        meaning=Meaning.PROPERTY)


def _at_bound(estimate: BoundedGaussian, k: int) -> Diagnostic:
    """A parameter that a bound holds, with the other end of its interval."""
    parameters, (low, high) = estimate.parameters, estimate.ci95[k]
    lower = bool(estimate.gradient[k] > 0)
    return Diagnostic.of("parameter at a bound", (parameters.names[k],), {
        "side": "lower" if lower else "upper", "bound": float((parameters.lower if lower else parameters.upper)[k]),
        "unit": parameters.units[k], "beyond": "below" if lower else "above", "limit": float(high if lower else low)},
        "{subject} is at its {side} bound, {bound:.3g} {unit}; 95 % of its probability lies {beyond} {limit:.3g} "
        "{unit}.")


METHOD = "adjustment of volume balances"


@dataclass(frozen=True, eq=False, repr=False)
class HydraulicEstimate(Answer):
    """Valves and oil identified from logs.

    Attributes:
        problem: what was solved.
        adjustment: the solution, with what the model leaves of the balances.

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
    adjustment: Adjustment

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
        """What the logs lack, actuators that the model does not explain, and parameters that the data do not determine.
        """
        lost = (Diagnostic.of("pressure not measured in a log", channels, {"log": where}, (
            "{log} lacks {subject}: only the other chamber of the actuator shows its valve and oil."))
                for where, channels in self.problem.lost_pressures.items())
        later = self.adjustment.later * [1.0, max(1.0, self.adjustment.residual_scale)]
        return (*lost, *unexplained_actuators(self.actuators, self.adjustment.misfit),
                *late_commands(self.actuators, later), *exact_delays(self.actuators, later),
                *self.problem.assumed_supplies,
                *parameter_diagnostics(self.adjustment))

    @property
    def actuators(self) -> tuple[str, ...]:
        """Names (a,) of the actuators."""
        return tuple(each.actuator.name for each in self.problem.plant.actuators)

    @cached_property
    def parameters(self) -> ParameterTable:
        """The parameters by name, with priors, values, intervals and identifiability."""
        found, stated = self.adjustment, self.problem.parameters
        with np.errstate(divide="ignore"):
            prior_std = 1 / np.sqrt(np.diag(stated.information))
        return ParameterTable([
            row(name, stated.kinds[k], stated.units[k], nominal=float(stated.nominal[k]),
                prior_std=float(prior_std[k]), value=float(found.theta[k]), std=float(found.std[k]),
                ci95=found.ci95[k].tolist(), bound=stated.nearest_bound(k, found.theta[k]) if found.at_bound[k] else "",
                identifiability=found.category(name))
            for k, name in enumerate(stated.names)])

    @cached_property
    def claims(self) -> tuple[Claim, ...]:
        """Which channels a run from the commands alone follows."""
        held_out = self.fit.get("validation")
        condition = "RMS of a free run from commands alone over a held-out log" if held_out else ""
        untested = "" if held_out else "no log was held out"
        return tuple(judged(Purpose.VALVE, channel, fit.rms, fit.unit, fit.of_range or 0.0, condition=condition,
                            untested=untested) for channel, fit in (held_out or self.fit["train"]).items())

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """What would test or improve it, or how to use it."""
        typed = self.command_line
        if "validation" not in self.fit:
            return (NextStep(Action.CHECK, "Hold data out to test the free run: --validate LOG, or --holdout 0.3.",
                             typed.again("--holdout", "0.3")),)
        calibrated = typed.path(f"{self.machine_name}.toml")
        return (NextStep(Action.USE, "Design a motion with the calibrated machine file, and tune controllers on it:", (
            f"hydroopt excite {calibrated} -o motion && "
            f"hydroopt control {calibrated} --motion motion/trajectory.csv -o control")),)

    @property
    def inputs(self) -> tuple[Mapping[str, Any], ...]:
        """The logs it is from."""
        return self.problem.inputs

    def details(self) -> Mapping[str, Any]:
        """Conditioning, and for each actuator the misfit and the random flow that the model leaves."""
        found, parameters = self.adjustment, self.problem.parameters
        sizes = np.linalg.eigvalsh(found.data * np.outer(parameters.scale, parameters.scale))
        return {"base_parameters": [],
                "conditioning": {
                    "rank": int(np.sum(sizes > 1e-12 * sizes[-1])), "parameters": len(parameters),
                    "condition_number": number(np.sqrt(sizes[-1] / sizes[0]) if sizes[0] > 0 else np.inf),
                    "residual_scale": number(found.residual_scale)},
                "physical_consistency": {},
                "balances": {name: {"misfit": number(misfit), "random_flow": float(density), "unit": "m^3/sqrt(s)"}
                             for name, misfit, density in zip(self.actuators, self.adjustment.misfit,
                                                              self.adjustment.density, strict=True)}}

    def files(self) -> Mapping[str, str]:
        """The calibrated machine, tables of parameters and fit, and the free runs, in SI.

        Raises:
            SolverError: a free run diverged.
        """
        return {f"{self.machine_name}.toml": dump_machine(self.marked(self.machine)),
                "parameters.csv": self.parameters.to_csv(),
                "fit.csv": csv_text([{"data": data, "channel": channel, **fit.as_dict()}
                                     for data, table in self.fit.items() for channel, fit in table.items()]),
                "free_run.csv": csv_text(list(self._samples()))}

    def _samples(self) -> Iterator[dict[str, Any]]:
        """Every sample of all logs: commands, readings, and the free run."""
        inputs = (*self.problem.plant.inputs, *SUPPLY)
        for data, runs in self.runs.items():
            for k, run in enumerate(runs):
                for i, t in enumerate(run.t):
                    sample: dict[str, Any] = {"data": data, "stretch": k + 1, "t [s]": float(t)}
                    sample |= {name: float(u) for name, u in zip(inputs, run.u[i], strict=True)}
                    for channel, read, value in zip(self.problem.channels, run.y[i], run.outputs[i], strict=True):
                        sample |= {channel: number(read), f"{channel} free": float(value)}
                    yield sample

    @cached_property
    def runs(self) -> Mapping[str, tuple[Run, ...]]:
        """Free runs over what was fitted, ``train``, and what was held out, ``validation``.

        Raises:
            SolverError: the states diverge.
        """
        problem = self.problem
        return {data: tuple(run for log in logs for run in free_runs(problem, log, self.adjustment.theta))
                for data, logs in (("train", problem.logs), ("validation", problem.validation))}

    @cached_property
    def fit(self) -> Mapping[str, Mapping[str, Fit]]:
        """Free runs by data set and channel."""
        return {name: free_run_fit(self.problem, runs) for name, runs in self.runs.items() if runs}

    @property
    def machine(self) -> Machine:
        """The machine with the identified values and their confidences; a prior for other logs."""
        found, logs = self.adjustment, ", ".join(log.path or log.name for log in self.problem.logs)
        values = zip(found.theta.tolist(), found.std.tolist(), strict=True)
        return with_calibrated(self.problem.plant.machine, dict(zip(found.parameters.names, values, strict=True)),
                               f"identified from {logs}")

    @cached_property
    def sweeps(self) -> tuple[Sweep, ...]:
        """Frequency, damping and gain of every joint over the workspace; empty without a stated supply pressure."""
        plant = self.problem.plant
        return workspace_sweeps(plant, plant.model.parameters.nominal, self.problem.whole(self.adjustment.theta))


def identify_hydraulics(problem: HydraulicProblem) -> HydraulicEstimate:
    """Identify valves and oil by adjusting volume balances.

    Raises:
        SolverError: the steps do not converge.
        LogError, ProblemError: see `HydraulicProblem.stretches`.

    Example:
        See `HydraulicEstimate`.
    """
    return HydraulicEstimate(problem, adjust(problem.balanced, problem.parameters, len(problem.plant.actuators)))


def free_run_fit(problem: HydraulicProblem, runs: Sequence[Run]) -> dict[str, Fit]:
    """Figures of free runs by channel."""
    read = np.concatenate([run.y for run in runs])
    error = np.concatenate([run.outputs for run in runs]) - read
    units = problem.plant.machine.channel_units
    table = {}
    for k, channel in enumerate(problem.channels):
        present = np.isfinite(read[:, k])
        if not np.any(present):
            continue
        table[channel] = Fit.of(error[present, k], read[present, k], units[channel], free_run=True)
    return table
