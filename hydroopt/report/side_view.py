"""The machine from the side: links, joints, cylinders and centres of mass in the vertical plane it mainly moves in."""

from __future__ import annotations

import hydroopt.report.with_matplotlib  # noqa: F401

# isort: split
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hydroopt.machine.actuators import Cylinder, GasCylinder
from hydroopt.machine.links import Link
from hydroopt.machine.machine import Machine
from hydroopt.report.figures import BLUE, GREEN, GREY, INK, ORANGE, STYLE, WIDTH
from hydroopt.spatial.inertia import Array

if TYPE_CHECKING:
    from hydroopt.model.scene import Scene

ROOM = (9.4, 5.6)
"""Largest width and height of the drawing [in]."""


def side_view(machine: Machine, scenes: Sequence[Scene], first: str, others: str) -> Figure:
    """The machine in its first scene, with the others faint behind it; `first` and `others` say what they are."""
    corners = np.array([p for s in scenes for part in (s.start, s.axis, s.end, s.mass, s.barrel, s.rod, s.closing)
                        for p in part.values()] + [np.zeros(2)])
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = float(np.max(high - low))
    low, high = low - 0.07 * size, high + 0.07 * size
    scale = min(ROOM[0] / (high[0] - low[0]), ROOM[1] / (high[1] - low[1]))
    width, height = (high - low) * scale
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height + 0.9))
        left = (WIDTH - width) / 2
        ax = figure.add_axes((left / WIDTH, 0.45 / (height + 0.9), width / WIDTH, height / (height + 0.9)))
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", ylabel="height [m]",
               xlabel="reach in the plane of the drawing [m]")
        ax.grid(visible=True)
        _ground(ax, 0.05 * size)
        for scene in scenes[1:]:
            _draw(ax, machine, scene, faint=True)
        _draw(ax, machine, scenes[0], faint=False)
        _labels(ax, machine, scenes[0], scale * 72, (low, high))
        if machine.gravity:
            _gravity(ax)
        figure.legend(handles=_handles(machine, first, others), loc="upper left", ncols=6, borderaxespad=0.2,
                      bbox_to_anchor=(max(0.01, (left - 0.1) / WIDTH), 1.0))
    return figure


def _outline(machine: Machine, scene: Scene, link: Link) -> Array:
    """Convex outline (k, 2) of the points that a link joins: its joint, its far end and the pins on it."""
    points = [scene.start[link.name], scene.axis[link.name], scene.end[link.name]]
    for cylinder in machine.pinned:
        points += [pins[cylinder.name] for end, pins in ((cylinder.barrel, scene.barrel), (cylinder.rod, scene.rod))
                   if end.link == link.name]
    points += [scene.start[child.name] for child in machine.links if child.parent == link.name]
    points += [scene.closing[loop.name] for loop in machine.loops if loop.to.link == link.name]
    return _hull(np.array(points))


def _hull(points: Array) -> Array:
    """Convex hull (k, 2) of points in the plane, counter-clockwise (Andrew's monotone chain)."""
    ordered = np.unique(np.round(points, 9), axis=0)
    if len(ordered) < 3:
        return ordered
    chains = []
    for sequence in (ordered, ordered[::-1]):
        chain: list[Array] = []
        for p in sequence:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], p) <= 0:
                chain.pop()
            chain.append(p)
        chains += chain[:-1]
    return np.array(chains)


def _turn(a: Array, b: Array, c: Array) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _draw(ax: Axes, machine: Machine, scene: Scene, *, faint: bool) -> None:
    alpha, order = (0.16, 2.0) if faint else (1.0, 3.0)
    for link in machine.links:
        outline = _outline(machine, scene, link)
        if len(outline) > 2:
            ax.fill(*outline.T, facecolor="#cfd8e1", edgecolor="#5c6b7a", lw=0.5 if faint else 1.0, joinstyle="round",
                    alpha=0.16 if faint else 0.55, zorder=order)
        chain = np.array([scene.start[link.name], scene.axis[link.name], scene.end[link.name]])
        ax.plot(*chain.T, color=INK, lw=1.4 if faint else 2.6, alpha=alpha, zorder=order + 0.1, solid_capstyle="round")
        if link.name in scene.mass and not faint:
            if float(np.ptp(outline, axis=0).max(initial=0.0)) < 1e-6:
                ax.plot(*np.array([scene.axis[link.name], scene.mass[link.name]]).T, color=GREY, lw=1.0, ls=(0, (3, 2)),
                        zorder=order)
            ax.plot(*scene.mass[link.name], marker="o", ms=6, mfc="white", mec=ORANGE, mew=1.2, zorder=order + 1)
            ax.plot(*scene.mass[link.name], marker="+", ms=6, mec=ORANGE, mew=0.9, zorder=order + 1)
    cylinders: tuple[Cylinder | GasCylinder, ...] = (*machine.cylinders, *machine.gas_cylinders)
    for cylinder in cylinders:
        barrel, rod = scene.barrel[cylinder.name], scene.rod[cylinder.name]
        colour = BLUE if isinstance(cylinder, Cylinder) else GREEN
        # a barrel is a little shorter than the retracted cylinder; of a gas cylinder a length of reference is known
        body = 0.9 * cylinder.dead_length if isinstance(cylinder, Cylinder) else 0.6 * cylinder.reference_length
        neck = barrel + (rod - barrel) * min(0.95, body / scene.length[cylinder.name])
        ax.plot(*np.array([barrel, rod]).T, color=colour, lw=1.2 if faint else 2.2, alpha=alpha, zorder=order + 0.3)
        if not faint:
            ax.plot(*np.array([barrel, neck]).T, color=colour, lw=6.5, zorder=order + 0.4, solid_capstyle="butt")
            ax.plot(*np.array([barrel, rod]).T, ls="none", marker="o", ms=4.2, mfc="white", mec=colour, mew=1.2,
                    zorder=order + 0.6)
    for spring in machine.springs:
        coil = _coil(scene.barrel[spring.name], scene.rod[spring.name])
        ax.plot(*coil.T, color=GREEN, lw=0.8 if faint else 1.4, alpha=alpha, zorder=order + 0.3)
    if not faint:
        joints = np.array([*(scene.axis[joint] for joint in machine.tree_joints), *scene.closing.values()])
        ax.plot(*joints.T, ls="none", marker="o", ms=6.5, mfc="white", mec=INK, mew=1.6, zorder=order + 0.7)


def _coil(start: Array, end: Array) -> Array:
    """Points (k, 2) of a spring's zigzag between its pins."""
    along = np.concatenate([[0.0, 0.15], np.linspace(0.2, 0.8, 13), [0.85, 1.0]])
    aside = np.concatenate([[0.0, 0.0], 0.04 * (-1.0) ** np.arange(13), [0.0, 0.0]])
    line = end - start
    return np.asarray(start + np.outer(along, line) + np.outer(aside, [-line[1], line[0]]))


def _ground(ax: Axes, size: float) -> None:
    """The sign of what stands fast, at the base frame's origin."""
    ax.plot([-size, size], [0, 0], color=INK, lw=1.4, zorder=2.5)
    for x in np.linspace(-size, 0.75 * size, 8):
        ax.plot([x, x - 0.3 * size], [0, -0.35 * size], color=INK, lw=0.6, zorder=2.5)


def _gravity(ax: Axes) -> None:
    ax.annotate("", xy=(0.975, 0.80), xytext=(0.975, 0.93), xycoords="axes fraction",
                arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 1.2, "shrinkA": 0, "shrinkB": 0})
    ax.text(0.968, 0.865, "g", transform=ax.transAxes, ha="right", va="center", style="italic", fontsize=10)


def _handles(machine: Machine, first: str, others: str) -> list[Line2D]:
    handles = [Line2D([], [], ls="none", marker="o", ms=6, mfc="white", mec=INK, mew=1.6, label="joint")]
    if machine.cylinders:
        handles.append(Line2D([], [], color=BLUE, lw=4, label="cylinder"))
    if machine.gas_cylinders:
        handles.append(Line2D([], [], color=GREEN, lw=4, label="gas cylinder"))
    if machine.springs:
        handles.append(Line2D([], [], color=GREEN, lw=1.4, label="spring"))
    if any(link.body for link in machine.links):
        handles.append(Line2D([], [], ls="none", marker="o", ms=6, mfc="white", mec=ORANGE, mew=1.2,
                              label="nominal centre of mass"))
    return [*handles, Line2D([], [], color=INK, lw=2.6, label=first),
            Line2D([], [], color=INK, lw=1.6, alpha=0.25, label=others)]


def _labels(ax: Axes, machine: Machine, scene: Scene, points: float, limits: tuple[Array, Array]) -> None:
    """Names beside joints, cylinders and bodies, each where it covers least; `points` is the drawing's scale [pt/m]."""
    taken = [scene.axis[j] for j in machine.joints] + list(scene.mass.values())
    for link in machine.links:
        chain = (scene.start[link.name], scene.axis[link.name], scene.end[link.name])
        taken += [a + t * (b - a) for a, b in pairwise(chain) for t in np.linspace(0, 1, 25)]
    for name in scene.rod:
        taken += [scene.barrel[name] + t * (scene.rod[name] - scene.barrel[name]) for t in np.linspace(0, 1, 25)]
    busy = np.array(taken) * points
    wanted: list[tuple[str, Array, str]] = []
    for joint in machine.joints:
        for i, (text, at, colour) in enumerate(wanted):
            if np.linalg.norm(at - scene.axis[joint]) * points < 8:
                wanted[i] = (f"{text}, {joint}", at, colour)
                break
        else:
            wanted.append((joint, scene.axis[joint], INK))
    wanted += [(c.name, (scene.barrel[c.name] + scene.rod[c.name]) / 2, BLUE if isinstance(c, Cylinder) else GREEN)
               for c in machine.pinned]
    wanted += [(link.name, scene.mass[link.name], ORANGE) for link in machine.links
               if link.name in scene.mass and link.name not in machine.joints]
    boxes: list[tuple[Array, Array]] = []
    for text, at, colour in wanted:
        half = np.array([2.4 * len(text) + 2, 5.5])
        best = min(_places(at * points, half), key=lambda c: _cover(c, half, busy, boxes, at * points, limits, points))
        boxes.append((best, half))
        x, y = (float(v) / points for v in best)
        ax.text(x, y, text, ha="center", va="center", fontsize=8, color=colour, zorder=6, weight="bold",
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8})


def _places(at: Array, half: Array) -> list[Array]:
    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    return [at + np.array([np.cos(a), np.sin(a)]) * (half + gap) for gap in (7, 13, 20, 30) for a in angles]


def _cover(centre: Array, half: Array, busy: Array, boxes: list[tuple[Array, Array]], at: Array,
           limits: tuple[Array, Array], points: float) -> float:
    """How bad a place is for a label: what it covers, how far it is, whether it leaves the drawing."""
    hidden = float(np.sum(np.all(np.abs(busy - centre) < half + 2, axis=1)))
    clash = sum(bool(np.all(np.abs(other - centre) < half + size)) for other, size in boxes)
    outside = bool(np.any(centre - half < limits[0] * points) or np.any(centre + half > limits[1] * points))
    return hidden + 30 * clash + 50 * outside + 0.06 * float(np.linalg.norm(np.maximum(np.abs(centre - at) - half, 0)))
