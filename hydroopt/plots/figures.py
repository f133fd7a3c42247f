"""Figures of an estimate over time, velocity and parameters."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from hydroopt.report.numbers import unit_text
from hydroopt.results.parameter_table import ParameterTable
from hydroopt.spatial.inertia import Array

if TYPE_CHECKING:
    from hydroopt.estimation.dynamic.estimate import Estimate
    from hydroopt.estimation.dynamic.experiment import Experiment
    from hydroopt.machine.balances import Balance

INK, GREY, LIGHT, BLUE, ORANGE, GREEN = "#1f2933", "#8a96a3", "#e4e9ee", "#0072b2", "#d55e00", "#009e73"
SHADE = "#fdf3e4"
"""Okabe and Ito's palette, which colour-blind readers can tell apart; `SHADE` lies behind validation data."""

STYLE: dict[Any, Any] = {key: value for key, value in matplotlib.rcParamsDefault.items() if "backend" not in key} | {
    "font.family": "sans-serif", "font.sans-serif": ["DejaVu Sans", "Arial", "Helvetica"], "font.size": 8,
    "axes.titlesize": 9, "axes.titleweight": "bold", "axes.titlelocation": "left", "axes.titlepad": 4,
    "axes.labelsize": 8, "axes.labelcolor": INK, "axes.edgecolor": GREY, "axes.linewidth": 0.7,
    "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "axes.axisbelow": True,
    "axes.titlecolor": INK, "text.color": INK, "grid.color": LIGHT, "grid.linewidth": 0.6, "xtick.color": GREY,
    "ytick.color": GREY, "xtick.labelcolor": INK, "ytick.labelcolor": INK, "xtick.labelsize": 8, "ytick.labelsize": 8,
    "xtick.major.size": 3, "ytick.major.size": 3, "legend.frameon": False, "legend.fontsize": 8, "lines.linewidth": 0.9,
    "svg.fonttype": "none", "svg.hashsalt": "hydroopt", "text.parse_math": False, "path.simplify": True,
    "axes.formatter.useoffset": False,
}
"""One look for all figures, whatever the user's settings; text stays text, so that pages are small and searchable."""

OTHERS: dict[str, dict[str, Any]] = {"nominal": {"color": ORANGE, "ls": (0, (3, 1.5))}, "reduced": {"color": GREEN}}
"""Looks of models that stand beside the identified one."""
WIDTH = 11.0
"""Inches of a figure's width."""
CLIP = 5.0
"""Standard deviations beyond which changes are drawn at the edge."""


class Stretch(NamedTuple):
    """One log in a figure: its role, its predicted forces (N, n), those of other models by name, and times (N,) [s]
    behind those of the log before, not a number where a segment begins."""

    role: str
    data: Experiment
    predicted: Array
    others: Mapping[str, Array]
    t: Array


def svg(figure: Figure) -> str:
    """The figure as an ``<svg>`` element."""
    text = io.StringIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(text, format="svg", dpi=200, metadata={"Date": None})
    return text.getvalue()[text.getvalue().index("<svg"):]


def forces(estimate: Estimate) -> Figure:
    """Measured against predicted force of every balance that is measured, over time; validation on a shaded ground.

    Predictions of the nominal and the reduced model stand beside those of the identified one (Figure 37); where they
    are far off, they are cut.
    """
    logs, (*others, identified) = _timeline(estimate), estimate.variants
    shown = _measured(estimate, logs)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 1.45 * len(shown) + 0.85), layout="constrained")
        for (k, balance), (ax,) in zip(shown, figure.subplots(len(shown), 1, squeeze=False, sharex=True), strict=True):
            measured = np.concatenate([log.data.force[:, k] for log in logs])
            factor, label = _force_axis(balance.unit, measured)
            for log in logs:
                ax.plot(log.t, factor * log.data.force[:, k], color=GREY, lw=1.5, rasterized=True)
                looks = [(log.others[name], OTHERS[name]) for name in others] + [(log.predicted, {"color": BLUE})]
                for predicted, look in looks:
                    inside = np.where(log.data.inside, predicted[:, k], np.nan)
                    ax.plot(log.t, factor * inside, rasterized=True, **look)
            low, high = factor * np.nanmin(measured), factor * np.nanmax(measured)
            if (room := (high - low) / 2) > 0:  # nothing acts at a passive joint
                ax.set_ylim(max(low - room, ax.get_ylim()[0]), min(high + room, ax.get_ylim()[1]))
            ax.set(title=balance.name, ylabel=label)
            _shade(ax, logs)
        ax.set_xlabel("time, logs one after the other [s]")
        _legend(figure, [Line2D([], [], color=GREY, lw=2, label="measured"),
                         *(Line2D([], [], label=name, **OTHERS[name]) for name in others),
                         Line2D([], [], color=BLUE, label=f"{identified}, identified")], logs)
    return figure


def residuals(estimate: Estimate) -> Figure:
    """Measured minus predicted force of every balance over time and against its joint's velocity."""
    machine, logs = estimate.problem.model.machine, _timeline(estimate)
    shown = _measured(estimate, logs)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 1.55 * len(shown) + 0.85), layout="constrained")
        axes = figure.subplots(len(shown), 2, squeeze=False, sharey="row", width_ratios=(2.0, 1.0))
        for (k, balance), (over_time, over_speed) in zip(shown, axes, strict=True):
            joint, largest = machine.joints.index(balance.joint), 3.0 * float(np.nan_to_num(estimate.sigma[k]))
            errors = [np.where(log.data.inside, log.data.force[:, k] - log.predicted[:, k], np.nan) for log in logs]
            factor, label = _force_axis(balance.unit, np.concatenate(errors), "residual")
            for log, error in zip(logs, errors, strict=True):
                colour, known = ORANGE if log.role == "validation" else BLUE, log.data.known[:, k]
                taken, speed = np.where(known, error, np.nan), log.data.motion.qd[:, joint]
                largest = max(largest, 1.1 * float(np.nanmax(np.abs(taken), initial=0.0)))
                for values, alpha in ((error, 0.3), (taken, 0.8)):
                    over_time.plot(log.t, factor * values, color=colour, lw=0.7, alpha=alpha, rasterized=True)
                    over_speed.plot(speed, factor * values, ls="none", marker=".", ms=2.4, mew=0, color=colour,
                                    alpha=alpha, rasterized=True)
            for ax in (over_time, over_speed):
                band = 2 * estimate.sigma[k] * factor
                ax.axhspan(-band, band, color=GREEN, alpha=0.13, lw=0, zorder=0.6)
                ax.axhline(0, color=GREY, lw=0.6, zorder=0.7)
            # what was left out may be cut off
            over_time.set(title=balance.name, ylabel=label, ylim=factor * (largest or 1.0) * np.array([-1.0, 1.0]))
            speed_unit = machine.channel_units[f"{balance.joint}.qd"]
            over_speed.set_xlabel(f"velocity of joint {balance.joint} [{speed_unit}]")
            _shade(over_time, logs)
        axes[-1, 0].set_xlabel("time, logs one after the other [s]")
        _legend(figure, [Line2D([], [], color=BLUE, lw=1.5, label="training"), Line2D(
            [], [], color=BLUE, lw=1.5, alpha=0.3, label="joint too slow, left out of the estimate"),
                         Patch(color=GREEN, alpha=0.2, label="±2 σ of the weights")], logs)
    return figure


def changes(table: ParameterTable) -> Figure | None:
    """Changes of the parameters that have an interval against their nominal values, with these intervals.

    In units of the prior's standard deviation, or of the estimate's own where there is no prior. None if there is none.
    """
    looks: dict[tuple[bool, bool], list[tuple[float, float, float, float]]] = {}
    names: list[str] = []
    for name, one in table.items():
        size = one.prior_std or one.std
        if one.value is not None and one.nominal is not None and one.ci95 is not None and size:
            found = np.clip((np.array([one.value, *one.ci95]) - one.nominal) / size, -CLIP, CLIP)
            key = one.prior_std is not None, one.identifiability == "full"
            looks.setdefault(key, []).append((len(names), *found.tolist()))
            names.append(name)
    if not names:
        return None
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 0.16 * len(names) + 1.0), layout="constrained")
        ax = figure.subplots()
        ax.axvspan(-1.96, 1.96, color=GREY, alpha=0.15, lw=0, label="95 % of the prior")
        for (prior, alone), some in sorted(looks.items(), reverse=True):
            y, change, low, high = np.array(some).T
            colour = BLUE if prior else ORANGE
            ax.errorbar(change, y, xerr=(change - low, high - change), fmt="o", ms=3.6, lw=1.2, color=colour,
                        mfc=colour if alone else "white", clip_on=False, label=(
                            "identifiable alone" if alone else "only together with others or the prior")
                        + ("" if prior else "; no prior, in units of its own σ"))
        ax.set_yticks(range(len(names)), names, fontsize=7)
        ax.set(xlim=(-CLIP, CLIP), ylim=(len(names), -1), xlabel="change [standard deviations]")
        figure.legend(loc="outside upper right", ncols=3)
    return figure


def _timeline(estimate: Estimate) -> list[Stretch]:
    """All logs one after the other."""
    logs, end = list[Stretch](), 0.0
    *others, _ = estimate.variants.items()
    for role, some, key in (("training", estimate.problem.experiments, "train"),
                            ("validation", estimate.problem.validation, "validation")):
        for data, predicted in zip((each.plotted for each in some), estimate.predictions[key], strict=True):
            t = data.motion.t - data.motion.t[0] + end
            end = 1.01 * float(t[-1])
            t[1:][np.diff(data.motion.segment) != 0] = np.nan
            beside = {name: estimate.predict(data, psi) for name, psi in others}
            logs.append(Stretch(role, data, predicted, beside, t))
    return logs


def _force_axis(unit: str, values: Array, what: str = "") -> tuple[float, str]:
    """Factor and label of a force axis: thousands where numbers would be long."""
    kilo = float(np.nanmax(np.abs(values), initial=0.0)) >= 2000
    word = what or ("force" if unit == "N" else "torque")
    return (1e-3 if kilo else 1.0), f"{word} [{'k' if kilo else ''}{unit_text(unit)}]"


def _measured(estimate: Estimate, logs: Sequence[Stretch]) -> list[tuple[int, Balance]]:
    """The balances, with their places, of which a log that is shown tells the force."""
    return [(k, balance) for k, balance in enumerate(estimate.problem.model.machine.balances)
            if any(np.any(np.isfinite(log.data.force[:, k])) for log in logs)]


def _shade(ax: Axes, logs: Sequence[Stretch]) -> None:
    for log in logs:
        if log.role == "validation":
            ax.axvspan(float(np.nanmin(log.t)), float(np.nanmax(log.t)), color=SHADE, lw=0, zorder=0.5)


def _legend(figure: Figure, handles: Sequence[Line2D | Patch], logs: Sequence[Stretch]) -> None:
    shown = list(handles)
    if any(log.role == "validation" for log in logs):
        shown.append(Patch(facecolor=SHADE, edgecolor="#e8d3b0", lw=0.6, label="validation, not used for the estimate"))
    figure.legend(handles=shown, loc="outside upper right", ncols=len(shown))
