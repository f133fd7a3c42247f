"""Loops of controllers as a figure: Bode, Nyquist, step responses, poles and zeros."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, MultipleLocator

from hydroopt.plots.figures import BLUE, GREEN, GREY, ORANGE, STYLE, WIDTH

if TYPE_CHECKING:
    from hydroopt.control.comparison import Comparison
    from hydroopt.control.loops import Loops

SECONDS = 5.0
"""Length of a step response."""
COLUMNS = ("gain [dB]", "phase [deg]", "Nyquist", "step of the reference", "poles and zeros")


def loops(comparison: Comparison) -> Figure:
    """A row for each actuator's loop, of the cascade and of LQG, where each comes nearest to instability.

    Poles and zeros are those of all loops closed, in the z plane; they and step responses stand in the rows of as many
    controllers and joints.
    """
    shown = comparison.kinds_of_loops
    names = [each.actuator.name for each in comparison.setting.plant.actuators]
    joints = shown[0].loops.closed.output_labels
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 2.1 * max(len(names), len(shown))), layout="constrained")
        axes = figure.subplots(max(len(names), len(shown)), len(COLUMNS), squeeze=False)
        for k, row in enumerate(axes):
            for ax, title in zip(row, COLUMNS, strict=True):
                ax.set_title(title if k == 0 else "")
            for outcome, colour in zip(shown, (BLUE, ORANGE, GREEN), strict=False):
                label = "cascade" if outcome.in_cascade else outcome.name
                if k < len(names):
                    _cut(row[:3], outcome.loops, k, colour, label)
                if k < len(joints):
                    t, y = outcome.loops.steps(SECONDS)
                    row[3].plot(t, y[:, k], color=colour)
            if k < len(names):
                row[0].set_ylabel(names[k])
                row[2].add_patch(matplotlib.patches.Circle((-1, 0), 1 / comparison.setting.sensitivity, fill=False,
                                                           color=GREY, ls="--"))
            if k < len(joints):
                row[3].set_ylabel(joints[k])
            if k < len(shown):
                _poles(row[4], shown[k].loops)
            for ax, used in zip(row, [k < len(names)] * 3 + [k < len(joints), k < len(shown)], strict=True):
                ax.set_visible(used)
        axes[0, 0].legend(loc="lower left")
        axes[-1, 0].set_xlabel("frequency [Hz]")
    return figure


def _cut(row: tuple[Axes, ...], at: Loops, k: int, colour: str, label: str) -> None:
    gain, phase, nyquist = row
    hertz, L = at.omega / (2 * np.pi), at.cut[k]
    gain.semilogx(hertz, 20 * np.log10(np.maximum(np.abs(L), 1e-300)), color=colour, label=f"{label}, {at.point}")
    phase.semilogx(hertz, np.degrees(np.unwrap(np.angle(L))), color=colour)
    nyquist.plot(L.real, L.imag, color=colour)
    gain.axhline(0, color=GREY, ls="--")
    gain.yaxis.set_major_locator(MaxNLocator(5, steps=[2, 4, 10]))
    phase.yaxis.set_major_locator(MultipleLocator(180))
    phase.axhline(-180, color=GREY, ls="--")
    nyquist.set(xlim=(-2, 1), ylim=(-1.5, 1.5), aspect="equal")


def _poles(ax: Axes, at: Loops) -> None:
    ax.add_patch(matplotlib.patches.Circle((0, 0), 1, fill=False, color=GREY, ls="--"))
    ax.plot(at.poles.real, at.poles.imag, "x", color=BLUE, ms=4)
    ax.plot(at.zeros.real, at.zeros.imag, "o", color=ORANGE, ms=4, mfc="none")
    ax.set(xlim=(-1.2, 1.2), ylim=(-1.2, 1.2), aspect="equal", ylabel=at.point)
