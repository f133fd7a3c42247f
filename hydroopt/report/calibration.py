"""The report of a kinematic calibration: its figures and one self-contained HTML page; draws, computes nothing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from hydroopt.report.charts import Chart, Curves, Field, Line, TimeChart
from hydroopt.report.drawing import LETTER
from hydroopt.report.numbers import NONE, plain, unit_text
from hydroopt.report.page import document, fragment
from hydroopt.report.panels import NUMBERS, with_unit
from hydroopt.report.samples import Samples, Span
from hydroopt.report.scene import SceneView, base_point
from hydroopt.report.tables import by_owner
from hydroopt.results.diagnostic import listed
from hydroopt.results.status import Status
from hydroopt.spatial.inertia import Array

if TYPE_CHECKING:
    from hydroopt.estimation.kinematic.calibration import Calibration
    from hydroopt.results.fit import Fit
    from hydroopt.spatial.inertia import Array

METHODS = {
    "joint": "all poses, stages and parameters at once; sensed angles err, too (maximum likelihood, IPOPT)",
    "hierarchical": "link by link from the tip inwards (Levenberg-Marquardt with truncated singular values)",
}
"""Methods in words."""

LOOKS = {("nominal", "machine"): "measured", ("nominal", "calibrator"): "fifth",
         ("calibrated", "machine"): "predicted", ("calibrated", "calibrator"): "other"}
"""Looks of both sides of the chain by geometry and side."""
MOST = 40
"""Parameters that the map of correlations can name legibly."""
FIXTURES = 12
"""Fixtures that the machine in space shows."""
FLAT = 1e-6
"""Width of a view, relative to its length, from which on it is drawn."""
CELL, LEAST_CELL, LEAST_WRITTEN, SIDE = 30.0, 15.0, 24.0, 720.0
"""Largest and smallest side of a cell, that from which on its number is written, and that of the whole map from which
on cells shrink [px]."""
FAINT, WRITTEN = 0.02, 0.3
"""Magnitudes from which on a cell is coloured, and its number written."""
NAMED = 3
"""Pairs that the description names."""


def render(c: Calibration) -> str:
    """The report as one HTML page that needs nothing else."""
    problem, identified = c.problem, c.observability
    return document(
        "calibration.html", samples=_samples(c), charts={
            "residuals": _residuals(c), "sides": _sides(c), "workspace": _workspace(c)},
        scene=_scene(c), answer=c, machine=problem.model.machine, calibration=c,
        suspect=c.status is not Status.OK,
        method=METHODS.get(c.method, ""), fit=_fit(c), groups=list(by_owner(c.parameters, NUMBERS).items()),
        partners=_partners(c), correlations=_correlations(c),
        counts=Counter(each.identifiability for each in c.parameters.rows),
        tables=_tables(c), stages=len(set(problem.poses.stage)),
        suspects=[s.diagnostic.text for s in c.suspects], left_out=[s.diagnostic.text for s in c.left_out],
        condition=plain(identified.condition_number, 3), amplification=plain(identified.noise_amplification_index, 3),
        scale=plain(c.noise_scale, 3), accuracy=_accuracy(c),
        fixed=[f"{name} = {with_unit(value, problem.parameters.units[problem.parameters.index(name)], digits=6)}"
               for name, value in problem.fixed.items()])


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


def _partners(c: Calibration) -> dict[str, tuple[str, bool]]:
    """By parameter the one that it is most correlated with, and whether the poses hardly separate them."""
    return {name: (f"{other} {r:+.2f}".replace("-", "−") if abs(r) >= 0.1 else "",
                   (min(name, other), max(name, other)) in c.correlated_pairs)
            for name, (other, r) in c.correlations.items()}


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


# --- poses ---


def _samples(c: Calibration) -> Samples:
    """Joint positions and residuals [mm or mrad] of every pose; held-out poses follow those of training."""
    joints, parts = c.problem.model.joints, c.residuals
    sizes = [len(part.poses) for part in parts]
    columns: dict[str, list[Array]] = {}
    for number, part in enumerate(parts):
        solved = part.role == "train" and len(c.q) == sizes[number]
        known = c.q if solved else np.full((sizes[number], len(joints)), np.nan)
        made = {f"{joint}.q": known[:, k] for k, joint in enumerate(joints)}
        for when, table in (("before", part.before), ("after", part.after)):
            made |= {f"{channel}.{when}": 1e3 * values for channel, values in table.items()}
        for name in {*columns, *made}:
            columns.setdefault(name, [np.full(size, np.nan) for size in sizes[:number]]).append(
                made.get(name, np.full(sizes[number], np.nan)))
    ends = np.cumsum([0, *sizes]).tolist()
    spans = tuple(Span(a, b - 1, "training" if part.role == "train" else "held out", part.role)
                  for part, a, b in zip(parts, ends, ends[1:], strict=False) if b > a)
    return Samples("pose, in the order of the files", np.arange(1.0, ends[-1] + 1),
                   {name: np.concatenate(values) for name, values in columns.items()}, spans)


def _residuals(c: Calibration) -> list[Chart]:
    """Residuals of every pose before and after, by channel."""
    units = {channel: unit for part in c.residuals for channel, unit in part.units.items()}
    made: list[Chart] = []
    for channel, unit in units.items():
        table = c.fit.get("train", {}).get(channel)
        printed = f"{_in_thousandths(channel, unit, ' [mm]')}"
        rms = "" if table is None else f", RMS {plain(1e3 * table.rms, 3)} as calibrated on the training poses"
        lines = [Line(f"{channel}.{when}", label, look, dots=True) for when, label, look in (
            ("before", "nominal", "measured"), ("after", "calibrated", "predicted"))
            if any(channel in getattr(part, when) for part in c.residuals)]
        made.append(TimeChart(printed, tuple(lines), f"Residual of {printed} of every pose{rms}.", logarithmic=True))
    return made


def _scene(c: Calibration) -> SceneView:
    """The chain as calibrated in every training pose, with the places that held its tip."""
    fixtures = tuple(base_point(f"fixture {k + 1}", at.tolist(), "fixture", 0.0)
                     for k, at in enumerate(c.held_at[:FIXTURES]))
    return SceneView(c.scene, tuple(f"{joint}.q" for joint in c.problem.model.joints), marks=fixtures)


def _workspace(c: Calibration) -> list[Chart]:
    """Standard deviation of the machine's end over its workspace, from the side and from above."""
    known = np.isfinite(c.workspace.std)
    x, y, z = c.workspace.position[known].T
    std = 1e3 * c.workspace.std[known]
    if not np.any(std):
        return []
    views = (("from the side, turned into one plane", np.hypot(x, y), z, "radius from the base's z axis [m]",
              "height along it [m]"), ("from above, all heights", x, y, "x [m]", "y [m]"))
    return [Field(f"standard deviation of the {c.workspace.point}, {title}", across, up, std, "mm", below, beside)
            for title, across, up, below, beside in views
            if min(np.ptp(across), np.ptp(up)) > FLAT * max(np.ptp(across), np.ptp(up))]  # a plane is a line from above


def _sides(c: Calibration) -> list[Chart]:
    """Distances from links to the fixture less those taped, or of the machine's side less the calibrator's (Figure 19).
    """
    made: list[Chart] = []
    for role, link in dict.fromkeys((each.role, each.link) for each in c.sides):
        own = [one for one in c.sides if (one.role, one.link) == (role, link)]
        taped = any(np.isfinite(one.tape).any() for one in own)
        lines = [(f"{one.geometry}, {side}'s side", LOOKS[one.geometry, side],
                  1e3 * (getattr(one, side) - (one.tape if taped else one.calibrator)))
                 for one in own for side in (("machine", "calibrator") if taped else ("machine",))]
        poses = np.arange(1.0, len(own[0].tape) + 1)
        made.append(Curves(f"{link} to the fixture, {role} poses: less {'tape' if taped else 'calibrator'} [mm]",
                           "pose, in the order of the files", poses, tuple(lines), dots=True))
    return made


def _correlations(c: Calibration) -> Markup:
    """Map of the correlations of the geometry, with fixtures and locked angles if there is room; empty without any."""
    identified = np.isfinite(np.diag(c.observability.covariance)) & (np.array(c.observability.category) != "none")
    which = np.flatnonzero(identified)
    if which.size > MOST:
        geometry = c.problem.model.parameters.positions
        which = np.array([k for k in which if c.observability.names[k] in geometry], dtype=int)
    if which.size < 2:
        return Markup()
    covariance = c.observability.covariance[np.ix_(which, which)]
    std = np.sqrt(np.diag(covariance))
    return correlation_map([c.observability.names[k] for k in which], covariance / np.outer(std, std))


def correlation_map(names: Sequence[str], correlation: Array) -> Markup:
    """An ``<svg>`` element of the correlations (n, n) below the diagonal; one colour a sign, fainter near zero.

    >>> import numpy as np
    >>> shown = correlation_map(["boom.a", "ball.x"], np.array([[1.0, -0.9], [-0.9, 1.0]]))
    >>> "Correlations of 2 parameters. Most correlated: boom.a and ball.x by −.90." in shown
    True
    """
    cell = max(LEAST_CELL, min(CELL, SIDE / len(names)))
    margin = LETTER * max(map(len, names)) + 12
    cells = [{"r": r, "x": margin + j * cell, "y": i * cell, "pair": f"{names[i]}, {names[j]}", "shown": _written(r),
              "written": abs(r) > WRITTEN and cell > LEAST_WRITTEN}
             for j, i in combinations(range(len(names)), 2) if abs(r := float(correlation[i, j])) > FAINT]
    return fragment("correlations.svg", names=names, cells=cells, cell=cell, margin=margin,
                    side=margin + len(names) * cell + LETTER, said=_description(names, correlation))


def _description(names: Sequence[str], correlation: Array) -> str:
    """The map in words: the pairs that are separated worst."""
    pairs = sorted(combinations(range(len(names)), 2), key=lambda pair: -abs(correlation[pair]))
    worst = [f"{names[i]} and {names[j]} by {_written(float(correlation[i, j]))}"
             for i, j in pairs[:NAMED]]
    return f"Correlations of {len(names)} parameters. Most correlated: {listed(worst)}."


def _written(r: float) -> str:
    return f"{r:+.2f}".replace("-", "−").replace("+0.", "+.").replace("−0.", "−.")
