"""The report of calibrated sensors: fitted motion, residuals and parameters; computes nothing."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from hydroopt.report.figures import BLUE, STYLE, WIDTH, changes, changes_of, svg, thin
from hydroopt.report.numbers import Row, plain, quantity, unit_text
from hydroopt.report.page import document
from hydroopt.spatial.inertia import Array

if TYPE_CHECKING:
    from hydroopt.estimation.motion.sensor_calibration import SensorCalibration

PRINTED = {"rad": ("deg", 180 / np.pi), "rad/s": ("deg/s", 180 / np.pi), "m": ("mm", 1e3)}
"""Units that a reader prefers, and what SI is multiplied by."""


def render(calibration: SensorCalibration) -> str:
    """The report as one HTML page that needs nothing else."""
    machine, table = calibration.problem.machine, calibration.parameters
    rows = [(name, unit_text(each.unit), _numbers(each.value, each.std, each.ci95, each.nominal), each.identifiability)
            for name, each in table.items()]
    drawn = {"motion": motions(calibration), "changes": changes(changes_of(table))}
    courses = calibration.motions
    accuracy = [(joint, *_in_print(float(np.sqrt(np.mean(np.concatenate(
        [course[f"{joint}.q_std"] for course in courses]) ** 2))), machine.position_unit(joint)))
        for joint in machine.joints] if courses else []
    return document(
        "sensors.html", machine=machine, calibration=calibration, diagnostics=calibration.diagnostics,
        accuracy=accuracy,
        motions=len(courses), postures=sum(len(set(zip(t.stage.tolist(), t.pose.tolist(), strict=True)))
                                           for t in calibration.problem.poses),
        readings=[(channel, *_in_print(fit.rms, fit.unit), plain(calibration.ratios[channel], 3))
                  for channel, fit in calibration.fit["train"].items()],
        groups=[(owner, list(some)) for owner, some in groupby(rows, lambda each: each[0].rpartition(".")[0])],
        counts={kind: sum(each.identifiability == kind for each in table.values())
                for kind in ("full", "combination", "none")},
        figures={name: Markup(svg(figure, name)) for name, figure in drawn.items() if figure is not None})


def _numbers(value: float | None, std: float | None, ci95: tuple[float, float] | None,
             nominal: float | None) -> Row:
    at, spread, before = (np.nan if each is None else each for each in (value, std, nominal))
    return quantity(at, spread, ci95 or (np.nan, np.nan), before)


def _in_print(value: float, unit: str) -> tuple[str, str]:
    name, factor = PRINTED.get(unit, (unit_text(unit), 1.0))
    return plain(factor * value, 3), name


def motions(calibration: SensorCalibration) -> Figure | None:
    """Fitted positions with their intervals, motion after motion; None without any."""
    machine, courses = calibration.problem.machine, calibration.motions
    if not courses:
        return None
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 0.4 + 1.3 * len(machine.joints)), layout="constrained")
        axes = figure.subplots(len(machine.joints), 1, sharex=True, squeeze=False)[:, 0]
        shift = 0.0
        for course in courses:
            t = course["t"] - course["t"][0] + shift
            shift = float(t[-1]) * 1.02
            for ax, joint in zip(axes, machine.joints, strict=True):
                name, factor = PRINTED[machine.position_unit(joint)]
                q, wide = factor * course[f"{joint}.q"], 1.96 * factor * course[f"{joint}.q_std"]
                at, low = thin(t, q - wide)
                ax.plot(*thin(t, q), color=BLUE)
                ax.fill_between(at, low, np.interp(at, t, q + wide), color=BLUE, alpha=0.25, lw=0)
                ax.set(title=joint, ylabel=name, ylim=_limits(ax.get_ylim(), q))
        axes[-1].set_xlabel("time, motions one after the other [s]")
    return figure


def _limits(before: tuple[float, float], q: Array) -> tuple[float, float]:
    """Limits of an axis that show the motion, however wide its band."""
    margin = 0.2 * float(np.ptp(q)) + 1e-6
    low, high = float(q.min()) - margin, float(q.max()) + margin
    return (low, high) if before == (0.0, 1.0) else (max(min(low, before[0]), low - margin),
                                                     min(max(high, before[1]), high + margin))
