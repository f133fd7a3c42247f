"""The drawing of a machine from the side as a matplotlib figure, which notebooks show and files keep."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hydroopt.model.model import Model
from hydroopt.model.vertical_plane import SidePostures
from hydroopt.plots.figures import BLUE, GREEN, GREY, INK, ORANGE, STYLE, WIDTH
from hydroopt.report.drawing import Drawing, Posture, View, coil, drawn

ROOM = (9.4, 5.6)
"""Largest width and height of the drawing [in]."""
LETTER, LINE = 4.8, 11.0
"""Width of a letter and height of a line [pt]."""
FACES = {"link": "#b4c1cd", "chassis": "#8b98a5"}
STROKES = {"cylinder": BLUE, "gas": GREEN, "spring": GREEN, "rod": INK}
INKS = {"link": INK, "com": ORANGE, **STROKES}
"""Colours of links, struts and names by kind."""


def side_view(model: Model, shown: SidePostures, first: str, others: str) -> Figure:
    """The machine in its first posture, with the others faint behind it; `first` and `others` say what they are."""
    found = drawn(model.scene_graph, model.scene_graph.tree_positions(shown.q), View.side(shown.plane))
    low, high = found.corners
    scale = float(np.min(ROOM / (high - low)))
    width, height = (high - low) * scale
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height + 0.9))
        left = (WIDTH - width) / 2
        ax = figure.add_axes((left / WIDTH, 0.45 / (height + 0.9), width / WIDTH, height / (height + 0.9)))
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", ylabel="height [m]",
               xlabel="reach in the plane of the drawing [m]")
        for posture in found.others:
            _parts(ax, posture, alpha=0.16)
        _parts(ax, found.first, alpha=1.0)
        _dots(ax, found.first)
        for name in found.lettered(72 * scale, LETTER, LINE):
            ax.text(float(name.at[0]), float(name.at[1]), name.text, ha="center", va="center", fontsize=8,
                    color=INKS[name.kind], zorder=6, weight="bold",
                    bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8})
        figure.legend(handles=_handles(found, first, others), loc="upper left", ncols=6, borderaxespad=0.2,
                      bbox_to_anchor=(max(0.01, (left - 0.1) / WIDTH), 1.0))
    return figure


def _parts(ax: Axes, posture: Posture, *, alpha: float) -> None:
    for part in posture.parts:
        x, y = (coil(*part.corners) if part.kind == "spring" else part.corners).T
        if part.kind in FACES:
            for width, colour in ((6.5, INK), (5.0, FACES[part.kind])):
                ax.fill(x, y, facecolor=colour, edgecolor=colour, lw=width, joinstyle="round", alpha=alpha, zorder=3)
        else:
            ax.plot(x, y, color=STROKES[part.kind], lw=1.4 if part.kind == "spring" else 2.2, alpha=alpha, zorder=3.3)
            if len(x) == 3:
                ax.plot(x[:2], y[:2], color=STROKES[part.kind], lw=6.5, alpha=alpha, zorder=3.4, solid_capstyle="butt")


def _dots(ax: Axes, posture: Posture) -> None:
    for places, size, colour in ((list(posture.masses.values()), 6.0, ORANGE), (list(posture.pins), 4.2, GREY),
                                 (list(posture.joints.values()), 6.5, INK)):
        if places:
            ax.plot(*np.array(places).T, ls="none", marker="o", ms=size, mfc="white", mec=colour, mew=1.4, zorder=5)


def _handles(found: Drawing, first: str, others: str) -> list[Line2D]:
    kinds = {part.kind for part in found.first.parts}
    handles = [Line2D([], [], ls="none", marker="o", ms=6, mfc="white", mec=INK, mew=1.6, label="joint")]
    handles += [Line2D([], [], color=STROKES[kind], lw=4, label=label) for kind, label in (
        ("cylinder", "cylinder"), ("gas", "gas cylinder"), ("spring", "spring"), ("rod", "rod")) if kind in kinds]
    if found.first.masses:
        handles.append(Line2D([], [], ls="none", marker="o", ms=6, mfc="white", mec=ORANGE, mew=1.2,
                              label="nominal centre of mass"))
    return [*handles, Line2D([], [], color=FACES["link"], lw=5, label=first),
            Line2D([], [], color=FACES["link"], lw=5, alpha=0.3, label=others)]
