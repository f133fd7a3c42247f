"""One self-contained HTML page from an estimate: diagnostics, fit, figures, parameters, data and treatment."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hydroopt.report import force_charts
from hydroopt.report.machine_view import mass_tints
from hydroopt.report.numbers import NONE, Row, percent, plain, quantity, unit_text
from hydroopt.report.page import document
from hydroopt.report.panels import SI
from hydroopt.report.scene import SceneView, Tint
from hydroopt.report.tables import FitCells, Parameter, by_owner, fit_cells, fit_rows

if TYPE_CHECKING:
    from hydroopt.estimation.dynamic.estimate import Estimate
    from hydroopt.estimation.dynamic.experiment import AnyExperiment
    from hydroopt.estimation.dynamic.misfit.naming import Misfit

METHODS = {
    "sdp": "least squares with priors, bounds and physically possible bodies (semidefinite program)",
    "qp": "least squares with priors and bounds (quadratic program)",
    "nlp": "least squares with priors, bounds, physically possible bodies and free constraints (IPOPT)",
    "wls": "weighted least squares on base parameters", "ridge": "ridge regression",
    "tsvd": "truncated singular values",
}
"""Methods in words."""


class Group(NamedTuple):
    """The parameters of one owner; `eigenvalue` is the smallest of its pseudo-inertia, "" if it is not a body.

    `partial`: some of its parameters have no value, so that the numbers that predict forces need not be a body.
    """

    owner: str
    eigenvalue: str
    impossible: bool
    partial: bool
    parameters: list[Parameter]


def render(estimate: Estimate) -> str:
    """The report as one HTML page that needs nothing else."""
    problem, friction, groups = estimate.problem, estimate.friction_choice, _groups(estimate)
    samples = force_charts.samples(estimate)
    return document(
        "identification.html", samples=samples, charts=force_charts.charts(estimate, samples), scene=_scene(estimate),
        answer=estimate, machine=problem.model.machine, estimate=estimate,
        method=METHODS.get(estimate.method, ""), fit=fit_rows(estimate.fit, SI), models=list(estimate.variants),
        fit_by_model=_fit_by_model(estimate), friction=friction,
        friction_rows=[(c, plain(c.training), f"{plain(c.held_out)} ± {plain(c.std, 2)}")
                       for c in (friction.candidates if friction else ())],
        misfit=estimate.misfit, misfit_readings=_readings(estimate.misfit), misfit_causes=_causes(estimate.misfit),
        weights=_weights(estimate), groups=groups, base=_base(estimate), totals=_totals(estimate),
        condition=plain(estimate.identifiability.condition_number, 3),
        counts=Counter(each.identifiability for each in estimate.parameters.rows),
        confounded=[(c.name, plain(c.inflation, 3), ", ".join(c.partners)) for c in estimate.confounded],
        logs=[_log("training", e) for e in problem.experiments] + [_log("validation", e) for e in problem.validation],
        constraints=problem.constraint_names, priors=[f"{p.name}: {plain(p.value, 5)} ± {plain(p.sigma, 2)}"
                                                      for p in (*problem.stated_priors, *problem.priors)],
        fixed=[f"{name} = {plain(value, 5)}" for name, value in problem.fixed.items()])


def _scene(estimate: Estimate) -> SceneView:
    """The machine replaying its logs, coloured by residuals or by the uncertainty of masses."""
    machine = estimate.problem.model.machine
    residual = {balance.name if balance.alone else balance.joint: (
        f"{balance.name}.residual", float(sigma) * force_charts.factor(estimate, k))
        for k, (balance, sigma) in enumerate(zip(machine.balances, estimate.sigma, strict=True)) if sigma > 0}
    return SceneView(estimate.problem.model.scene_graph, tuple(f"{joint}.q" for joint in machine.joints), (
        Tint("residual", "residual / σ of the actuator", "σ", 2.0, columns=residual), *mass_tints(estimate.parameters)))


def _fit_by_model(estimate: Estimate) -> list[tuple[str, str, str, list[FitCells]]]:
    """Data, channel, unit, and the cells of each model."""
    words = {"train": "training"}
    return [(words.get(data, data), channel, unit_text(one.unit), [
        fit_cells(sets[data][channel], SI) for sets in estimate.fit_by_model.values()])
        for data, table in estimate.fit.items() for channel, one in table.items()]


def _readings(misfit: Misfit | None) -> list[tuple[str, bool, str, str, str, str]]:
    """Reading, whether its residuals are not explained, their probability without and with faults, noise, spikes."""
    return [] if misfit is None else [
        (name, name in misfit.alarmed, plain(p, 2), plain(misfit.after[name], 2), plain(misfit.noise[name], 3),
         percent(misfit.spikes[name])) for name, p in misfit.before.items()]


def _causes(misfit: Misfit | None) -> list[tuple[str, str, str, str, str, bool, str]]:
    """Faults found: words, size with limits and unit, whether both halves show it, and what is not distinguished."""
    rows = []
    for one in misfit.found if misfit else ():
        size, low, high = (plain(x * one.fault.factor, 3) for x in (one.size, *one.ci95))
        rows.append((one.fault.words, size, low, high, one.fault.unit, one.repeats,
                     "; ".join(other.fault.said(other.size)[0] for other in one.tied)))
    return rows


def _weights(estimate: Estimate) -> list[tuple[str, str, str, str]]:
    """Actuator or joint, σ of its residual with unit, and correlation time in samples."""
    return [(a.name, plain(s), unit_text(unit), plain(t, 3)) for a, s, unit, t in
            zip(estimate.problem.model.machine.balances, estimate.sigma, estimate.problem.model.force_units,
                estimate.correlation_time, strict=True) if a.name in estimate.fit["train"]]


def _groups(estimate: Estimate) -> list[Group]:
    least = estimate.consistency
    return [Group(owner, plain(least[owner], 3) if owner in least else "", least.get(owner, 0.0) < 0,
                  any(row.numbers.value == NONE for row in rows), rows)
            for owner, rows in by_owner(estimate.parameters, SI).items()]


def _base(estimate: Estimate) -> list[tuple[str, str, Row]]:
    # a sign stays on the line of its term
    return [(one["expression"].replace("+ ", "+\u00a0").replace("− ", "−\u00a0"), unit_text(one["unit"]),
             quantity(float(value), float(std)))
            for one, value, std in zip(estimate.base_parameters, estimate.base_value, estimate.base_std, strict=True)]


def _totals(estimate: Estimate) -> list[tuple[str, str, Row]]:
    """Links with several bodies: their names and their total mass."""
    parameters = estimate.problem.parameters
    return [(total.link, ", ".join(total.bodies), quantity(
        total.value, total.std, (total.low, total.high),
        float(np.sum(parameters.nominal[parameters.select(f"{owner}.m" for owner in total.bodies)]))))
        for total in estimate.total_masses if len(total.bodies) > 1]


def _log(role: str, data: AnyExperiment) -> dict[str, Any]:
    log = data.log
    return {"role": role, "name": log.name, "path": log.path, "samples": log.size, "taken": data.sample_count,
            "duration": plain(log.duration), "rows": f"{log.rows[0]} to {log.rows[1]}",
            "sha256": log.sha256, "findings": [f.text for f in log.findings], "notes": data.notes}
