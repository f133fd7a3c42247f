"""Whether logs can be used, what is suspicious in them, and what an identification from them would determine."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from hydroopt.estimation.dynamic import claims
from hydroopt.estimation.dynamic.diagnostics import NOT_EXCITED, not_identified, short_stretches, uncertain_positions
from hydroopt.estimation.dynamic.estimate import Estimate, inputs_of
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import IdentificationProblem, identification_problem
from hydroopt.estimation.dynamic.training_logs import FORCE_NOT_MEASURED, forces_not_measured
from hydroopt.estimation.inference.identifiability import COMBINATION, FULL, Identifiability
from hydroopt.estimation.inference.least_squares import deviations
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Smoothing
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import GivenMachine
from hydroopt.model.model import Model
from hydroopt.parameters.parameter_set import ParameterKind
from hydroopt.results.answer import Answer
from hydroopt.results.diagnostic import Diagnostic, in_samples, of_kind
from hydroopt.results.json_file import Job
from hydroopt.results.machine_diagnostics import machine_diagnostics
from hydroopt.results.parameter_table import ParameterTable, row
from hydroopt.results.readable import percentage
from hydroopt.results.tables import number
from hydroopt.results.verdict import Action, Claim, NextStep, Purpose, Usable
from hydroopt.spatial.inertia import Array

METHOD = "weighted least squares"
NOT_JUDGED = ("Not judged here: offsets of a few degrees, delayed readings, wrong areas and geometry. 'hydroopt "
              "identify' tests its residuals for them, and states the sizes that it would have found.")
"""What a check leaves open."""
OF_EXCITE = ("--map", "--set", "--bandwidth")
"""Options of reading a log that `hydroopt excite` takes, too."""
LITTLE_RANGE = 0.2
"""Part of a joint's range below which its motion tells little: gravity's change of direction stays within noise."""


class JointCoverage(NamedTuple):
    """What a joint does in the logs: part of its range, RMS speed and acceleration [rad/s, rad/s² or m/s, m/s²]."""

    joint: str
    of_range: float
    speed: float
    acceleration: float


@dataclass(frozen=True, eq=False, repr=False)
class LogCheck(Answer):
    """What logs are good for, before any identification; `check_logs` returns it.

    Attributes:
        problem: the identification that the logs would enter.
        rough: least squares on base parameters, from which the weights of the residuals are.
        options: of the command line and their values that the logs were read with, for the commands of next steps.

    Example:
        >>> import hydroopt as ho
        >>> model = ho.Model(ho.load_machine("patu655_lift"))
        >>> log = ho.simulate(model, ho.random_trajectory(model, duration=20, rate=20, seed=1), seed=1)
        >>> found = ho.check_logs(model.machine, [log])
        >>> found.status, found.identifiability.rank
        (<Status.OK: 'ok'>, 5)
        >>> found.parameters["lift_cylinder.f_coulomb"].std < 200
        True
    """

    problem: IdentificationProblem
    rough: Estimate
    options: tuple[tuple[str, str], ...] = ()

    job = Job.CHECK

    @property
    def machine(self) -> Machine:
        """The machine that it is about."""
        return self.problem.model.machine

    @property
    def method(self) -> str:
        """How it was computed."""
        return METHOD

    @property
    def identifiability(self) -> Identifiability:
        """What the motion of the logs determines."""
        return self.rough.identifiability

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What contradicts the machine file, what looks wrong in the logs, and what the motion does not excite."""
        experiments = self.problem.experiments
        return (*machine_diagnostics(self.problem.model), *self.rough.of_logs, *uncertain_positions(self.rough),
                *forces_not_measured(self.problem.model, experiments), *(in_samples(
                    data.log.path or data.log.name, each.text) for data in experiments for each in data.log.findings),
                *not_identified(self.rough))

    @cached_property
    def std(self) -> Array:
        """Standard deviations (p,) to expect, by the logs and the machine file's confidences; infinite without both."""
        rows = np.vstack([self.rough.weighted_residuals.R, self.problem.square_rows[0]])
        return deviations(rows, self.problem.parameters.scale)

    @cached_property
    def parameters(self) -> ParameterTable:
        """All parameters: `std` is the one to expect of an identification; no values, as none is identified yet."""
        stated = self.problem.parameters
        return ParameterTable([
            row(name, stated.kinds[k], stated.units[k], nominal=float(stated.nominal[k]),
                prior_std=float(stated.prior_std[k]), std=float(self.std[k]), identifiability=self.rough.category(k))
            for k, name in enumerate(stated.names)])

    @cached_property
    def claims(self) -> tuple[Claim, ...]:
        """Whether the logs can be used, and which masses they would determine."""
        counts = self.identifiability
        detail = (f"{counts.rank} of {self.rough.structural.rank} base parameters, "
                  f"{counts.count(FULL)} parameters alone and {counts.count(COMBINATION)} in combinations")
        logs = tuple(Claim(Purpose.LOG, data.log.path or data.log.name, Usable.YES, condition=detail)
                     for data in self.problem.experiments)
        masses = [claims.expected_mass(each) for each in self.parameters.rows if each.kind == ParameterKind.MASS]
        return (*logs, *sorted(masses, key=lambda claim: np.inf if claim.part is None else claim.part))

    @cached_property
    def next_steps(self) -> tuple[NextStep, ...]:
        """What to drive beside these logs, or to identify from them; nothing where they are contradicted."""
        if self.contradictions:
            return ()
        steps: list[NextStep] = []
        paths = [shlex.quote(data.log.path or data.log.name) for data in self.problem.experiments]
        logs, logged = " ".join(paths), "".join(f" --log {path}" for path in paths)
        machine = self.problem.model.machine.source
        read = "".join(f" {option} {shlex.quote(value)}" for option, value in self.options)
        mapped = "".join(f" {option} {shlex.quote(value)}" for option, value in self.options if option in OF_EXCITE)
        for each in of_kind(self.diagnostics, FORCE_NOT_MEASURED):
            steps.append(NextStep(Action.MEASURE, (
                f"Map or record {each.evidence['channels']}: without, no equation of "
                f"{', '.join(each.subject)} counts.")))
        steps += [NextStep(Action.CHECK, str(each)) for each in short_stretches(self.rough)]
        weak = [each for each in self.coverage if each.of_range < LITTLE_RANGE]
        if weak:
            steps.append(NextStep(Action.DRIVE, (
                f"Move {weak[0].joint} further: it covers {percentage(weak[0].of_range)} of its range.")))
        if of_kind(self.diagnostics, NOT_EXCITED):
            steps.append(NextStep(Action.DRIVE, "Design a motion, drive it, and add its log:",
                                  f"hydroopt excite {machine}{logged}{mapped} -o motion"))
        steps.append(NextStep(Action.USE, "Identify:",
                              f"hydroopt identify {machine} {logs}{read} --holdout 0.3 -o out"))
        return tuple(steps)

    @cached_property
    def coverage(self) -> tuple[JointCoverage, ...]:
        """What each joint does in the logs."""
        machine = self.problem.model.machine
        motions = [data.plotted.motion for data in self.problem.experiments]
        q, qd, qdd = (np.concatenate([getattr(motion, key) for motion in motions]) for key in ("q", "qd", "qdd"))
        ranges = np.ptp(machine.ranges, axis=1)
        return tuple(JointCoverage(joint, float(np.ptp(q[:, k]) / ranges[k]), float(np.sqrt(np.mean(qd[:, k] ** 2))),
                                   float(np.sqrt(np.mean(qdd[:, k] ** 2))))
                     for k, joint in enumerate(machine.joints))

    @property
    def inputs(self) -> tuple[Mapping[str, Any], ...]:
        """The logs."""
        return inputs_of(self.problem)

    def details(self) -> Mapping[str, Any]:
        """Rank, coverage of each joint, and the residuals' standard deviations."""
        found, balances = self.identifiability, self.problem.model.machine.balances
        return {"conditioning": {"rank": found.rank, "structural_rank": self.rough.structural.rank,
                                 "condition_number": number(found.condition_number)},
                "coverage": [each._asdict() for each in self.coverage],
                "weights": {balance.name: {"sigma": number(sigma), "unit": balance.unit}
                            for balance, sigma in zip(balances, self.rough.sigma, strict=True)}}

    def files(self) -> Mapping[str, str]:
        """The table of parameters with the standard deviations to expect."""
        return {"parameters.csv": self.parameters.to_csv()}

    def __str__(self) -> str:
        lines = [f"  {'joint':<20} {'of its range':>12} {'RMS speed':>14} {'RMS acceleration':>18}"]
        units = self.problem.model.machine.channel_units
        for each in self.coverage:
            unit = units[f"{each.joint}.q"]
            lines.append(f"  {each.joint:<20} {percentage(each.of_range):>12} {each.speed:>8.3g} {unit}/s "
                         f"{each.acceleration:>10.3g} {unit}/s²")
        for data in self.problem.experiments:
            log = data.log
            lines.append(f"  {log.path or log.name}: {data.sample_count} of {log.size} samples would take part")
        return "\n".join([*lines, *([] if self.contradictions else [f"  {NOT_JUDGED}"])])


def check_logs(machine: GivenMachine | Model, logs: Log | Sequence[Log], *,
               smoothing: Smoothing | None = None) -> LogCheck:
    """Check logs against a machine: can they be used, what is suspicious, and what would they identify.

    Standard deviations to expect are those of weighted least squares with the machine file's confidences, without
    bounds and conditions on bodies, and with the scatter of the residuals in these logs.

    Args:
        machine: nominal description, or its model.
        logs: to be identified from.
        smoothing: how angles are differentiated; a smoothing spline by default.

    Raises:
        LogError: a channel is missing or a log is too short.
        ProblemError: there is no log, or one is given twice.
        IdentifiabilityError: no joint moves.

    See `LogCheck` for an example.
    """
    problem = identification_problem(machine, logs, smoothing=smoothing)
    return LogCheck(problem, identify(problem.by_data_alone(), "wls"))
