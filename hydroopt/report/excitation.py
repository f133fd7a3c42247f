"""The report of a designed motion: its figures and one self-contained HTML page; draws, computes nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle

from hydroopt.machine.machine import BASE
from hydroopt.report.figures import BLUE, GREEN, GREY, INK, LIGHT, ORANGE, STYLE, WIDTH, svg, thin
from hydroopt.report.numbers import NONE, percent, plain, quantity, unit_text
from hydroopt.report.page import document

if TYPE_CHECKING:
    from hydroopt.excitation.motion.excitation import Excitation, UseOfLimit
    from hydroopt.excitation.motion.expected_accuracy import ExpectedAccuracy
    from hydroopt.spatial.inertia import Array

PRINTED: dict[str, tuple[str, float]] = {
    "rad": ("deg", 180 / np.pi), "rad/s": ("deg/s", 180 / np.pi), "rad/s^2": ("deg/s²", 180 / np.pi),
    "m": ("m", 1.0), "Pa": ("bar", 1e-5), "m^3/s": ("L/min", 6e4), "N*m": ("kN·m", 1e-3), "N": ("kN", 1e-3)}
"""Units that a reader prefers, and what SI is multiplied by."""
IN_WORDS = {"D": "volume of the confidence ellipsoid (D)", "A": "sum of variances (A)",
            "E": "greatest variance of any combination (E)", "condition": "condition number of the regressor"}
PLACES = ("workspace", "above ground", "distance to")
"""Limits that the picture of the tip's path shows."""
JOINT = ("position", "speed", "acceleration")
COLOURS = (BLUE, ORANGE, GREEN, GREY)
COLUMNS = 3


class Panel(NamedTuple):
    """Lines of one unit that share a picture."""

    title: str
    unit: str
    lines: list[tuple[str, Array, UseOfLimit | None]]


def render(excitation: Excitation) -> str:
    """The report as one HTML page that needs nothing else."""
    problem, accuracy = excitation.problem, excitation.accuracy
    machine, basis = problem.machine, problem.basis
    figures = {"motion": _panels(excitation, _motion(excitation)), "efforts": _panels(excitation, _efforts(excitation)),
               "path": _path(excitation)}
    still = ", ".join(f"{joint} at {_shown(position, machine.channel_units[f'{joint}.q'])}"
                      for joint, position in problem.resting.items())
    return document(
        "excitation.html", machine=machine, excitation=excitation, diagnostics=excitation.diagnostics,
        series=basis.text, still=still,
        criterion=IN_WORDS[problem.information.criterion], focus=bool(problem.parameters.focus),
        value=plain(excitation.value), random=_beside_random(excitation),
        count=excitation.random_motions, gain=plain(excitation.gain, 3),
        duration=plain(basis.duration), fastest=plain(basis.fastest, 3), rate=plain(problem.rate),
        back=plain(1e-5 * problem.limits.back_pressure), known=bool(np.any(problem.parameters.prior)),
        limits=[_limit(use) for use in excitation.limits], base=_base(excitation),
        groups=_groups(excitation), sigma=_sigma(excitation, accuracy),
        figures={name: Markup(svg(figure, name)) for name, figure in figures.items() if figure is not None})


def _beside_random(excitation: Excitation) -> list[tuple[str, str, str]]:
    """What is compared with the best random motion: its name, by this motion, and by the random one."""
    other = excitation.best_random
    scalings = {"raw": "condition number, SI units", "unit_columns": "condition number, columns of unit length",
                "scaled": "condition number, as the design scales it"}
    count = len(excitation.names)
    return [("criterion", plain(excitation.value), plain(other.value)),
            ("base parameters excited", f"{excitation.excited} of {count}", f"{other.excited} of {count}"),
            *((text, _condition(excitation, name), _condition(other, name)) for name, text in scalings.items())]


def _condition(excitation: Excitation, scaling: str) -> str:
    return plain(excitation.condition_numbers.get(scaling, np.nan), 3)


def _shown(value: float, unit: str) -> str:
    name, factor = PRINTED.get(unit, (unit_text(unit), 1.0))
    return f"{plain(value * factor)} {name}" if np.isfinite(value) else NONE


def _limit(use: UseOfLimit) -> dict[str, str]:
    name, factor = PRINTED.get(use.unit, (unit_text(use.unit), 1.0))
    largest = max(abs(x) for x in (use.lower, use.lowest, use.highest, use.upper) if np.isfinite(x))
    lower, lowest, highest, upper, room = (plain(0.0 if abs(x) < 1e-6 * largest else factor * x) for x in (
        use.lower, use.lowest, use.highest, use.upper, use.room))
    return {"name": use.name, "unit": name, "lower": lower, "lowest": lowest, "highest": highest, "upper": upper,
            "room": room, "part": percent(use.part)}


def _base(excitation: Excitation) -> list[tuple[str, str, str, str, str]]:
    """Expression, unit, nominal value, standard deviation to expect, and bias."""
    rows, accuracy = [], excitation.accuracy
    for name, unit, value, std, bias in zip(excitation.names, excitation.units, excitation.base_nominal, accuracy.base,
                                            accuracy.bias, strict=True):
        shown = quantity(float(value), float(std))
        rows.append((name.replace("+ ", "+\u00a0").replace("− ", "−\u00a0"), unit_text(unit), shown.value, shown.std,
                     plain(float(bias), 2)))
    return rows


def _groups(excitation: Excitation) -> list[tuple[str, list[tuple[str, ...]]]]:
    """By owner: element, unit, nominal value, standard deviation before and after, and their ratio."""
    groups: dict[str, list[tuple[str, ...]]] = {}
    for name, each in excitation.parameters.items():
        owner, _, element = name.rpartition(".")
        nominal, before, after = (np.nan if value is None else value
                                  for value in (each.nominal, each.prior_std, each.std))
        groups.setdefault(owner, []).append((
            element, unit_text(each.unit), plain(nominal), plain(before, 3), plain(after, 3),
            percent(after / before) if before else NONE))
    return list(groups.items())


def _sigma(excitation: Excitation, accuracy: ExpectedAccuracy) -> list[tuple[str, str, str]]:
    model = excitation.problem.information.model
    return [(balance.name, plain(float(sigma), 3), unit_text(unit)) for balance, sigma, unit in
            zip(model.machine.balances, accuracy.sigma, model.force_units, strict=True)]


def _motion(excitation: Excitation) -> list[Panel]:
    """Position, speed and acceleration of every joint."""
    machine, path = excitation.problem.machine, excitation.trajectory
    uses = {use.name: use for use in excitation.limits}
    panels = []
    for k, joint in enumerate(machine.joints):
        unit = machine.channel_units[f"{joint}.q"]
        for what, values, per in zip(JOINT, (path.q, path.qd, path.qdd), ("", "/s", "/s^2"), strict=True):
            name = f"{joint} {what}"
            panels.append(Panel(name, unit + per, [("", values[:, k], uses.get(name))]))
    return panels


def _efforts(excitation: Excitation) -> list[Panel]:
    """Everything else that is limited, but for places."""
    machine = excitation.problem.machine
    own = {f"{joint} {what}" for joint in machine.joints for what in JOINT}
    chambers = {chamber for part in machine.hydraulic_actuators for chamber in part.chambers}
    panels: dict[str, Panel] = {}
    for use in excitation.limits:
        if use.name in own or any(place in use.name for place in PLACES):
            continue
        owner, _, what = use.name.rpartition(" ")
        chamber = f"{owner}.{what}" in chambers
        together, label = (f"{owner} pressures", what.removeprefix("p_")) if chamber else (use.name, "")
        if use.name.startswith("tipping"):
            together, label = "against tipping", f"edge {what}"
        panel = panels.setdefault(together, Panel(together, use.unit, []))
        panel.lines.append((label, excitation.histories[use.name], use))
    return list(panels.values())


def _panels(excitation: Excitation, panels: Sequence[Panel]) -> Figure | None:
    """Quantities over time, limits as broken lines."""
    if not panels:
        return None
    t = excitation.trajectory.t
    rows, each = -(-len(panels) // COLUMNS), 1.5
    height = rows * each + 0.55
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height))
        axes = np.asarray(figure.subplots(rows, COLUMNS, squeeze=False, sharex=True))
        figure.subplots_adjust(left=0.055, right=0.99, top=1 - 0.24 / height, bottom=0.42 / height,
                               hspace=0.52 / (each - 0.52), wspace=0.2)
        for ax, panel in zip(axes.ravel(), panels, strict=False):
            unit, factor = PRINTED.get(panel.unit, (unit_text(panel.unit), 1.0))
            for (label, values, use), colour in zip(panel.lines, COLOURS * len(panel.lines), strict=False):
                ax.plot(*thin(t, factor * values), color=colour, label=label, lw=0.9)
                for bound in (use.lower, use.upper) if use else ():
                    if np.isfinite(bound):
                        ax.axhline(factor * bound, color=INK, lw=0.8, ls=(0, (4, 3)))
            ax.set_title(f"{panel.title} [{unit}]", fontsize=8)
            ax.margins(x=0.005, y=0.12)
            if any(label for label, _, _ in panel.lines):
                ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=4, borderaxespad=0, handlelength=1.0,
                          columnspacing=0.8, handletextpad=0.3)
        for ax in axes.ravel()[len(panels):]:
            ax.set_visible(False)
        for column in range(COLUMNS):
            lowest = max((row for row in range(rows) if row * COLUMNS + column < len(panels)), default=0)
            axes[lowest, column].set_xlabel("time [s]", labelpad=1)
            axes[lowest, column].tick_params(labelbottom=True)
    return figure


def _path(excitation: Excitation) -> Figure:
    """The far end of the last link from the side and from above, with ground, workspace and obstacles."""
    machine, tip = excitation.problem.machine, excitation.tip
    reach = np.hypot(tip[:, 0], tip[:, 1])
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 4.4))
        side, above = figure.subplots(1, 2)
        figure.subplots_adjust(left=0.055, right=0.985, top=0.93, bottom=0.1, wspace=0.16)
        side.plot(*thin(reach, tip[:, 2], len(reach)), color=BLUE, lw=0.8)
        above.plot(tip[:, 0], tip[:, 1], color=BLUE, lw=0.8)
        for ax, first, second in ((side, reach, tip[:, 2]), (above, tip[:, 0], tip[:, 1])):
            ax.plot(first[0], second[0], ls="none", marker="o", ms=5, color=GREEN, zorder=3)
        handles = [Line2D([], [], color=BLUE, label="path of the tip"),
                   Line2D([], [], ls="none", marker="o", color=GREEN, label="start")]
        if machine.ground is not None:
            side.axhline(machine.ground, color=ORANGE, lw=1.2)
            handles.append(Line2D([], [], color=ORANGE, label="ground"))
        if machine.workspace is not None:
            (x, y, z), (X, Y, Z) = machine.workspace.lower, machine.workspace.upper
            above.add_patch(Rectangle((x, y), X - x, Y - y, fill=False, ec=INK, lw=0.9, ls=(0, (4, 3))))
            for height in (z, Z):
                side.axhline(height, color=INK, lw=0.9, ls=(0, (4, 3)))
            handles.append(Line2D([], [], color=INK, ls=(0, (4, 3)), label="workspace"))
        for obstacle in machine.obstacles:
            if obstacle.link == BASE:
                above.add_patch(Circle(obstacle.centre[:2], obstacle.radius, fc=LIGHT, ec=GREY))
            side.add_patch(Circle((float(np.hypot(*obstacle.centre[:2])), obstacle.centre[2]), obstacle.radius,
                                  fc=LIGHT, ec=GREY))
        if machine.footprint is not None:
            corners = np.array([*machine.footprint.corners, machine.footprint.corners[0]])
            above.plot(corners[:, 0], corners[:, 1], color=GREY, lw=1.2)
            handles.append(Line2D([], [], color=GREY, label="footprint"))
        side.set(title="from the side", xlabel="distance from the base's vertical axis [m]", ylabel="height z [m]")
        above.set(title="from above", xlabel="x [m]", ylabel="y [m]")
        for ax in (side, above):
            ax.set_aspect("equal", adjustable="datalim")
        side.legend(handles=handles, loc="upper right", ncols=len(handles), bbox_to_anchor=(2.17, 1.1),
                    borderaxespad=0.1)
    return figure
