"""The operator's sheet of a designed motion: the machine in space, steps in order, and when to stop."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hydroopt.report.excitation import reserves_text
from hydroopt.report.numbers import plain
from hydroopt.report.page import document
from hydroopt.report.panels import SMALL, Panel, Trace, charts_of, columns_of, positions
from hydroopt.report.samples import Recording, joined
from hydroopt.report.scene import SceneView

if TYPE_CHECKING:
    from hydroopt.excitation.motion.excitation import Excitation
    from hydroopt.simulation.simulate import Trajectory
    from hydroopt.spatial.inertia import Array


def render(excitation: Excitation) -> str:
    """The sheet as one HTML page that needs nothing else."""
    problem, machine, path = excitation.problem, excitation.problem.machine, excitation.trajectory
    joints = machine.joints
    paths = {"approach": excitation.approach.trajectory} if excitation.approach else {}
    recordings = []
    for name, each in (paths | {"motion": path}).items():
        panels = _panels(excitation, each)
        recordings.append(Recording(name, name, each.t, np.zeros(len(each.t), dtype=np.int64), {
            **positions(joints, each.q), **columns_of(panels, SMALL)}))
    view = SceneView(problem.information.model.scene_graph, tuple(f"{joint}.q" for joint in joints),
                     path=excitation.tip[::max(1, len(excitation.tip) // 2000)])
    names = [", ".join((joint, *machine.moved_along(joint))) for joint in joints]
    return document(
        "operator_sheet.html", samples=joined(recordings), charts={"joints": charts_of(panels, SMALL)}, scene=view,
        machine=machine, excitation=excitation, watch=excitation.watch, steps=_steps(excitation),
        joints=[f"{name} [{SMALL[unit][0]}]" for name, unit in zip(names, _units(excitation), strict=True)],
        duration=plain(problem.basis.duration), tips=machine.footprint is not None,
        slope=plain(float(np.degrees(np.hypot(*machine.orientation[:2]))), 2),
        kept=reserves_text(problem.limits.reserves))


def _units(excitation: Excitation) -> list[str]:
    machine = excitation.problem.machine
    return [machine.channel_units[f"{joint}.q"] for joint in machine.joints]


def _panels(excitation: Excitation, path: Trajectory) -> list[Panel]:
    return [Panel(f"{joint} position", unit, [Trace("", path.q[:, k])]) for k, (joint, unit) in enumerate(
        zip(excitation.problem.machine.joints, _units(excitation), strict=True))]


def _steps(excitation: Excitation) -> list[tuple[str, list[str]]]:
    """What to do, and the posture that it begins or ends in."""
    problem, path = excitation.problem, excitation.trajectory

    def posture(q: Array) -> list[str]:
        return [plain(round(SMALL[unit][1] * value, 1)) for unit, value in zip(_units(excitation), q, strict=True)]

    found = excitation.approach
    if found is None:
        steps = [("Drive by hand, slowly and clear of everything, to where the motion starts; rest there.",
                  posture(path.q[0]))]
    else:
        steps = [("The machine stands here. Check it.", posture(found.postures[0]))]
        steps += [(f"Drive approach.csv: at {plain(float(t), 3)} s it rests here. "
                   "Stop where a joint leaves the range between this row and the one before.", posture(q))
                  for q, t in zip(found.postures[1:], found.arrivals[1:], strict=True)]
    hanging = " and ".join(problem.machine.joints[k] for k in problem.limits.hanging.joints)
    start = "Start the log, wait two seconds." if not hanging else (
        f"Wait until {hanging} hang still, since the motion is safe from there only. Start the log, wait two seconds.")
    return [*steps, (start, posture(path.q[0])),
            (f"Drive trajectory.csv: {plain(problem.basis.duration)} s. It ends here at rest.", posture(path.q[-1])),
            ("Wait two seconds, stop the log. Lock the controls before anyone enters the circle.", posture(path.q[-1]))]
