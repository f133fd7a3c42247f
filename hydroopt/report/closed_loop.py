"""The report of closed loops: how well each controller follows, with what pressures and margins; computes nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from hydroopt.report import hydraulics
from hydroopt.report.figures import BLUE, GREEN, GREY, INK, ORANGE, STYLE, WIDTH, svg, thin
from hydroopt.report.numbers import NONE, plain
from hydroopt.report.page import document

if TYPE_CHECKING:
    from hydroopt.control.comparison import Comparison
    from hydroopt.control.outcome import Outcome

COLOURS = (GREY, ORANGE, BLUE, GREEN, INK, "#cc79a7")
UNITS = {"rad": ("deg", 180 / np.pi), "m": ("mm", 1e3)}
"""What errors are shown in."""


def render(comparison: Comparison) -> str:
    """The report as one HTML page that needs nothing else."""
    setting = comparison.setting
    machine = setting.plant.machine
    drawn = {"errors": _errors(comparison), "pressures": _pressures(comparison), "bode": _bode(comparison)}
    return document(
        "closed_loop.html", machine=machine, diagnostics=comparison.diagnostics, origin=comparison.source,
        truth=setting.true.text, rate=plain(setting.rate),
        duration=plain(float(setting.t[-1] - setting.t[0])), winner=comparison.winner.name,
        sensitivity=plain(setting.sensitivity), best=comparison.feedforward,
        units=[UNITS[machine.channel_units[f"{joint}.q"]][0] for joint in machine.joints],
        rows=[_row(comparison, outcome) for outcome in comparison.outcomes],
        gains=[(name, *(plain(value, 3) for value in values))
               for name, values in comparison.gains_of_actuators.items()],
        passive=[joint for joint in machine.joints if machine.link(joint).joint.passive],
        loops=[row for outcome in _cut(comparison) for row in _loops(comparison, outcome)],
        hydraulics=hydraulics.section(setting.plant, comparison.sweeps) if comparison.sweeps else None,
        figures={name: Markup(svg(figure, name)) for name, figure in drawn.items()})


def _row(comparison: Comparison, outcome: Outcome) -> dict[str, Any]:
    machine, run = comparison.setting.plant.machine, outcome.run
    factors = [UNITS[machine.channel_units[f"{joint}.q"]][1] for joint in machine.joints]
    return {"name": outcome.name, "from": outcome.variant.text, "best": outcome is comparison.winner,
            "stopped": run.stopped, "tip": plain(1e3 * outcome.tip_rms, 3),
            "tip_max": plain(1e3 * float(np.max(outcome.tip)), 3),
            "joints": [plain(factor * np.sqrt(np.mean(error**2)), 3) for factor, error in
                       zip(factors, outcome.error.T, strict=True)],
            "pressure": plain(float(np.max(run.pressure)) / 1e5, 3),
            "supply": plain(float(np.min(run.p_supply)) / 1e5, 3),
            "energy": plain(run.energy / 1e3, 4)}


def _cut(comparison: Comparison) -> list[Outcome]:
    """One outcome for each kind of loops: those of the cascade are the same whatever it is fed forward."""
    cascade = comparison.feedforward or comparison.outcomes[0]
    return [outcome for outcome in comparison.outcomes if outcome is cascade or not outcome.in_cascade]


def _loops(comparison: Comparison, outcome: Outcome) -> list[tuple[str, ...]]:
    """Controller, loop, and the least margins of gain and phase on the way and anywhere, each with its place."""
    rows = []
    on_the_way = [at.name for at in comparison.points if at.name.startswith("motion")]
    for each in comparison.setting.plant.actuators:
        name = each.actuator.name
        cells = []
        for key, points in (("gain", on_the_way), ("phase", on_the_way), ("gain", ()), ("phase", ())):
            found = outcome.worst(name, key, points)
            value = 20 * np.log10(found.gain) if key == "gain" else np.degrees(found.phase)
            cells.append(f"{plain(float(value), 3)} ({found.point})" if np.isfinite(value) else NONE)
        rows.append(("cascade" if outcome.in_cascade else outcome.name, name, *cells))
    return rows


def _errors(comparison: Comparison) -> Figure:
    """Of every joint and of the tip over time."""
    machine = comparison.setting.plant.machine
    count = len(machine.joints) + 1
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 0.5 + 1.5 * count), layout="constrained")
        axes = np.asarray(figure.subplots(count, 1, squeeze=False, sharex=True))[:, 0]
        for outcome, colour in zip(comparison.outcomes, COLOURS * len(comparison.outcomes), strict=False):
            for k, joint in enumerate(machine.joints):
                unit, factor = UNITS[machine.channel_units[f"{joint}.q"]]
                axes[k].plot(*thin(outcome.run.t, factor * outcome.error[:, k]), color=colour, label=outcome.name)
                axes[k].set_title(f"{joint}: error [{unit}]")
            axes[-1].plot(*thin(outcome.run.t, 1e3 * outcome.tip), color=colour)
        axes[-1].set(title="tip: distance from the motion [mm]", xlabel="time [s]")
        for ax, values in zip(axes, (*(_shown(comparison, k) for k in range(count - 1)), _shown(comparison, None)),
                              strict=True):
            ax.set_ylim(*values)
            ax.margins(x=0.005)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _shown(comparison: Comparison, k: int | None) -> tuple[float, float]:
    """Range of errors of all but the PI controller, whose lag would hide what the others do."""
    machine = comparison.setting.plant.machine
    own = [o for o in comparison.outcomes if o.uses_model] or list(comparison.outcomes)
    if k is None:
        return 0.0, 1.1e3 * max(float(np.max(o.tip)) for o in own)
    factor = UNITS[machine.channel_units[f"{machine.joints[k]}.q"]][1]
    most = 1.1 * factor * max(float(np.max(np.abs(o.error[:, k]))) for o in own)
    return -most, most


def _pressures(comparison: Comparison) -> Figure:
    """Chambers, commands and supply of the winner."""
    plant, run = comparison.setting.plant, comparison.winner.run
    count = len(plant.actuators)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 0.5 + 1.5 * count), layout="constrained")
        axes = np.asarray(figure.subplots(count, 2, squeeze=False, sharex=True))
        for k, each in enumerate(plant.actuators):
            left, right = axes[k]
            for side, (label, colour) in enumerate((("chamber a", BLUE), ("chamber b", ORANGE))):
                left.plot(*thin(run.t, run.pressure[:, k, side] / 1e5), color=colour, label=label)
            left.plot(*thin(run.t, run.p_supply / 1e5), color=GREY, label="supply")
            left.set_title(f"{each.actuator.name}: pressures [bar]")
            right.plot(*thin(run.t, run.u[:, k]), color=GREEN)
            unit = each.valve.command
            right.set_title(f"{each.actuator.name}: command" + ("" if unit == "1" else f" [{unit}]"))
        for ax in axes[-1]:
            ax.set_xlabel("time [s]")
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _bode(comparison: Comparison) -> Figure:
    """Every loop of the cascade, which all with it share, and of LQG where its Nyquist curve comes nearest to −1."""
    plant = comparison.setting.plant
    count = len(plant.actuators)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 4.6), layout="constrained")
        axes = np.asarray(figure.subplots(2, count, squeeze=False, sharex=True))
        for outcome, colour in zip(_cut(comparison), (BLUE, ORANGE, GREEN, INK), strict=False):
            where, omega, L = outcome.bode
            for k, each in enumerate(plant.actuators):
                axes[0, k].loglog(omega / (2 * np.pi), np.abs(L[k]), color=colour, label=f"{outcome.name}, {where}")
                axes[1, k].semilogx(omega / (2 * np.pi), np.degrees(np.unwrap(np.angle(L[k]))), color=colour)
                axes[0, k].set_title(f"{each.actuator.name}: gain of the loop")
                axes[1, k].set(title="phase [deg]", xlabel="frequency [Hz]")
                for axis in (axes[0, k].yaxis, axes[0, k].xaxis, axes[1, k].xaxis):  # powers would be TeX
                    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
                    axis.set_minor_formatter(NullFormatter())
        for k in range(count):
            axes[0, k].axhline(1.0, color=INK, lw=0.8, ls=(0, (4, 3)))
            axes[1, k].axhline(-180.0, color=INK, lw=0.8, ls=(0, (4, 3)))
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure
