"""Figures of an estimate over time, velocity and parameters, as small SVG without outside references."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from hydroopt.report.numbers import unit_text
from hydroopt.results.parameter_table import ParameterTable
from hydroopt.spatial.inertia import Array

if TYPE_CHECKING:
    from hydroopt.estimation.dynamic.estimate import Estimate
    from hydroopt.estimation.dynamic.experiment import Experiment
    from hydroopt.machine.balances import Balance

Mask = NDArray[np.bool_]

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
POINTS = 2000
FEW = 600
DOTS = 15000
CLIP = 5.0
"""Inches of a figure's width; points a line is thinned to, and one for comparison; dots of a cloud; changes beyond
are drawn at the edge."""


class Stretch(NamedTuple):
    """One log in a figure: its role, its predicted forces (N, n), those of other models by name, and the time [s] added
    to put it behind the one before."""

    role: str
    data: Experiment
    predicted: Array
    others: Mapping[str, Array]
    shift: float


def svg(figure: Figure, name: str) -> str:
    """The figure as an ``<svg>`` element whose ids begin with `name`, without metadata or outside references."""
    buffer = io.StringIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(buffer, format="svg", dpi=130, metadata={"Date": None})
    text = buffer.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    text = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{name}-", text)
    return text.replace("<svg ", f'<svg class="figure" role="img" aria-label="{name}" ', 1)


def thin(x: Array, y: Array, points: int = POINTS) -> tuple[Array, Array]:
    """At most about `points` of a line (N,), the lowest and the highest of every stretch, so that peaks survive.

    NaN in y breaks the line; breaks narrower than a stretch are lost.
    """
    if len(x) <= points:
        return x, y
    size = -(-len(x) // max(1, points // 2))
    missing = -len(x) % size
    rows = np.concatenate([y, np.full(missing, np.nan)]).reshape(-1, size)
    empty = np.isnan(rows)
    lowest = np.argmin(np.where(empty, np.inf, rows), axis=1)
    highest = np.argmax(np.where(empty, -np.inf, rows), axis=1)
    first = np.arange(len(rows)) * size
    keep = np.sort(np.column_stack([lowest, highest]), axis=1) + first[:, None]
    keep = np.minimum(keep.ravel(), len(x) - 1)
    return x[keep], y[keep]


def forces(estimate: Estimate) -> Figure:
    """Measured against predicted force of every balance that is measured, over time; validation on a shaded ground.

    Predictions of the nominal and the reduced model stand beside those of the identified one (Figure 37); where they
    are far off, they are cut.
    """
    logs = _timeline(estimate)
    *others, identified = estimate.variants
    with matplotlib.rc_context(STYLE):
        figure, axes = _rows(len(shown := _measured(estimate, logs)), 1.45)
        for (k, balance), (ax,) in zip(shown, axes, strict=True):
            factor, label = _force_axis(balance.unit, np.concatenate([log.data.force[:, k] for log in logs]))
            for log in logs:
                for rows in _segments(log):
                    t = log.data.motion.t[rows] + log.shift
                    inside, share = log.data.inside[rows], _share(rows, logs)
                    ax.plot(*thin(t, log.data.force[rows, k] * factor, share), color=GREY, lw=1.5)
                    for name in others:
                        other = np.where(inside, log.others[name][rows, k] * factor, np.nan)
                        ax.plot(*thin(t, other, share * FEW // POINTS), lw=0.9, **OTHERS[name])
                    ax.plot(*thin(t, np.where(inside, log.predicted[rows, k], np.nan) * factor, share), color=BLUE,
                            lw=0.9)
            _shade(ax, logs)
            low, high = _reaches([log.data.force[:, k] * factor for log in logs])
            if low < high:  # nothing acts at a passive joint
                ax.set_ylim(max(low, ax.get_ylim()[0]), min(high, ax.get_ylim()[1]))
            ax.set(title=balance.name, ylabel=label)
        _time_axis(axes, logs)
        handles = [Line2D([], [], color=GREY, lw=2, label="measured"),
                   *(Line2D([], [], label=name, **OTHERS[name]) for name in others),
                   Line2D([], [], color=BLUE, label=f"{identified}, identified")]
        _legend(figure, handles, logs)
    return figure


def residuals(estimate: Estimate) -> Figure:
    """Measured minus predicted force of every balance over time and against its joint's velocity."""
    machine = estimate.problem.model.machine
    logs = _timeline(estimate)
    with matplotlib.rc_context(STYLE):
        figure, axes = _rows(len(shown := _measured(estimate, logs)), 1.55, widths=(2.0, 1.0))
        for (k, balance), (over_time, over_speed) in zip(shown, axes, strict=True):
            joint = machine.joints.index(balance.joint)
            errors = [np.where(log.data.inside, log.data.force[:, k] - log.predicted[:, k], np.nan) for log in logs]
            factor, label = _force_axis(balance.unit, np.concatenate(errors), "residual")
            stride = max(1, sum(map(len, errors)) // DOTS)
            for log, error in zip(logs, errors, strict=True):
                colour, known = ORANGE if log.role == "validation" else BLUE, log.data.known[:, k]
                for rows in _segments(log):
                    t, share = log.data.motion.t[rows] + log.shift, _share(rows, logs)
                    over_time.plot(*thin(t, error[rows] * factor, share), color=colour, lw=0.7, alpha=0.35)
                    taken = np.where(known[rows], error[rows], np.nan)
                    over_time.plot(*thin(t, taken * factor, share), color=colour, lw=0.7)
                for which, alpha in ((~known, 0.18), (known, 0.6)):
                    at = np.flatnonzero(which & np.isfinite(error))[::stride]
                    over_speed.plot(log.data.motion.qd[at, joint], error[at] * factor, ls="none", marker=".", ms=2.4,
                                    mew=0, color=colour, alpha=alpha, rasterized=True)
            _shade(over_time, logs)
            for ax in (over_time, over_speed):
                band = 2 * estimate.sigma[k] * factor
                ax.axhspan(-band, band, color=GREEN, alpha=0.13, lw=0, zorder=0.6)
                ax.axhline(0, color=GREY, lw=0.6, zorder=0.7)
            reach = factor * _reach([np.where(log.data.known[:, k], error, np.nan)
                                     for log, error in zip(logs, errors, strict=True)], estimate.sigma[k])
            over_time.set(title=balance.name, ylabel=label, ylim=(-reach, reach))
            over_speed.set_ylim(-reach, reach)
            over_speed.locator_params(axis="y", nbins=5)
            over_speed.tick_params(labelleft=False)
            sliding = machine.link(balance.joint).joint.type == "prismatic"
            speed = "m/s" if sliding else "rad/s"
            over_speed.set_xlabel(f"velocity of joint {balance.joint} [{speed}]", labelpad=2)
        _time_axis(axes, logs)
        handles: list[Line2D | Patch] = [
            Line2D([], [], color=BLUE, lw=1.5, label="training"),
            Line2D([], [], color=BLUE, lw=1.5, alpha=0.35, label="joint too slow, left out of the estimate"),
            Patch(color=GREEN, alpha=0.2, label="±2 σ of the weights")]
        if any(log.role == "validation" for log in logs):
            handles.insert(1, Line2D([], [], color=ORANGE, lw=1.5, label="validation"))
        _legend(figure, handles, ())
    return figure


def changes(groups: Sequence[tuple[str, list[Change]]], columns: int = 4) -> Figure | None:
    """Chart of changes by owner; None if there is none."""
    if not groups:
        return None
    columns = max(1, min(columns, len(groups)))
    filled = _columns(groups, columns)
    length = max(sum(len(group) + 1.6 for _, group in column) for column in filled)
    reach = max(abs(x) for _, group in groups for c in group for x in (c.change, c.low, c.high))
    reach = min(CLIP, max(2.6, 1.08 * reach))
    height = 0.155 * length + 0.75
    margin = max(0.95, 0.075 * max(len(c.name) for _, group in groups for c in group))  # inches for the names
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height))
        for i, column in enumerate(filled):
            left, width = (margin + i * WIDTH / columns) / WIDTH, (WIDTH / columns - margin - 0.15) / WIDTH
            ax = figure.add_axes((left, 0.45 / height, width, 1 - 0.75 / height))
            _change_column(ax, column, reach, length, margin)
            ax.set_xlabel("change [standard deviations]")
        handles: list[Line2D | Patch] = [
            Line2D([], [], color=BLUE, marker="o", ms=4, label="identifiable alone"),
            Line2D([], [], color=BLUE, marker="o", ms=4, mfc="white", label="only together with others or the prior"),
            Patch(color=GREY, alpha=0.2, label="95 % of the prior")]
        if not all(c.prior for _, group in groups for c in group):
            handles.append(Line2D([], [], color=ORANGE, marker="o", ms=4, label="no prior: in units of its own σ"))
        figure.legend(handles=handles, loc="upper left", ncols=4, bbox_to_anchor=(0.01, 1.0), borderaxespad=0.2)
    return figure


class Change(NamedTuple):
    """One parameter of the chart: its element's name, change and interval in standard deviations."""

    name: str
    change: float
    low: float
    high: float
    alone: bool
    prior: bool


def changes_of(table: ParameterTable, *, priors_only: bool = False) -> list[tuple[str, list[Change]]]:
    """The parameters that have an interval, by owner: change against the nominal value and its 95 % interval.

    In units of the prior's standard deviation, or of the estimate's own where there is no prior; with `priors_only`
    those without a prior are left out.
    """
    groups: dict[str, list[Change]] = {}
    for name, one in table.items():
        size = one.prior_std or (None if priors_only else one.std)
        if one.value is None or one.nominal is None or one.ci95 is None or not size:
            continue
        change, low, high = ((x - one.nominal) / size for x in (one.value, *one.ci95))
        owner, _, element = name.rpartition(".")
        groups.setdefault(owner, []).append(
            Change(element, change, low, high, one.identifiability == "full", one.prior_std is not None))
    return list(groups.items())


def _columns(groups: Sequence[tuple[str, list[Change]]], columns: int) -> list[list[tuple[str, list[Change]]]]:
    """Groups in reading order, dealt to columns of about equal length."""
    total = sum(len(group) + 1.6 for _, group in groups)
    filled: list[list[tuple[str, list[Change]]]] = [[] for _ in range(columns)]
    done = 0.0
    for name, group in groups:
        size = len(group) + 1.6
        filled[min(columns - 1, int((done + size / 2) / total * columns))].append((name, group))
        done += size
    return [column for column in filled if column]


def _change_column(ax: Axes, column: Sequence[tuple[str, list[Change]]], reach: float, length: float,
                   margin: float) -> None:
    ax.axvspan(-1.96, 1.96, color=GREY, alpha=0.15, lw=0)
    ax.axvline(0, color=GREY, lw=0.8)
    ticks: list[float] = []
    labels: list[str] = []
    looks: dict[tuple[str, str, bool], list[tuple[float, Change]]] = {}
    y = 0.0
    for owner, group in column:
        ax.annotate(owner, (0, y + 0.6), xycoords=ax.get_yaxis_transform(), xytext=(6.4 - 72 * margin, 0),
                    textcoords="offset points", va="center", weight="bold", annotation_clip=False)
        y += 1.6
        for c in group:
            marker = "o" if abs(c.change) <= reach else "<" if c.change < 0 else ">"
            looks.setdefault((BLUE if c.prior else ORANGE, marker, c.alone), []).append((y, c))
            ticks.append(y)
            labels.append(c.name)
            y += 1
    # parameters that look alike are drawn at once: an artist for each would take most of a page's time
    for (colour, marker, alone), some in looks.items():
        at = [height for height, _ in some]
        ends = np.clip([(c.low, c.high) for _, c in some], -reach, reach)
        ax.hlines(at, ends[:, 0], ends[:, 1], color=colour, lw=1.2)
        ax.plot(np.clip([c.change for _, c in some], -reach, reach), at, ls="none", marker=marker, ms=3.6, color=colour,
                mew=0.9, mfc=colour if alone else "white", clip_on=False, zorder=3)
    ax.set_yticks(ticks, labels, fontsize=7)
    ax.set(xlim=(-reach, reach), ylim=(length, -0.2))
    ax.grid(axis="y", visible=False)
    ax.tick_params(axis="y", length=0, pad=6)
    ax.spines["left"].set_visible(False)


def _timeline(estimate: Estimate) -> list[Stretch]:
    """All logs one after the other."""
    logs: list[Stretch] = []
    sets = (("training", [e.plotted for e in estimate.problem.experiments], estimate.predictions["train"]),
            ("validation", [e.plotted for e in estimate.problem.validation], estimate.predictions["validation"]))
    spans = [data.motion.t[-1] - data.motion.t[0] for _, some, _ in sets for data in some]
    gap, end = 0.012 * sum(spans), 0.0
    *others, _ = estimate.variants.items()
    for role, some, predicted in sets:
        for data, forecast in zip(some, predicted, strict=True):
            beside = {name: estimate.predict(data, psi) for name, psi in others}
            logs.append(Stretch(role, data, forecast, beside, end - float(data.motion.t[0])))
            end += float(data.motion.t[-1] - data.motion.t[0]) + gap
    return logs


def _segments(log: Stretch) -> Iterator[slice]:
    """Uninterrupted stretches of a log."""
    cuts = np.flatnonzero(np.diff(log.data.motion.segment)) + 1
    edges = [0, *cuts.tolist(), len(log.data.motion.t)]
    return (slice(a, b) for a, b in pairwise(edges))


def _share(rows: slice, logs: Sequence[Stretch]) -> int:
    """How many of a line's points a stretch may have."""
    length: int = rows.stop - rows.start
    return max(20, POINTS * length // sum(len(log.data.motion.t) for log in logs))


def _force_axis(unit: str, values: Array, what: str = "") -> tuple[float, str]:
    """Factor and label of a force axis: thousands where numbers would be long."""
    finite = np.abs(values[np.isfinite(values)])
    kilo = bool(finite.size) and float(finite.max()) >= 2000
    word = what or ("force" if unit == "N" else "torque")
    return (1e-3 if kilo else 1.0), f"{word} [{'k' if kilo else ''}{unit_text(unit)}]"


def _measured(estimate: Estimate, logs: Sequence[Stretch]) -> list[tuple[int, Balance]]:
    """The balances, with their places, of which a log that is shown tells the force."""
    return [(k, balance) for k, balance in enumerate(estimate.problem.model.machine.balances)
            if any(np.any(np.isfinite(log.data.force[:, k])) for log in logs)]


def _reaches(values: Sequence[Array]) -> tuple[float, float]:
    """The lowest and highest force that an axis shows: half the range of what was measured beyond it."""
    all_values = np.concatenate(values)
    low, high = float(np.nanmin(all_values)), float(np.nanmax(all_values))
    return low - 0.5 * (high - low), high + 0.5 * (high - low)


def _reach(errors: Sequence[Array], sigma: float) -> float:
    """Half the height of a residual's axis: what counts fits in, what was left out may be cut off."""
    values = np.abs(np.concatenate(errors))
    largest = float(np.max(values, where=np.isfinite(values), initial=0.0))
    return max(1.1 * largest, 3.0 * float(sigma) if np.isfinite(sigma) else 0.0) or 1.0


def _rows(count: int, each: float, widths: Sequence[float] = (1.0,)) -> tuple[Figure, list[list[Axes]]]:
    """A column of axes of equal height [in] with room for titles and labels, laid out without a solver."""
    height = count * each + 0.85
    labelled = len(widths) > 1
    figure = Figure(figsize=(WIDTH, height))
    axes = np.asarray(figure.subplots(count, len(widths), squeeze=False, sharex="col" if not labelled else False,
                                      gridspec_kw={"width_ratios": widths}))
    inner = each - (0.5 if labelled else 0.32)
    figure.subplots_adjust(left=0.62 / WIDTH, right=1 - 0.12 / WIDTH, top=1 - 0.52 / height, bottom=0.42 / height,
                           hspace=(0.5 if labelled else 0.32) / inner, wspace=0.05)
    return figure, [list(row) for row in axes]


def _time_axis(axes: list[list[Axes]], logs: Sequence[Stretch]) -> None:
    end = float(logs[-1].data.motion.t[-1]) + logs[-1].shift
    for row in axes:
        row[0].set_xlim(-0.002 * end, 1.002 * end)
        row[0].tick_params(labelbottom=row is axes[-1])
        row[0].yaxis.set_label_coords(-0.45 / (row[0].get_position().width * WIDTH), 0.5)
        row[0].locator_params(axis="y", nbins=5)
    axes[-1][0].set_xlabel("time [s]" if len(logs) == 1 else "time, logs one after the other [s]", labelpad=1)


def _shade(ax: Axes, logs: Sequence[Stretch]) -> None:
    for log in logs:
        if log.role == "validation":
            t = log.data.motion.t
            ax.axvspan(float(t[0]) + log.shift, float(t[-1]) + log.shift, color=SHADE, lw=0, zorder=0.5)


def _legend(figure: Figure, handles: Sequence[Line2D | Patch], logs: Sequence[Stretch]) -> None:
    shown = list(handles)
    if any(log.role == "validation" for log in logs):
        shown.append(Patch(facecolor=SHADE, edgecolor="#e8d3b0", lw=0.6, label="validation, not used for the estimate"))
    figure.legend(handles=shown, loc="upper right", ncols=len(shown), bbox_to_anchor=(0.99, 1.0), borderaxespad=0.2)
