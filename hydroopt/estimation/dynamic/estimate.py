"""The answer of an identification: parameters, status, diagnostics, and the files that are saved."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic import claims, diagnostics, reversals
from hydroopt.estimation.dynamic.calibrated import calibrated_machine
from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.identification import Identification
from hydroopt.estimation.dynamic.misfit import diagnostics as misfit_diagnostics
from hydroopt.estimation.dynamic.misfit.freed import Freed
from hydroopt.estimation.dynamic.misfit.naming import Misfit, examine_fit
from hydroopt.estimation.dynamic.misfit.readings import ForceReadings
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.stored_information import INFORMATION, information_csv
from hydroopt.estimation.dynamic.training_logs import contradictions
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine
from hydroopt.results.answer import Answer
from hydroopt.results.diagnostic import Diagnostic, Meaning
from hydroopt.results.json_file import Job, MachineId
from hydroopt.results.parameter_table import ParameterTable, row
from hydroopt.results.tables import csv_text, number
from hydroopt.results.verdict import NORMAL, Claim, NextStep
from hydroopt.spatial.inertia import Array


@dataclass(frozen=True, eq=False, repr=False)
class Estimate(Identification, Answer):
    """Identified masses, inertias, friction and offsets of a machine; `hydroopt.solve` returns it.

    Example:
        >>> import hydroopt as ho
        >>> model = ho.Model(ho.load_machine("patu655_lift"))
        >>> motions = [ho.random_trajectory(model, duration=20, rate=20, seed=k) for k in (1, 2)]
        >>> logs = [ho.simulate(model, motion, seed=k) for k, motion in enumerate(motions)]
        >>> estimate = ho.solve(ho.identification_problem(model, logs[:1], logs[1:]), seed=1)
        >>> estimate
        <identification of patu655_lift by sdp: ok, 52 parameters, 3 diagnostics>
        >>> estimate.parameters["lift_cylinder.f_coulomb"].unit
        'N'
        >>> [str(diagnostic.kind) for diagnostic in estimate.diagnostics][:1]
        ['active constraints']
    """

    freed: Freed | None = None
    """Faults that were estimated along, with their sizes."""

    job = Job.IDENTIFICATION

    @property
    def machine_id(self) -> MachineId:
        """Which machine it is about."""
        return MachineId.of(self.problem.model.machine)

    @property
    def method(self) -> str:
        """How it was identified, one of `hydroopt.estimation.dynamic.identify.METHODS`."""
        return self.algorithm

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Diagnostics of the estimate: what refutes the logs, why the model does not fit, then the rest by severity."""
        uncertain = {} if self.problem.beside else misfit_diagnostics.uncertain_geometry(self.problem.model.machine)
        sums = self.identifiability.grouping
        tested = () if self.misfit is None else misfit_diagnostics.diagnose(
            self.misfit, sums, NORMAL * self._widened(self.base_std, sums), uncertain)
        # a cause of a misfit may move what friction does at reversals
        late = () if self.misfit is None or self.misfit.found else reversals.diagnose(self)
        more = (*tested, *late, *diagnostics.diagnose(self))
        split = diagnostics.short_stretches(self) if any(each.contradicts for each in more) else ()
        shown = () if self.misfit is None else misfit_diagnostics.detectable(self.misfit)
        return (*self.of_logs, *split, *more, *shown)

    @cached_property
    def of_logs(self) -> tuple[Diagnostic, ...]:
        """What contradicts the machine file in the logs as they are read."""
        return contradictions(self.problem.model, (*self.problem.experiments, *self.problem.validation))

    @cached_property
    def misfit(self) -> Misfit | None:
        """The test of fit, and the faults that explain what is left; None where the data are too few, or motion is
        fitted or has instruments, or the logs are misread."""
        if self.problem.fitted_motion or self.problem.instruments or self.refuted:
            return None
        try:
            with threadpool_limits(limits=1, user_api="blas"):
                data = ForceReadings(self.problem, self.psi)
                return examine_fit(data) if data.blocks else None
        except np.linalg.LinAlgError:
            return None

    def __str__(self) -> str:
        return super().__str__() if self.ridge_strength is None else f"{super().__str__()}\n  {self.ridge_strength}"

    @property
    def findings(self) -> tuple[Diagnostic, ...]:
        """Sizes of freed faults."""
        return () if self.freed is None else tuple(misfit_diagnostics.freed_faults(self.freed))

    @property
    def refuted(self) -> bool:
        """Whether the logs contradict the machine file as they are read, so that no machine is saved."""
        return any(each.meaning is Meaning.REFUTATION for each in self.of_logs)

    @cached_property
    def machine(self) -> Machine:
        """The calibrated machine: the nominal description with the estimate's numbers and their confidences.

        Raises:
            ProblemError: no machine can have these numbers; see `calibrated_machine`.
        """
        return calibrated_machine(self)

    @cached_property
    def parameters(self) -> ParameterTable:
        """All dynamic parameters; `prior_std` where the method used the machine file's prior."""
        stated, prior = self.problem.parameters, self.prior_std
        std = self._widened(self.std, np.eye(len(self.std)))
        more = NORMAL * (std - self.std)
        return ParameterTable([
            row(name, stated.kinds[k], stated.units[k], nominal=stated.nominal[k], prior_std=prior[k],
                value=self.value[k], std=std[k], ci95=self.ci95[k] + (-more[k], more[k]), bound=self.bound[k],
                identifiability=self.category(k))
            for k, name in enumerate(stated.names)])

    def _widened(self, std: Array, sums: Array) -> Array:
        """Standard deviations (m,) of sums (m, p) of the parameters with what the model is found to lack."""
        return std if self.misfit is None else np.hypot(std, self.misfit.widening(sums))

    @cached_property
    def claims(self) -> tuple[Claim, ...]:
        """Which forces it predicts, which masses it determines, how well it weighs a load, and whether it can control.
        """
        return claims.claims(self, self.parameters)

    @cached_property
    def next_steps(self) -> tuple[NextStep, ...]:
        """What would make it better, or how to use it."""
        return claims.next_steps(self, self.claims, self.command_line)

    @property
    def inputs(self) -> tuple[Mapping[str, Any], ...]:
        """The logs that were used."""
        return inputs_of(self.problem)

    @cached_property
    def base_parameters(self) -> tuple[Mapping[str, Any], ...]:
        """The combinations that the training data determine: expression, unit, value and std."""
        found, units = self.identifiability, self.problem.parameters.units
        stds = self._widened(self.base_std, found.grouping)
        return tuple({"expression": found.expression(i), "unit": units[found.basis[i]],
                      "value": number(self.base_value[i]), "std": number(stds[i])} for i in range(found.rank))

    def details(self) -> Mapping[str, Any]:
        """Base parameters, masses of links, conditioning, physical consistency, weights and how it was computed."""
        found, structural, model = self.identifiability, self.structural, self.problem.model
        chosen = {} if self.friction_choice is None else {"friction_choice": self.friction_choice.as_dict()}
        strength = self.ridge_strength
        ridge = {} if strength is None else {"ridge": {"lambda_over_largest": number(strength.of_largest),
                                                       "lambda_over_smallest": number(strength.of_smallest)}}
        return {
            "fit_by_model": {name: {data: {channel: fit.as_dict() for channel, fit in table.items()}
                                    for data, table in sets.items()} for name, sets in self.fit_by_model.items()},
            "base_parameters": list(self.base_parameters),
            "total_masses": [{"link": total.link, "bodies": list(total.bodies), "unit": "kg",
                              "value": number(total.value), "std": number(total.std),
                              "ci95": [total.low, total.high] if np.isfinite(total.low) else None}
                             for total in self.total_masses],
            "conditioning": {"rank": found.rank, "condition_number": number(found.condition_number),
                             "parameters": len(self.problem.parameters), "structural_rank": structural.rank,
                             "structurally_identifiable": structural.count("full"),
                             "structurally_in_combination": structural.count("combination"),
                             "structurally_not_identifiable": structural.count("none"), **ridge},
            "physical_consistency": {owner: {"consistent": smallest >= 0, "min_eigenvalue": smallest}
                                     for owner, smallest in self.consistency.items()},
            "weights": {balance.name: {"sigma": float(sigma), "unit": unit, "correlation_time": float(time),
                                        "samples": int(samples)}
                        for balance, sigma, unit, time, samples in zip(
                            model.machine.balances, self.sigma, model.force_units, self.correlation_time,
                            self.weighted_residuals.samples, strict=True)},
            "split_half": [{"log": data.log.path or data.log.name, **half.as_dict()} for data, half in zip(
                self.problem.experiments, self.weighted_residuals.split_half, strict=True)],
            "prior_test": self._prior_test(),
            "between_logs": number(self.weighted_residuals.between_logs.std),
            **self._stated(), "active_constraints": list(self.active),
            "intervals": str(self.intervals), "notes": list(self.notes),
            "seed": self.seed, "test_of_fit": None if self.misfit is None else self.misfit.as_dict(),
            "freed": [] if self.freed is None else self.freed.as_dicts(), **chosen}

    def _stated(self) -> dict[str, Any]:
        """What was stated beyond confidences, by machine file and user: held parameters, constraints and priors."""
        problem = self.problem
        return {"fixed": dict(problem.fixed),
                "constraints": [{"name": name, "active": name in self.active} for name in problem.constraint_names],
                "priors": [{"name": one.name, "value": one.value, "std": one.sigma, "parameters": {
                    problem.parameters.names[k]: float(one.row[k]) for k in np.flatnonzero(one.row)}}
                    for one in (*problem.stated_priors, *problem.priors)]}

    def _prior_test(self) -> dict[str, Any] | None:
        """Whether data and priors agree; None where the method used no priors."""
        if not self.uses_priors:
            return None
        return {"p_value": self.prior_test.p_value, "directions": self.prior_test.directions,
                "groups": [one._asdict() for one in self.prior_test.groups]}

    def files(self) -> Mapping[str, str]:
        """Tables as CSV, the information that the logs carry, and the calibrated machine where it can exist."""
        model = self.problem.model
        files = {"parameters.csv": self.parameters.to_csv(), "base_parameters.csv": csv_text(self.base_parameters),
                 "fit.csv": csv_text([{"model": name, "data": data, "channel": channel, **fit.as_dict()}
                                      for name, sets in self.fit_by_model.items() for data, table in sets.items()
                                      for channel, fit in table.items()]),
                 INFORMATION: information_csv(model.machine, self.problem.parameters.names,
                                              *self.weighted_residuals.stored())}
        if self.refuted:  # a machine identified from a misread log is none
            return files
        with contextlib.suppress(ProblemError):  # a diagnostic states the reason
            files[f"{self.machine_name}.toml"] = dump_machine(self.marked(self.machine))
        return files


def inputs_of(problem: IdentificationProblem) -> tuple[Mapping[str, Any], ...]:
    """The logs of a problem as answers list them."""
    return (*(_input(each, "train") for each in problem.experiments),
            *(_input(each, "validation") for each in problem.validation))


def _input(data: Experiment, role: str) -> dict[str, Any]:
    log = data.log
    return {"path": log.path or log.name, "sha256": log.sha256 or None, "samples": log.size, "role": role,
            "first_sample": log.rows[0], "last_sample": log.rows[1],
            "findings": [finding.text for finding in log.findings], "notes": list(data.notes)}
