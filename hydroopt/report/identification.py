"""One self-contained HTML page from an estimate: diagnostics, fit, figures, parameters, data and treatment."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hydroopt.report.charts import Chart, Cloud, HeatMap, Line, TimeChart
from hydroopt.report.machine_view import mass_tints
from hydroopt.report.numbers import NONE, Row, percent, plain, quantity, unit_text
from hydroopt.report.page import document
from hydroopt.report.panels import SI
from hydroopt.report.samples import Recording, Samples, joined
from hydroopt.report.scene import SceneView, Tint
from hydroopt.report.tables import FitCells, Parameter, by_owner, fit_cells, fit_rows
from hydroopt.results.verdict import Purpose
from hydroopt.spatial.inertia import Array

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
LOOKS = {"nominal": "other", "reduced": "third"}
"""Looks of models that stand beside the identified one."""
LONG = 2000.0
"""Forces from which on thousands are printed."""


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
    samples = _samples(estimate)
    return document(
        "identification.html", samples=samples, charts=_charts(estimate, samples), scene=_scene(estimate),
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
        f"{balance.name}.residual", float(sigma) * _factor(estimate, k))
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
    """Reading, whether its residuals are not explained, their size over noise, frequency [Hz], noise, spikes."""
    return [] if misfit is None else [
        (name, name in misfit.unexplained, plain(ratio, 3), plain(hertz, 2), plain(misfit.noise[name], 3),
         percent(misfit.spikes[name])) for name, (ratio, hertz) in misfit.excess.items()]


def _causes(misfit: Misfit | None) -> list[tuple[str, str, str, str, str, str, str]]:
    """Hypotheses found: words, size with limits and unit, evidence, and what is not distinguished."""
    rows = []
    for one in misfit.found if misfit else ():
        fault = one.hypothesis
        size, low, high = (plain(x * fault.factor, 3) for x in (one.size, *one.ci95))
        rows.append((fault.words, size, low, high, fault.unit, plain(one.evidence, 3),
                     "; ".join(other.hypothesis.sentence(other.amount) for other in one.rivals)))
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
             quantity(one["value"], np.nan if one["std"] is None else one["std"]))
            for one in estimate.base_parameters]


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


def _factor(estimate: Estimate, k: int) -> float:
    """What the forces of the balance `k` are multiplied by in print."""
    largest = max(float(np.nanmax(np.abs(data.plotted.force[:, k]), initial=0.0))
                  for data in (*estimate.problem.experiments, *estimate.problem.validation))
    return 1e-3 if largest >= LONG else 1.0


def _unit(estimate: Estimate, k: int) -> str:
    """Unit of the forces of the balance `k` in print."""
    printed = unit_text(estimate.problem.model.machine.balances[k].unit)
    return f"k{printed}" if _factor(estimate, k) < 1 else printed


def _samples(estimate: Estimate) -> Samples:
    """Joint positions and speeds, measured and predicted forces and residuals of all logs."""
    problem = estimate.problem
    sets = (("training", problem.experiments, estimate.predictions["train"]),
            ("validation", problem.validation, estimate.predictions["validation"]))
    found = [Recording(role, data.log.name, data.plotted.motion.t, data.plotted.motion.segment,
                       _columns(estimate, data.plotted, predicted))
             for role, some, forecasts in sets for data, predicted in zip(some, forecasts, strict=True)]
    return joined(found, [f"{balance.name}.weighed" for balance in problem.model.machine.balances])


def _columns(estimate: Estimate, data: Experiment, predicted: Array) -> dict[str, Array]:
    machine, motion = estimate.problem.model.machine, data.motion
    columns: dict[str, Array] = {}
    for k, joint in enumerate(machine.joints):
        turn = 180 / np.pi if machine.position_unit(joint) == "rad" else 1.0
        columns |= {f"{joint}.q": motion.q[:, k], f"{joint}.angle": turn * motion.q[:, k],
                    f"{joint}.speed": turn * motion.qd[:, k]}
    *others, identified = estimate.variants.items()
    bounds = {each.of: each.bound for each in estimate.verdict.said if each.purpose is Purpose.FORCE}
    forecasts = {name: estimate.predict(data, psi) for name, psi in others} | {identified[0]: predicted}
    for k, balance in enumerate(machine.balances):
        size = _factor(estimate, k)
        columns[f"{balance.name}.measured"] = size * data.force[:, k]
        for name, forces in forecasts.items():
            columns[f"{balance.name}.{name}"] = np.where(data.inside, size * forces[:, k], np.nan)
        residual = size * np.where(data.inside, data.force[:, k] - predicted[:, k], np.nan)
        columns[f"{balance.name}.residual"] = residual
        if (bound := bounds.get(balance.name)) is not None:
            columns |= {f"{balance.name}.{side}": np.where(data.inside, size * (predicted[:, k] + sign * bound), np.nan)
                        for side, sign in (("low", -1), ("high", 1))}
        columns[f"{balance.name}.known"] = np.where(data.known[:, k], residual, np.nan)
        columns[f"{balance.name}.weighed"] = residual / (size * estimate.sigma[k])
    return columns


def _charts(estimate: Estimate, made: Samples) -> dict[str, list[Chart]]:
    """Forces over time; residuals over time, against angle and speed, and over the workspace."""
    machine = estimate.problem.model.machine
    shown: dict[str, list[Chart]] = {"forces": [], "residuals": []}
    for k, balance in enumerate(machine.balances):
        printed, name, joint = _unit(estimate, k), balance.name, balance.joint
        if not np.any(np.isfinite(made.columns[f"{name}.measured"])):
            continue  # no log tells this force
        band = 2 * float(estimate.sigma[k]) * _factor(estimate, k)
        within = (-band, band) if np.isfinite(band) else None
        word = "force" if balance.unit == "N" else "torque"
        *others, identified = estimate.variants
        lines = (Line(f"{name}.measured", "measured", "measured"),
                 *(Line(f"{name}.{other}", other, LOOKS[other], dashed=True) for other in others),
                 Line(f"{name}.{identified}", f"{identified}, identified"))
        shown["forces"].append(TimeChart(
            f"{name}: {word} [{printed}]", lines, _description(estimate, name),
            span=_span(made.columns[f"{name}.measured"]),
            shaded=(("predicted", f"{name}.low", f"{name}.high"),) if f"{name}.low" in made.columns else ()))
        turn = "deg" if machine.position_unit(joint) == "rad" else "m"
        left = made.columns[f"{name}.known"]
        reach = max(1.1 * float(np.nanmax(np.abs(left), initial=0.0)), 1.5 * (within or (0.0, 0.0))[1]) or 1.0
        known = left[np.isfinite(left)]
        rms = f"RMS {plain(float(np.sqrt(np.mean(known**2))) if known.size else np.nan, 3)} {printed}"
        shown["residuals"] += [
            TimeChart(f"{name}: residual [{printed}]", (
                Line(f"{name}.residual", "joint too slow, left out", "measured"), Line(f"{name}.known", "residual")),
                f"Residual of {name} over time, {rms}, twice its σ {plain(band, 3)} {printed}.", band=within,
                span=(-reach, reach)),
            Cloud(f"{name}: residual against position", f"{joint}.angle", f"{name}.known", f"{joint} [{turn}]",
                  f"Residual of {name} against the position of {joint}, {rms}.", within),
            Cloud(f"{name}: residual against speed", f"{joint}.speed", f"{name}.known", f"{joint} [{turn}/s]",
                  f"Residual of {name} against the speed of {joint}, {rms}.", within),
            HeatMap(f"{name}: mean residual over the workspace", f"{name}.known", printed)]
    return shown


def _description(estimate: Estimate, name: str) -> str:
    """The fit of an actuator in words."""
    words = {"train": "training", "validation": "validation"}
    errors = [f"{words[data]}: RMS error {plain(table[name].rms, 3)} {unit_text(table[name].unit)}, "
            f"{percent(table[name].vaf)} % of the variance explained"
            for data, table in estimate.fit.items() if name in table]
    return f"Measured and predicted force of {name} over time. {'; '.join(errors)}."


def _span(measured: Array) -> tuple[float, float] | None:
    """Lowest and highest force of an axis: half the range of what was measured beyond it."""
    if not np.any(np.isfinite(measured)):
        return None
    low, high = float(np.nanmin(measured)), float(np.nanmax(measured))
    return (low - 0.25 * (high - low), high + 0.25 * (high - low)) if high > low else None
