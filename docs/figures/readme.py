"""Draw docs/figures/readme.svg, the picture of the README: ``python docs/figures/readme.py``."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import hydroopt as ho
from hydroopt.model.scene import scenes, vertical_plane
from hydroopt.report import side_view

GREY, ORANGE, BLUE, INK = "#8a96a3", "#d55e00", "#0072b2", "#1f2933"
STYLE = {"font.size": 9.5, "axes.spines.top": False, "axes.spines.right": False, "axes.edgecolor": INK,
         "svg.hashsalt": "hydroopt", "path.simplify_threshold": 0.4, "axes.labelcolor": INK, "text.color": INK}
ACTUATOR, SECONDS = "boom_cylinder", 16.0


def drawing() -> Figure:
    """The machine beside measured and predicted forces of a log that the estimate has not seen."""
    machine = ho.load_machine("excavator_bucket")
    model = ho.Model(machine)
    truth = ho.random_truth(model, seed=4)
    train, unseen = (ho.simulate(model, ho.random_trajectory(model, duration=40, rate=50, seed=k), truth, seed=k)
                     for k in (1, 2))
    estimate = ho.solve(ho.identification_problem(machine, [train], [unseen]))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.4, 3.3), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.25))
        _machine(left, model)
        _forces(right, estimate)
    return figure


def _machine(ax: Axes, model: ho.Model) -> None:
    posture = np.radians([0.0, 38.0, -72.0, -48.0])
    ax.set(aspect="equal")
    ax.axis("off")
    (scene,) = scenes(model, posture[None], vertical_plane(model, posture))
    side_view._draw(ax, model.machine, scene, faint=False)


def _forces(ax: Axes, estimate: ho.Estimate) -> None:
    k = [balance.name for balance in estimate.problem.model.machine.balances].index(ACTUATOR)
    data = estimate.problem.validation[0].plotted
    rows = data.motion.t <= data.motion.t[0] + SECONDS
    t = data.motion.t[rows]
    nominal = estimate.predict(data, estimate.problem.parameters.nominal)
    ax.plot(t, data.force[rows, k] / 1e3, color=GREY, lw=2.4, label="measured, unseen")
    ax.plot(t, nominal[rows, k] / 1e3, color=ORANGE, lw=1.2, ls=(0, (4, 2)), label="machine file")
    ax.plot(t, estimate.predictions["validation"][0][rows, k] / 1e3, color=BLUE, lw=1.2, label="calibrated")
    ax.set(xlabel="time [s]", ylabel="force of the boom cylinder [kN]")
    ax.margins(x=0)
    ax.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))


if __name__ == "__main__":
    place = Path(__file__).with_suffix(".svg")
    drawing().savefig(place, metadata={"Date": None, "Creator": None}, facecolor="white")
