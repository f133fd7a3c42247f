"""The report of a designed motion: its figures and one self-contained HTML page; draws, computes nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hydroopt.report.numbers import NONE, percent, plain, quantity, unit_text
from hydroopt.report.page import document
from hydroopt.report.panels import PRINTED, SMALL, Panel, Trace, charts_of, columns_of, positions, shown, with_unit
from hydroopt.report.samples import Recording, joined
from hydroopt.report.scene import SceneView

if TYPE_CHECKING:
    from hydroopt.excitation.motion.excitation import Excitation
    from hydroopt.excitation.motion.expected_accuracy import ExpectedAccuracy
    from hydroopt.limits.limits import UseOfLimit
    from hydroopt.limits.reserves import Reserves
    from hydroopt.simulation.simulate import Trajectory
    from hydroopt.spatial.inertia import Array

IN_WORDS = {"D": "volume of the confidence ellipsoid (D)", "A": "mean variance (A)",
            "E": "greatest variance of any combination (E)", "condition": "condition number of the regressor"}
PLACES = ("workspace", "above ground", "distance of")
"""Limits that the machine in space shows."""
POSITION, RATES = ("position",), ("speed", "acceleration")
JOINT = (*POSITION, *RATES)
MOST = 2000
"""Points of the tip's path."""


def render(excitation: Excitation) -> str:
    """The report as one HTML page that needs nothing else."""
    problem, accuracy = excitation.problem, excitation.accuracy
    machine, basis = problem.machine, problem.basis
    path = excitation.trajectory
    every = {"positions": _motion(excitation, POSITION), "motion": _motion(excitation, RATES),
             "efforts": _efforts(excitation), "tip": _tip(excitation)}
    panels = [panel for some in every.values() for panel in some]
    samples = joined([Recording("motion", "designed", path.t, np.zeros(len(path.t), dtype=np.int64), {
        **positions(machine.joints, path.q), **columns_of(panels)})])
    view = SceneView(problem.information.model.scene_graph, tuple(f"{joint}.q" for joint in machine.joints),
                     path=excitation.tip[::max(1, len(excitation.tip) // MOST)])
    still = ", ".join(f"{joint} at {with_unit(position, machine.channel_units[f'{joint}.q'], PRINTED, 4)}"
                      for joint, position in problem.resting.items())
    return document(
        "excitation.html", samples=samples, charts={name: charts_of(some) for name, some in every.items()}, scene=view,
        answer=excitation, machine=machine, excitation=excitation,
        series=basis.text, still=still, pace=plain(100 * excitation.pace, 4),
        criterion=IN_WORDS[problem.information.criterion], focus=bool(problem.parameters.focus),
        value=plain(excitation.value), random=_beside_random(excitation),
        count=excitation.random_motions, gain=plain(excitation.gain, 3),
        duration=plain(basis.duration), fastest=plain(basis.fastest, 3), rate=plain(problem.rate),
        reserves=reserves_text(problem.limits.reserves), certainty=plain(100 * problem.limits.reserves.certainty, 4),
        back=plain(1e-5 * problem.limits.back_pressure), known=bool(np.any(problem.parameters.prior)),
        limits=[_limit(use) for use in excitation.limits], base=_base(excitation),
        groups=_groups(excitation), sigma=_sigma(excitation, accuracy))


def reserves_text(reserves: Reserves) -> str:
    """Reserves in words."""
    return (f"{plain(100 * reserves.flow, 3)} % of flow, {plain(100 * reserves.pressure, 3)} % of pressure and torque, "
            f"{plain(100 * reserves.tipping, 3)} % of what holds it against tipping, {plain(reserves.clearance, 3)} m "
            f"to ground and obstacles, {plain(reserves.between, 3)} m between its own parts, and three times a "
            f"tracking error of {plain(100 * reserves.tracking, 3)} % of the joints' ranges")


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


def _limit(use: UseOfLimit) -> dict[str, str]:
    name, factor = shown(use.unit, PRINTED)
    largest = max(abs(x) for x in (use.lower, use.lowest, use.highest, use.upper) if np.isfinite(x))
    lower, lowest, highest, upper, room = (plain(0.0 if abs(x) < 1e-6 * largest else factor * x) for x in (
        use.lower, use.lowest, use.highest, use.upper, use.room))
    lowest = lowest if np.isfinite(use.lower) else NONE
    stop = ", ".join(f"{word} {plain(factor * value)}" for word, value in zip(("below", "above"), use.stop, strict=True)
                     if np.isfinite(value)) or NONE
    return {"name": use.name, "unit": name, "lower": lower, "lowest": lowest, "highest": highest, "upper": upper,
            "room": room, "stop": stop, "part": percent(use.part)}


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


def _motion(excitation: Excitation, quantities: Sequence[str]) -> list[Panel]:
    """Some of position, speed and acceleration of every joint."""
    machine, path = excitation.problem.machine, excitation.trajectory
    uses = {use.name: use for use in excitation.limits}
    panels = []
    for k, joint in enumerate(machine.joints):
        unit = machine.channel_units[f"{joint}.q"]
        for what, values, per in zip(JOINT, (path.q, path.qd, path.qdd), ("", "/s", "/s^2"), strict=True):
            if what in quantities:
                panels.append(Panel(f"{joint} {what}", unit + per, [
                    Trace("", values[:, k], limits=_bounds(uses.get(f"{joint} {what}")))]))
    return panels


def _bounds(use: UseOfLimit | None) -> tuple[float, ...]:
    return () if use is None else (use.lower, use.upper)


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
        panel = panels.setdefault(together, Panel(together, use.unit))
        panel.traces.append(Trace(label, excitation.courses[use.name].values, limits=_bounds(use)))
    return list(panels.values())


def _tip(excitation: Excitation) -> list[Panel]:
    """Reach and height of the last link's far end, with the ground and the heights of the workspace."""
    machine, tip = excitation.problem.machine, excitation.tip
    heights = [*(() if machine.ground is None else (machine.ground,)),
               *(() if machine.workspace is None else (machine.workspace.lower[2], machine.workspace.upper[2]))]
    return [Panel("tip: distance from the base's vertical axis", "m", [Trace("", np.hypot(tip[:, 0], tip[:, 1]))]),
            Panel("tip: height, with ground and workspace", "m", [Trace("", tip[:, 2], limits=tuple(heights))])]


def render_sheet(excitation: Excitation) -> str:
    """The sheet as one HTML page that needs nothing else."""
    problem, machine, path = excitation.problem, excitation.problem.machine, excitation.trajectory
    joints = machine.joints
    paths = {"approach": excitation.approach.trajectory} if excitation.approach else {}
    recordings = []
    for name, each in (paths | {"motion": path}).items():
        panels = _positions(excitation, each)
        recordings.append(Recording(name, name, each.t, np.zeros(len(each.t), dtype=np.int64), {
            **positions(joints, each.q), **columns_of(panels, SMALL)}))
    view = SceneView(problem.information.model.scene_graph, tuple(f"{joint}.q" for joint in joints),
                     path=excitation.tip[::max(1, len(excitation.tip) // 2000)])
    names = [", ".join((joint, *machine.moved_along(joint))) for joint in joints]
    return document(
        "operator_sheet.html", samples=joined(recordings), charts={"joints": charts_of(panels, SMALL)}, scene=view,
        machine=machine, excitation=excitation, watch=excitation.watch, steps=_steps(excitation),
        joints=[f"{name} [{SMALL[unit][0]}]" for name, unit in zip(names, _joint_units(excitation), strict=True)],
        duration=plain(problem.basis.duration), tips=machine.footprint is not None,
        slope=plain(float(np.degrees(np.hypot(*machine.orientation[:2]))), 2),
        lowest=None if machine.ground is None else plain(excitation.watch.planned.lowest, 2),
        pace=plain(100 * excitation.pace, 4),
        kept=reserves_text(problem.limits.reserves))


def _joint_units(excitation: Excitation) -> list[str]:
    machine = excitation.problem.machine
    return [machine.channel_units[f"{joint}.q"] for joint in machine.joints]


def _positions(excitation: Excitation, path: Trajectory) -> list[Panel]:
    return [Panel(f"{joint} position", unit, [Trace("", path.q[:, k])]) for k, (joint, unit) in enumerate(
        zip(excitation.problem.machine.joints, _joint_units(excitation), strict=True))]


def _steps(excitation: Excitation) -> list[tuple[str, list[str]]]:
    """What to do, and the posture that it begins or ends in."""
    problem, path = excitation.problem, excitation.trajectory

    def posture(q: Array) -> list[str]:
        return [plain(round(SMALL[unit][1] * value, 1))
                for unit, value in zip(_joint_units(excitation), q, strict=True)]

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
