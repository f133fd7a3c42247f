"""Figures that explain, drawn with hydroopt itself while the site is built."""

from __future__ import annotations

import io
import re
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

import hydroopt as ho
from hydroopt.estimation.inference import identifiability
from hydroopt.model.vertical_plane import limit_postures
from hydroopt.plots.side_view import side_view
from hydroopt.spatial import inertia

BLUE, ORANGE, GREY, INK = "#0072b2", "#d55e00", "#c9d2db", "#1f2933"
STYLE = {"font.size": 10, "axes.edgecolor": INK, "axes.labelcolor": INK, "text.color": INK, "axes.spines.top": False,
         "axes.spines.right": False, "svg.hashsalt": "hydroopt", "svg.fonttype": "none", "font.family": "sans-serif"}
CRANE = """
name = "crane"
orientation = ["90 deg", "0 deg", "0 deg"]
[[links]]
name = "boom"
joint = {{ type = "revolute", a = "2.9 m", lower = "0 deg", upper = "60 deg" }}
[links.body]
m = "{mass} kg"
com = ["{centre} m", "0 m", "0 m"]
inertia_com = ["1 kg*m^2", "0 kg*m^2", "0 kg*m^2", "50 kg*m^2", "0 kg*m^2", "50 kg*m^2"]
[[cylinders]]
name = "boom_cylinder"
bore = "100 mm"
rod_diameter = "56 mm"
dead_length = "0.82 m"
stroke = "0.535 m"
barrel = {{ link = "base", pin = ["0.26 m", "-1.04 m", "0 m"] }}
rod = {{ link = "boom", pin = ["0.30 m", "-0.10 m", "0 m"] }}
"""
BOOMS = ((125.0, 1.1, BLUE), (110.0, 1.25, ORANGE))


def pages(docs: Path) -> dict[str, str]:
    """SVG text of each figure by its path below ``docs/generated``."""
    *_, crane = re.findall(r"^```toml\n(# crane\.toml\n.*?)^```",
                           (docs / "tutorials/crane_by_hand.md").read_text("utf-8"), re.DOTALL | re.MULTILINE)
    drawn = {"crane": _drawing(ho.read_machine(crane)), "excavator": _drawing(ho.load_machine("excavator_bucket"))}
    with matplotlib.rc_context(STYLE):
        drawn |= {"two_booms": _two_booms(), "cat215b_parameters": _parameters(), "interval": _interval(),
                  "controller": _controller()}
        return {f"figures/{name}.svg": _svg(figure) for name, figure in drawn.items()}


def _drawing(machine: ho.Machine) -> Figure:
    """The machine from the side, as ``show -o`` draws it."""
    model = ho.Model(machine)
    return side_view(model, limit_postures(model), "middle of all ranges", "limits of each joint")


def _svg(figure: Figure) -> str:
    stream = io.StringIO()
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None}, bbox_inches="tight", pad_inches=0.15)
    return stream.getvalue()


def _two_booms() -> Figure:
    figure = Figure(figsize=(8.6, 3.2))
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.2))
    for row, (mass, centre, colour) in enumerate(BOOMS):
        _boom(left, -0.75 * row, mass, centre, colour)
        model = ho.Model(ho.read_machine(CRANE.format(mass=mass, centre=centre)))
        angles = np.linspace(0, np.pi / 3, 61)
        force = [float(model.inverse_dynamics(q, 0, 0, model.parameters.nominal)) / 1e3 for q in angles]
        right.plot(np.degrees(angles), force, color=colour, lw=5 - 3 * row, ls=("-", (0, (3, 2)))[row],
                   label=f"{mass:.0f} kg at {centre:g} m")
    left.set(xlim=(-0.3, 3.2), ylim=(-1.15, 0.45), aspect="equal")
    left.axis("off")
    right.set(xlabel="angle of the boom [deg]", ylabel="force of the cylinder [kN]", ylim=(0, None))
    right.legend(frameon=False)
    return figure


def _boom(ax: Axes, y: float, mass: float, centre: float, colour: str) -> None:
    ax.plot([0, 2.9], [y, y], color=GREY, lw=14, solid_capstyle="round")
    ax.plot(0, y, "o", ms=8, mfc="white", mec=INK, mew=1.6)
    ax.plot(centre, y, "o", ms=mass / 8, color=colour)
    ax.annotate(f"{mass:.0f} kg at {centre:g} m", (centre, y + 0.16), ha="center", va="bottom", color=colour)


def _parameters() -> Figure:
    model = ho.Model(ho.load_machine("cat215b"))
    found = dict(zip(model.parameters.names, identifiability.structural(model).category, strict=True))
    bodies = list(model.parameters.bodies)
    colours = {"full": BLUE, "combination": "#8fc7e8", "none": "#eceff2"}
    figure = Figure(figsize=(8.6, 3.1))
    ax = figure.subplots()
    for row, body in enumerate(bodies):
        for column, name in enumerate(inertia.NAMES):
            category = found.get(f"{body}.{name}", "none")
            ax.add_patch(matplotlib.patches.Rectangle((column, row), 0.94, 0.88, color=colours[category]))
    ax.set(xlim=(0, len(inertia.NAMES)), ylim=(len(bodies), 0))
    ax.set_xticks(np.arange(len(inertia.NAMES)) + 0.5, inertia.NAMES)
    ax.set_yticks(np.arange(len(bodies)) + 0.45, bodies)
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    handles = [Patch(color=colours[key], label=label) for key, label in
               (("full", "alone"), ("combination", "in combination"), ("none", "no effect"))]
    figure.legend(handles=handles, loc="upper center", ncols=3, frameon=False)
    return figure


def _controller() -> Figure:
    """What generated C takes and gives, once and in each cycle."""
    figure = Figure(figsize=(8.6, 2.7))
    ax = figure.add_axes((0, 0, 1, 1))
    ax.set(xlim=(0, 100), ylim=(0, 31))
    ax.axis("off")
    boxes = {(4, 17): "estimate\nor machine file", (36, 17): "cat215b_params.h\ncat215b_values",
             (69, 17): "cat215b_prepare\nonce, at the start",
             (36, 2): "cat215b_motion_t\nq, qd, qdd", (69, 2): "cat215b_inverse_dynamics\nin each cycle"}
    for (x, y), text in boxes.items():
        ax.add_patch(matplotlib.patches.FancyBboxPatch((x, y), 23, 8, boxstyle="round,pad=0.6", fc="#eef3f7", ec=GREY))
        ax.annotate(text, (x + 11.5, y + 4), ha="center", va="center", color=BLUE if x == 69 else INK)
    for start, end, text in (((28, 21), (35, 21), "codegen"), ((60, 21), (68, 21), ""), ((60, 6), (68, 6), ""),
                             ((80.5, 16), (80.5, 11), "constants"), ((93, 6), (99, 6), "")):
        ax.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": ORANGE, "lw": 1.6})
        ax.annotate(text, ((start[0] + end[0]) / 2 + (5 if start[0] == end[0] else 0), (start[1] + end[1]) / 2 + 1.4),
                    ha="center", va="center", fontsize=8, color=ORANGE)
    ax.annotate("forces", (97, 8.5), ha="center", fontsize=8, color=ORANGE)
    return figure


def _interval() -> Figure:
    """What a prior, data and a bound make of one number."""
    mass = np.linspace(-60, 260, 801)
    curves = {"prior, from the machine file": (_bell(mass, 60, 60), GREY), "data": (_bell(mass, 20, 45), ORANGE)}
    posterior = np.where(mass >= 0, curves["prior, from the machine file"][0] * curves["data"][0], 0.0)
    share = np.cumsum(posterior) / posterior.sum()
    low, high = np.interp([0.025, 0.975], share, mass)
    figure = Figure(figsize=(8.6, 2.9))
    ax = figure.subplots()
    for label, (values, colour) in curves.items():
        ax.plot(mass, values, color=colour, lw=2, label=label)
    posterior /= posterior.max()
    ax.plot(mass, posterior, color=BLUE, lw=2.4, label="both, and a mass is not negative")
    inside = (mass >= low) & (mass <= high)
    ax.fill_between(mass[inside], posterior[inside], color=BLUE, alpha=0.2, lw=0, label="95 % interval")
    ax.set(xlabel="mass [kg]", yticks=[], xlim=(mass[0], mass[-1]), ylim=(0, 1.08))
    ax.legend(frameon=False)
    return figure


def _bell(x: np.ndarray, centre: float, sigma: float) -> np.ndarray:
    return np.exp(-0.5 * ((x - centre) / sigma) ** 2)
