"""The figure of both sides of a closed chain; draws, computes nothing."""

from __future__ import annotations

import hydroopt.report.with_matplotlib  # noqa: F401

# isort: split
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from hydroopt.report.figures import BLUE, GREY, INK, ORANGE, STYLE, WIDTH

if TYPE_CHECKING:
    from hydroopt.estimation.kinematic.chain_sides import ChainSides

LOOKS = {("nominal", "machine"): (GREY, "o"), ("nominal", "calibrator"): (GREY, "x"),
         ("calibrated", "machine"): (BLUE, "o"), ("calibrated", "calibrator"): (ORANGE, "x")}
"""Colour and marker by geometry and side."""


def distances(sides: tuple[ChainSides, ...]) -> Figure | None:
    """Distances from links to the fixture less those taped, or of the machine's side less the calibrator's (Figure 19).
    """
    keys = list(dict.fromkeys((each.role, each.link) for each in sides))
    if not keys:
        return None
    each = 2.3
    height = 0.8 + each * len(keys)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height))
        for row, key in enumerate(keys):
            ax = figure.add_axes((0.75 / WIDTH, (0.45 + (len(keys) - 1 - row) * each) / height, 1 - 0.9 / WIDTH,
                                  (each - 0.6) / height))
            own = [one for one in sides if (one.role, one.link) == key]
            taped = any(np.isfinite(one.tape).any() for one in own)
            for one in own:
                for side in ("machine", "calibrator") if taped else ("machine",):
                    apart = 1e3 * (getattr(one, side) - (one.tape if taped else one.calibrator))
                    colour, marker = LOOKS[one.geometry, side]
                    there = np.isfinite(apart)
                    ax.plot(1 + np.flatnonzero(there), apart[there], ls="none", ms=3.2, color=colour, marker=marker,
                            label=f"{one.geometry}, {side}'s side")
            ax.axhline(0, color=INK, lw=0.6)
            ax.set(title=f"{key[1]} to the fixture, {key[0]} poses",
                   ylabel="less tape [mm]" if taped else "less calibrator's [mm]")
            ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        figure.axes[-1].set_xlabel("pose, in the order of the files")
        drawn = {text: line for ax in figure.axes for line, text in zip(*ax.get_legend_handles_labels(), strict=True)}
        figure.legend(drawn.values(), drawn.keys(), loc="upper left", ncols=4, bbox_to_anchor=(0.05, 1.0),
                      borderaxespad=0.2)
    return figure
