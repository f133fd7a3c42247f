"""The report of a kinematic calibration: its figures and one self-contained HTML page; draws, computes nothing."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from hydroopt.report import chain_sides
from hydroopt.report.figures import BLUE, GREEN, GREY, INK, LIGHT, ORANGE, SHADE, STYLE, WIDTH, changes, changes_of, svg
from hydroopt.report.numbers import NONE, Row, plain, quantity, unit_text
from hydroopt.report.page import document
from hydroopt.results.status import Status

if TYPE_CHECKING:
    from hydroopt.estimation.kinematic.calibration import Calibration
    from hydroopt.estimation.kinematic.chain_points import ChainPoints
    from hydroopt.estimation.kinematic.residuals import PoseResiduals
    from hydroopt.results.fit import Fit
    from hydroopt.spatial.inertia import Array

METHODS = {
    "joint": "all poses, stages and parameters at once; sensed angles err, too (maximum likelihood, IPOPT)",
    "hierarchical": "link by link from the tip inwards (Levenberg-Marquardt with truncated singular values)",
}
"""Methods in words."""

PRINTED: dict[str, tuple[str, float]] = {"m": ("mm", 1e3), "rad": ("deg", 180 / np.pi)}
"""Units that a reader prefers, and what SI is multiplied by."""

MOST = 40
"""Parameters that the map of correlations can name legibly."""
PANELS = 3
SHOWN = 3
"""Stages, and poses of each, in the picture of the chain."""
BINS = 40
FLAT = 1e-6
"""Width of a view, relative to its length, from which on it is drawn."""


class Parameter(NamedTuple):
    """One line of the parameter table."""

    name: str
    unit: str
    numbers: Row
    identifiability: str
    partner: str
    alone: bool
    strong: bool


def render(c: Calibration) -> str:
    """The report as one HTML page that needs nothing else."""
    problem, identified = c.problem, c.observability
    groups = _groups(c)
    every = [p for _, rows in groups for p in rows]
    return document(
        "calibration.html", machine=problem.model.machine, calibration=c, diagnostics=c.diagnostics,
        suspect=c.status is not Status.OK,
        method=METHODS.get(c.method, ""), fit=_fit(c), groups=groups, figures=_drawings(c),
        counts={kind: sum(p.identifiability == kind for p in every)
                for kind in ("full", "combination", "none", "fixed")},
        tables=_tables(c), stages=len(set(problem.poses.stage)),
        suspects=[s.diagnostic.text for s in c.suspects], left_out=[s.diagnostic.text for s in c.left_out],
        condition=plain(identified.condition_number, 3), amplification=plain(identified.noise_amplification_index, 3),
        scale=plain(c.noise_scale, 3), accuracy=_accuracy(c),
        fixed=[f"{name} = {_printed(value, problem.parameters.units[problem.parameters.index(name)])}"
               for name, value in problem.fixed.items()])


def _drawings(c: Calibration) -> dict[str, Markup]:
    drawn = {"residuals": residuals(c), "chain": chains(c), "sides": chain_sides.distances(c.sides),
             "changes": changes(changes_of(c.parameters, priors_only=True)), "correlations": correlations(c),
             "workspace": workspace(c)}
    return {name: Markup(svg(figure, name)) for name, figure in drawn.items() if figure is not None}


# --- tables ---


def _fit(c: Calibration) -> list[dict[str, Any]]:
    """Rows of the fit table: channel and the cells of nominal, train and validation."""
    channels = list(dict.fromkeys(channel for table in c.fit.values() for channel in table))
    units = {channel: fit.unit for table in c.fit.values() for channel, fit in table.items()}
    return [{"channel": _in_thousandths(channel, units[channel]),
             "cells": [_cells(c.fit.get(name, {}).get(channel)) for name in ("nominal", "train", "validation")]}
            for channel in channels]


def _in_thousandths(channel: str, unit: str, length: str = "") -> str:
    """A channel with the unit of its printed residuals, if need be `length` for that of lengths."""
    return channel + length if unit == "m" else f"{channel} [{unit_text('m' + unit)}]"


def _cells(fit: Fit | None) -> tuple[str, str, str]:
    """RMS [mm], VAF and relative error [%]."""
    if fit is None:
        return NONE, NONE, NONE
    return (plain(1e3 * fit.rms, 3), f"{100 * fit.vaf:.4f}" if np.isfinite(fit.vaf) else NONE,
            plain(100 * fit.relative, 3))


def _groups(c: Calibration) -> list[tuple[str, list[Parameter]]]:
    """Parameters by the part they belong to; those the poses add come last."""
    return [(owner, [_parameter(c, k) for k in rows]) for owner, rows in _owners(c).items()]


def _owners(c: Calibration) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {}
    for k, name in enumerate(c.problem.parameters.names):
        found.setdefault(name.rpartition(".")[0], []).append(k)
    return found


def _parameter(c: Calibration, k: int) -> Parameter:
    parameters = c.problem.parameters
    name = parameters.names[k]
    unit, factor = PRINTED.get(parameters.units[k], (unit_text(parameters.units[k]), 1.0))
    partner, strong = "", False
    if name in c.correlations:
        other, r = c.correlations[name]
        partner = f"{other} {r:+.2f}".replace("-", "−") if abs(r) >= 0.1 else ""
        strong = (min(name, other), max(name, other)) in c.correlated_pairs
    low, high = (factor * float(v) for v in c.ci95[k])
    std = float(c.std[k])
    numbers = quantity(factor * float(c.theta[k]) if c.determined[k] else np.nan, factor * std, (low, high),
                       factor * float(parameters.nominal[k]))
    return Parameter(name.rpartition(".")[2], unit, numbers, c.category(name), partner, np.isnan(std), strong)


def _tables(c: Calibration) -> list[dict[str, Any]]:
    """Files with the number of poses taken from them."""
    some = (("training", (c.all_poses or c).problem.poses), ("validation", c.problem.validation))
    kept = c.problem.poses
    return [{"role": role, "path": path or poses.name, "sha256": poses.sha256.get(path, ""),
             "poses": int(np.sum(poses.file == path)),
             "stages": list(dict.fromkeys(map(str, poses.stage[poses.file == path]))),
             "taken": int(np.sum((kept if role == "training" else poses).file == path))}
            for role, poses in some if poses is not None for path in dict.fromkeys(map(str, poses.file))]


def _accuracy(c: Calibration) -> dict[str, str]:
    """Standard deviations over the workspace [mm]; empty where there are none."""
    found = {"median": c.workspace.median_std, "largest": c.workspace.largest_std}
    return {name: plain(1e3 * std, 3) for name, std in found.items()} if np.isfinite(found["median"]) else {}


def _printed(value: float, unit: str) -> str:
    shown, factor = PRINTED.get(unit, (unit_text(unit), 1.0))
    return f"{plain(factor * value, 6)} {shown}"


# --- residuals ---


def residuals(c: Calibration) -> Figure:
    """Residuals of every pose before and after, stage by stage; suspects are ringed."""
    parts = c.residuals
    units = {channel: unit for part in parts for channel, unit in part.units.items()}
    channels = list(units)
    total = sum(len(part.poses) for part in parts)
    crowded = any(len(stage) * 0.056 > count / total * (WIDTH - 0.8) for stage, count in _runs(parts))
    each, top = 2.5, 0.85 if crowded else 0.45
    height = top + each * len(channels)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height))
        for row, channel in enumerate(channels):
            ax = figure.add_axes((0.65 / WIDTH, (0.42 + (len(channels) - 1 - row) * each) / height, 1 - 0.8 / WIDTH,
                                  (each - 0.5) / height))
            start = 0
            for part in parts:
                _stages(ax, part, start, turned=None if row else 25 if crowded else 0)
                x = start + 1 + np.arange(len(part.poses))
                if channel in part.after:
                    flagged = c.suspicious if part.role == "train" else np.zeros(len(x), dtype=bool)
                    _dots(ax, part, channel, x, flagged, 2.2 if total > 300 else 3.2)
                start += len(x)
            ax.set(yscale="log", xlim=(0.5, start + 0.5), ylabel=_in_thousandths(channel, units[channel], " [mm]"))
            ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            ax.grid(axis="x", visible=False)
            ax.tick_params(labelbottom=row == len(channels) - 1)
        figure.axes[-1].set_xlabel("pose, in the order of the files")
        handles: list[Line2D | Patch] = [_dot(GREY, "nominal"), _dot(BLUE, "calibrated")]
        if len(parts) > 1:
            handles += [_dot(ORANGE, "calibrated, held out"), Patch(facecolor=SHADE, edgecolor="#e8d3b0", lw=0.6,
                                                                    label="held out, not used for the estimate")]
        if c.suspicious.any():
            handles.append(Line2D([], [], color="#b3261e", marker="o", mfc="none", ls="none", ms=6, label="suspect"))
        figure.legend(handles=handles, loc="upper left", ncols=len(handles), bbox_to_anchor=(0.05, 1.0),
                      borderaxespad=0.2)
    return figure


def _runs(parts: Sequence[PoseResiduals]) -> list[tuple[str, int]]:
    """Stages with their number of poses, in order."""
    return [(stage, len(list(rows))) for part in parts for stage, rows in groupby(map(str, part.poses.stage))]


def _dot(colour: str, label: str) -> Line2D:
    return Line2D([], [], color=colour, marker="o", ls="none", ms=4, label=label)


def _dots(ax: Axes, part: PoseResiduals, channel: str, x: NDArray[np.int64], flagged: NDArray[np.bool_],
          size: float) -> None:
    for table, colour in ((part.before, GREY), (part.after, BLUE if part.role == "train" else ORANGE)):
        if channel in table:
            ax.plot(x, 1e3 * table[channel], ls="none", marker="o", ms=size, mew=0, color=colour)
    ax.plot(x[flagged], 1e3 * part.after[channel][flagged], ls="none", marker="o", ms=6, mfc="none", mew=0.9,
            color="#b3261e")


def _stages(ax: Axes, part: PoseResiduals, start: int, *, turned: float | None) -> None:
    """Every other stage on a darker ground, held-out poses on their own; names above, turned by an angle [deg]."""
    position = start + 0.5
    for k, (stage, count) in enumerate(_runs([part])):
        if part.role == "validation" or k % 2 == 0:
            colour, alpha = (SHADE, 1.0) if part.role == "validation" else (LIGHT, 0.45)
            ax.axvspan(position, position + count, color=colour, alpha=alpha, lw=0, zorder=0.5)
        if k:
            ax.axvline(position, color=GREY, lw=0.4)
        if turned is not None:
            ax.annotate(stage, (position + count / 2, 1.0), xycoords=ax.get_xaxis_transform(), xytext=(0, 3),
                        textcoords="offset points", rotation=turned, rotation_mode="anchor", va="bottom", fontsize=7,
                        ha="left" if turned else "center", annotation_clip=False)
        position += count


# --- correlations ---


def correlations(c: Calibration) -> Figure | None:
    """Heat map of the correlations of the geometry, with fixtures and locked angles if there is room."""
    identified = np.isfinite(np.diag(c.observability.covariance)) & (np.array(c.observability.category) != "none")
    which = np.flatnonzero(identified)
    if which.size > MOST:
        geometry = c.problem.model.parameters.positions
        which = np.array([k for k in which if c.observability.names[k] in geometry], dtype=int)
    if which.size < 2:
        return None
    covariance = c.observability.covariance[np.ix_(which, which)]
    std = np.sqrt(np.diag(covariance))
    correlation = np.where(np.eye(len(which), dtype=bool), np.nan, covariance / np.outer(std, std))
    names = [c.observability.names[k] for k in which]
    size = len(names)
    cell = min(0.3, 7.4 / size)
    side, margin = cell * size, 0.053 * max(map(len, names)) + 0.12
    height = side + margin + 0.1
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height))

        def room(left: float, width: float, tall: float) -> tuple[float, float, float, float]:
            return left / WIDTH, margin / height, width / WIDTH, tall / height

        ax = figure.add_axes(room(margin, side, side), facecolor=LIGHT)
        picture = ax.imshow(correlation, cmap="RdBu_r", vmin=-1, vmax=1, interpolation="nearest")
        ax.set_xticks(range(size), names, rotation=90, fontsize=7 if cell > 0.16 else 5.5)
        ax.set_yticks(range(size), names, fontsize=7 if cell > 0.16 else 5.5)
        ax.tick_params(length=0)
        ax.grid(visible=False)
        for i, j in np.argwhere(np.abs(np.nan_to_num(correlation)) > 0.3).tolist() if cell > 0.2 else ():
            ax.text(j, i, f"{correlation[i, j]:.2f}".replace("0.", ".").replace("-", "−"), ha="center", va="center",
                    fontsize=5.5, color="white" if abs(correlation[i, j]) > 0.7 else INK)
        bar = figure.colorbar(picture, cax=figure.add_axes(room(margin + side + 0.2, 0.16, min(side, 3.0))))
        bar.set_label("correlation [1]")
    return figure


# --- workspace ---


def workspace(c: Calibration) -> Figure | None:
    """Mean standard deviation of the machine's end over its workspace from the side and from above."""
    space = c.workspace
    known = np.isfinite(space.std)
    if not np.any(space.std[known]):
        return None
    std = 1e3 * space.std[known]
    views = ((_side, "from the side, turned into one plane", "radius from the base's z axis [m]",
              "height along it [m]"), (_above, "from above, all heights", "x [m]", "y [m]"))
    spans = [np.ptp(view(space.position[known]), axis=0) for view, *_ in views]
    shown = [(*view, span) for view, span in zip(views, spans, strict=True)
             if np.min(span) > FLAT * np.max(span)]  # a plane is a line from above
    if not shown:
        return None
    tall = min(4.4, (WIDTH - 2.7) / sum(float(span[0] / span[1]) for *_, span in shown))
    height, left = tall + 1.05, 0.65
    colours = Normalize(float(np.quantile(std, 0.005)), float(np.quantile(std, 0.995)))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height))
        for view, title, across, up, span in shown:
            wide = tall * float(span[0] / span[1])
            ax = figure.add_axes((left / WIDTH, 0.5 / height, wide / WIDTH, tall / height))
            mean, edges = _binned(view(space.position[known]), std)
            ax.pcolormesh(*edges, mean.T, cmap="viridis", norm=colours, rasterized=True)
            ax.plot(*view(space.measured).T, ls="none", marker="o", ms=2.4, mfc="white", mec=INK, mew=0.4,
                    label="measured poses")
            ax.set(xlabel=across, title=title)
            ax.set_ylabel(up, labelpad=1)
            left += max(wide, 2.2) + 0.75
        bar = figure.colorbar(ScalarMappable(colours, "viridis"), extend="both", cax=figure.add_axes((
            (left - 0.45) / WIDTH, 0.55 / height, 0.17 / WIDTH, min(3.6, 0.9 * tall) / height)))
        bar.set_label(f"standard deviation of the {space.point} [mm]")
        figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="upper left", bbox_to_anchor=(0.05, 1.0),
                      borderaxespad=0.2)
    return figure


def _side(points: Array) -> Array:
    return np.stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]], axis=-1)


def _above(points: Array) -> Array:
    return points[:, :2]


def _binned(points: Array, values: Array) -> tuple[Array, list[Array]]:
    """Mean of the values in square cells, NaN where there is none, and the cells' edges."""
    low, high = points.min(axis=0), points.max(axis=0)
    cell = float(np.max(high - low)) / BINS
    edges = [np.arange(low[k] - cell / 2, high[k] + cell, cell) for k in range(2)]
    total, count = (np.histogram2d(points[:, 0], points[:, 1], bins=edges, weights=weights)[0]
                    for weights in (values, np.ones_like(values)))
    return np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0), edges


# --- chain ---


def chains(c: Calibration) -> Figure | None:
    """The closed chain from the side in some measured poses of some stages; the first of each in full colour."""
    problem = c.problem
    machine, stage_of = problem.model.machine, problem.poses.stage
    if machine.calibrator is None:
        return None
    stages = _spread(list(dict.fromkeys(map(str, stage_of))), PANELS)
    views = [_flattened(c.chain(_spread(np.flatnonzero(stage_of == stage).tolist(), SHOWN)))
             for stage in stages]
    corners = np.concatenate([part.reshape(-1, 2) for view in views for part in (view.points, view.fixture, view.pins)])
    low, high = np.nanmin(corners, axis=0), np.nanmax(corners, axis=0)
    low, high = low - 0.05 * np.max(high - low), high + 0.05 * np.max(high - low)
    wide = (WIDTH - 0.65) / len(views) - 0.15
    tall = min(4.2, wide * float((high - low)[1] / (high - low)[0]))
    height = tall + 0.95
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height))
        for k, (stage, view) in enumerate(zip(stages, views, strict=True)):
            ax = figure.add_axes(((0.6 + k * (wide + 0.15)) / WIDTH, 0.42 / height, wide / WIDTH, tall / height))
            for pose in reversed(range(len(view.points))):
                _draw(ax, view, pose, faint=pose > 0)
            ax.axhline(0, color=GREY, lw=0.6, zorder=0.8)
            ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="reach [m]", title=stage or "poses")
            ax.set_aspect("equal")
            ax.tick_params(labelleft=k == 0)
        figure.axes[0].set_ylabel("height [m]")
        handles = [Line2D([], [], color=INK, lw=2.4, marker="o", mfc="white", ms=4, label="machine"),
                   Line2D([], [], color=ORANGE, lw=2, marker="o", mfc="white", ms=4,
                          label="calibrator" if machine.calibrator.links else "tool")]
        if machine.pinned:
            handles.append(Line2D([], [], color=BLUE, lw=2, label="cylinders"))
        if machine.fixtures:
            handles.append(Line2D([], [], color=GREEN, marker="D", ls="none", ms=6, label="fixture"))
        figure.legend(handles=handles, loc="upper left", ncols=4, bbox_to_anchor=(0.05, 1.0), borderaxespad=0.2)
    return figure


def _spread(things: list[Any], most: int) -> list[Any]:
    """Some of a list, evenly from the first to the last."""
    return [things[k] for k in dict.fromkeys(np.linspace(0, len(things) - 1, most).round().astype(int).tolist())]


def _flattened(chain: ChainPoints) -> ChainPoints:
    """The chain seen perpendicularly to the vertical plane in which it mainly lies."""
    flat = chain.points[:, :, :2].reshape(-1, 2)
    across = np.linalg.svd(flat, full_matrices=False)[2][0]
    across = across * (1.0 if across @ flat.sum(axis=0) >= 0 else -1.0)

    def projected(points: Array) -> Array:
        return np.stack([points[..., :2] @ across, points[..., 2]], axis=-1)

    return chain._replace(points=projected(chain.points), fixture=projected(chain.fixture), pins=projected(chain.pins))


def _draw(ax: Axes, view: ChainPoints, pose: int, *, faint: bool) -> None:
    alpha = 0.25 if faint else 1.0
    points, machine = view.points[pose], view.machine_links + 1
    for pins, carriers in zip(view.pins[pose], view.carrier, strict=True):
        for pin, link in zip(pins, carriers, strict=True):
            if link >= 0:  # what carries the pin, as a triangle on the link's line
                ax.plot(*np.array([points[link], pin, points[link + 1]]).T, color=GREY, lw=0.8, alpha=0.7 * alpha)
        ax.plot(*pins.T, color=BLUE, lw=2.2, alpha=alpha, solid_capstyle="round")
    for part, colour, width in ((points[:machine], INK, 2.6), (points[machine - 1 :], ORANGE, 2.0)):
        ax.plot(*part.T, color=colour, lw=width, alpha=alpha, marker="o", ms=3.4, mfc="white", mew=1.0)
    ax.plot(*view.fixture[pose], color=GREEN, marker="D", ms=6, ls="none", zorder=5, alpha=0.5 if faint else 1.0)
