"""The operator's sheet of a designed motion: the machine in space, steps in order, and when to stop."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hydroopt.report.excitation import reserves_text
from hydroopt.report.numbers import plain, unit_text
from hydroopt.report.page import document
from hydroopt.report.panels import PRINTED, SMALL, Panel, Trace, charts_of, columns_of, positions
from hydroopt.report.samples import Recording, joined
from hydroopt.report.scene import SceneView

if TYPE_CHECKING:
    from hydroopt.excitation.motion.excitation import Excitation
    from hydroopt.limits.use import UseOfLimit
    from hydroopt.simulation.simulate import Trajectory
    from hydroopt.spatial.inertia import Array

STOPS = ("above ground", "distance of", "tipping", "pressure", "p_", "torque", "position")
"""Words of limits that an operator can watch."""

def render(excitation: Excitation) -> str:
    """The sheet as one HTML page that needs nothing else."""
    problem, machine, path = excitation.problem, excitation.problem.machine, excitation.trajectory
    joints, reserves = machine.joints, problem.limits.reserves
    paths = {"approach": excitation.approach.trajectory} if excitation.approach else {}
    recordings = []
    for name, each in (paths | {"motion": path}).items():
        panels = _panels(excitation, each)
        recordings.append(Recording(name, name, each.t, np.zeros(len(each.t), dtype=np.int64), {
            **positions(joints, each.q), **columns_of(panels)}))
    view = SceneView(problem.information.model.scene_graph, tuple(f"{joint}.q" for joint in joints),
                     path=excitation.tip[::max(1, len(excitation.tip) // 2000)])
    swept = excitation.swept
    return document(
        "operator_sheet.html", samples=joined(recordings), charts={"joints": charts_of(panels)}, scene=view,
        machine=machine, excitation=excitation, joints=[f"{joint} [{_unit(excitation, joint)[0]}]" for joint in joints],
        steps=_steps(excitation), stops=[_stop(use) for use in excitation.limits if _watched(use)],
        radius=plain(swept.radius + reserves.clearance, 3), highest=plain(swept.highest, 3),
        lowest=plain(swept.lowest, 3), ground=None if machine.ground is None else plain(machine.ground, 3),
        duration=plain(problem.basis.duration), clearance=plain(reserves.clearance, 3),
        certainty=plain(100 * reserves.certainty, 4), tips=machine.footprint is not None,
        slope=plain(float(np.degrees(np.hypot(*machine.orientation[:2]))), 2),
        kept=reserves_text(reserves))


def _unit(excitation: Excitation, joint: str) -> tuple[str, float]:
    unit = excitation.problem.machine.channel_units[f"{joint}.q"]
    return SMALL.get(unit, (unit_text(unit), 1.0))


def _panels(excitation: Excitation, path: Trajectory) -> list[Panel]:
    machine = excitation.problem.machine
    return [Panel(f"{joint} position", machine.channel_units[f"{joint}.q"], [Trace("", path.q[:, k])])
            for k, joint in enumerate(machine.joints)]


def _steps(excitation: Excitation) -> list[tuple[str, list[str]]]:
    """What to do, and the posture that it begins or ends in."""
    problem, path = excitation.problem, excitation.trajectory

    def posture(q: Array) -> list[str]:
        return [plain(round(_unit(excitation, joint)[1] * value, 1))
                for joint, value in zip(problem.machine.joints, q, strict=True)]

    found = excitation.approach
    if found is None:
        steps = [("Drive by hand, slowly and clear of everything, to where the motion starts; rest there.",
                  posture(path.q[0]))]
    else:
        steps = [("The machine stands here. Check it.", posture(found.postures[0]))]
        steps += [(f"Drive approach.csv: at {plain(float(t), 3)} s it rests here.", posture(q))
                  for q, t in zip(found.postures[1:], found.arrivals[1:], strict=True)]
    hanging = " and ".join(problem.machine.joints[k] for k in problem.limits.hanging.joints)
    start = "Start the log, wait two seconds." if not hanging else (
        f"Wait until {hanging} hang still, since the motion is safe from there only. Start the log, wait two seconds.")
    return [*steps, (start, posture(path.q[0])),
            (f"Drive trajectory.csv: {plain(problem.basis.duration)} s. It ends here at rest.", posture(path.q[-1])),
            ("Wait two seconds, stop the log.", posture(path.q[-1]))]


def _watched(use: UseOfLimit) -> bool:
    return any(word in use.name for word in STOPS)


def _stop(use: UseOfLimit) -> tuple[str, str, str, str]:
    """What to watch, its unit, what the motion reaches, and where to stop."""
    unit, factor = PRINTED.get(use.unit, (unit_text(use.unit), 1.0))
    low, high = np.isfinite(use.lower), np.isfinite(use.upper)
    reached = [plain(factor * value, 3) for value, bounded in ((use.lowest, low), (use.highest, high)) if bounded]
    stop = [f"{word} {plain(factor * bound, 3)}" for word, bound, bounded in (
        ("below", use.lower, low), ("above", use.upper, high)) if bounded]
    return use.name, unit, " to ".join(reached), ", ".join(stop)
