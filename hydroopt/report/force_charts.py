"""Measured and predicted forces of an identification: columns of samples and their figures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hydroopt.report.charts import Chart, Cloud, HeatMap, Line, TimeChart
from hydroopt.report.numbers import percent, plain, unit_text
from hydroopt.report.samples import Recording, Samples, joined
from hydroopt.spatial.inertia import Array

if TYPE_CHECKING:
    from hydroopt.estimation.dynamic.estimate import Estimate
    from hydroopt.estimation.dynamic.experiment import Experiment

LOOKS = {"nominal": "other", "reduced": "third"}
"""Looks of models that stand beside the identified one."""
LONG = 2000.0
"""Forces from which on thousands are printed."""


def factor(estimate: Estimate, k: int) -> float:
    """What the forces of the balance `k` are multiplied by in print."""
    largest = max(float(np.nanmax(np.abs(data.plotted.force[:, k]), initial=0.0))
                  for data in (*estimate.problem.experiments, *estimate.problem.validation))
    return 1e-3 if largest >= LONG else 1.0


def unit(estimate: Estimate, k: int) -> str:
    """Unit of the forces of the balance `k` in print."""
    printed = unit_text(estimate.problem.model.machine.balances[k].unit)
    return f"k{printed}" if factor(estimate, k) < 1 else printed


def samples(estimate: Estimate) -> Samples:
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
    forecasts = {name: estimate.predict(data, psi) for name, psi in others} | {identified[0]: predicted}
    for k, balance in enumerate(machine.balances):
        size = factor(estimate, k)
        columns[f"{balance.name}.measured"] = size * data.force[:, k]
        for name, forces in forecasts.items():
            columns[f"{balance.name}.{name}"] = np.where(data.inside, size * forces[:, k], np.nan)
        residual = size * np.where(data.inside, data.force[:, k] - predicted[:, k], np.nan)
        columns[f"{balance.name}.residual"] = residual
        columns[f"{balance.name}.known"] = np.where(data.known[:, k], residual, np.nan)
        columns[f"{balance.name}.weighed"] = residual / (size * estimate.sigma[k])
    return columns


def charts(estimate: Estimate, made: Samples) -> dict[str, list[Chart]]:
    """Forces over time; residuals over time, against angle and speed, and over the workspace."""
    machine = estimate.problem.model.machine
    shown: dict[str, list[Chart]] = {"forces": [], "residuals": []}
    for k, balance in enumerate(machine.balances):
        printed, name, joint = unit(estimate, k), balance.name, balance.joint
        if not np.any(np.isfinite(made.columns[f"{name}.measured"])):
            continue  # no log tells this force
        band = 2 * float(estimate.sigma[k]) * factor(estimate, k)
        within = (-band, band) if np.isfinite(band) else None
        word = "force" if balance.unit == "N" else "torque"
        *others, identified = estimate.variants
        lines = (Line(f"{name}.measured", "measured", "measured"),
                 *(Line(f"{name}.{other}", other, LOOKS[other], dashed=True) for other in others),
                 Line(f"{name}.{identified}", f"{identified}, identified"))
        shown["forces"].append(TimeChart(f"{name}: {word} [{printed}]", lines, _description(estimate, name),
                                         span=_span(made.columns[f"{name}.measured"])))
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
