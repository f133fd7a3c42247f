"""One self-contained HTML page from an estimate: diagnostics, fit, figures, parameters, data and treatment."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from markupsafe import Markup

from hydroopt.report import force_charts
from hydroopt.report.intervals import interval
from hydroopt.report.machine_view import mass_tints
from hydroopt.report.numbers import NONE, Row, percent, plain, quantity, unit_text
from hydroopt.report.page import document
from hydroopt.report.scene import SceneView, Tint
from hydroopt.results.fit import Fit

if TYPE_CHECKING:
    from hydroopt.estimation.dynamic.estimate import Estimate
    from hydroopt.estimation.dynamic.experiment import Experiment
    from hydroopt.estimation.dynamic.misfit.naming import Misfit

METHODS = {
    "sdp": "least squares with priors, bounds and physically possible bodies (semidefinite program)",
    "qp": "least squares with priors and bounds (quadratic program)",
    "nlp": "least squares with priors, bounds, physically possible bodies and free constraints (IPOPT)",
    "wls": "weighted least squares on base parameters", "ridge": "ridge regression",
    "tsvd": "truncated singular values",
}
"""Methods in words."""


class Parameter(NamedTuple):
    """One line of the parameter table."""

    name: str
    element: str
    unit: str
    numbers: Row
    prior: str
    from_data: str
    bound: str
    identifiability: str
    alone: bool
    beside: bool
    figure: Markup


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
        machine=problem.model.machine, estimate=estimate, diagnostics=estimate.diagnostics,
        verdict=estimate.verdict,
        method=METHODS.get(estimate.method, ""), fit=_fit(estimate), models=list(estimate.variants),
        fit_by_model=_fit_by_model(estimate), friction=friction,
        friction_rows=[(c, plain(c.training), f"{plain(c.held_out)} ± {plain(c.std, 2)}")
                       for c in (friction.candidates if friction else ())],
        misfit=estimate.misfit, misfit_readings=_readings(estimate.misfit), misfit_causes=_causes(estimate.misfit),
        weights=_weights(estimate), groups=groups, base=_base(estimate), totals=_totals(estimate),
        condition=plain(estimate.identifiability.condition_number, 3),
        counts={c: sum(p.identifiability == c for g in groups for p in g.parameters)
                for c in ("full", "combination", "not excited", "none", "fixed")},
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


def _fit(estimate: Estimate) -> list[dict[str, Any]]:
    """Rows of the fit table: channel, unit, and the cells of training and validation."""
    sets = [estimate.fit.get(name, {}) for name in ("train", "validation")]
    channels = list(dict.fromkeys(channel for table in sets for channel in table
                                  if channel != "all" or len(table) > 2))
    return [{"channel": channel, "unit": unit_text(next(t[channel].unit for t in sets if channel in t)),
             "cells": [_cells(table.get(channel)) for table in sets]} for channel in channels]


def _fit_by_model(estimate: Estimate) -> list[tuple[str, str, str, list[tuple[str, str, str, bool]]]]:
    """Data, channel, unit, and the cells of each model."""
    words = {"train": "training"}
    return [(words.get(data, data), channel, unit_text(one.unit), [
        _cells(sets[data][channel]) for sets in estimate.fit_by_model.values()])
        for data, table in estimate.fit.items() for channel, one in table.items()]


def _cells(fit: Fit | None) -> tuple[str, str, str, bool]:
    """RMS, VAF, relative error, and whether the mean of the signal would have predicted better."""
    if fit is None:
        return NONE, NONE, NONE, False
    return plain(fit.rms), percent(fit.vaf), percent(fit.relative), fit.vaf < 0


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
    groups: dict[str, list[Parameter]] = {}
    for name, one in estimate.parameters.items():
        owner, _, element = name.rpartition(".")
        low, high = one.ci95 or (math.nan, math.nan)
        value, std, nominal = (math.nan if x is None else x for x in (one.value, one.std, one.nominal))
        groups.setdefault(owner, []).append(Parameter(
            name, element, unit_text(one.unit), quantity(value, std, (low, high), nominal),
            NONE if one.prior_std is None else plain(one.prior_std, 2),
            NONE if one.information_from_data is None else plain(100 * one.information_from_data, 2), one.bound or "",
            one.identifiability, one.ci95 is None and one.value is not None, value < low or value > high,
            interval(one)))
    least = estimate.consistency
    return [Group(owner, plain(least[owner], 3) if owner in least else "", least.get(owner, 0.0) < 0,
                  any(row.numbers.value == NONE for row in rows), rows)
            for owner, rows in groups.items()]


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


def _log(role: str, data: Experiment) -> dict[str, Any]:
    log = data.log
    return {"role": role, "name": log.name, "path": log.path, "samples": log.size, "taken": data.sample_count,
            "duration": plain(log.duration), "rows": f"{log.rows[0]} to {log.rows[1]}",
            "sha256": log.sha256, "findings": [f.text for f in log.findings], "notes": data.notes}
