"""The report of closed loops: how well each controller follows, with what pressures and margins; computes nothing."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from hydroopt.report.charts import LOOKS, Chart, Curves, Plane
from hydroopt.report.numbers import NONE, plain, unit_text
from hydroopt.report.page import document
from hydroopt.report.panels import SMALL, Panel, Trace, charts_of, columns_of, positions, with_unit
from hydroopt.report.samples import Recording, joined
from hydroopt.report.scene import SceneView

if TYPE_CHECKING:
    from hydroopt.control.comparison import Comparison, Outcome
    from hydroopt.spatial.inertia import Array

NEAR, ABOUT_CIRCLE = (-2.0, 1.0, -1.5, 1.5), (-1.2, 1.2, -1.2, 1.2)
"""Left, right, lower and upper end of Nyquist curves, and of poles and zeros."""
STEP = 5.0
"""Length of a step response [s]."""
MOST, LEAST = 3, 0.005
"""Numbers of valves and oil that are named of each loop, and the least disk margin that one of them takes."""


def render(comparison: Comparison) -> str:
    """The report as one HTML page that needs nothing else."""
    setting = comparison.setting
    machine = setting.plant.machine
    errors, drives = _errors(comparison), _drives(comparison)
    run, t = comparison.winner.run, setting.t
    samples = joined([Recording("closed loop", comparison.winner.name, t, np.zeros(len(t), dtype=np.int64), {
        **positions(machine.joints, np.column_stack([_full(comparison, column) for column in run.q.T])),
        **columns_of(errors, SMALL), **columns_of(drives)})])
    shown: dict[str, list[Chart]] = {"errors": [*charts_of(errors, SMALL)], "drives": [*charts_of(drives)],
                                     "bode": [*_bode(comparison)], "nyquist": [*_nyquist(comparison)],
                                     "poles": [*_poles(comparison)], "steps": [*_steps(comparison)]}
    return document(
        "closed_loop.html", samples=samples, charts=shown, answer=comparison,
        scene=SceneView(setting.plant.model.scene_graph, tuple(f"{joint}.q" for joint in machine.joints)),
        machine=machine, origin=comparison.source,
        truth=setting.true.text, rate=plain(setting.rate),
        complement=plain(setting.complementary_sensitivity),
        duration=plain(float(setting.t[-1] - setting.t[0])), winner=comparison.winner.name,
        sensitivity=plain(setting.sensitivity), best=comparison.feedforward,
        units=[SMALL[machine.channel_units[f"{joint}.q"]][0] for joint in machine.joints],
        rows=[_row(comparison, outcome) for outcome in comparison.outcomes],
        gains=[(name, unit_text(one.unit), plain(one.value, 3)) for name, one in comparison.parameters.items()
               if one.value is not None],
        lost=_lost(comparison),
        passive=[joint for joint in machine.joints if machine.link(joint).joint.passive],
        loops=[row for outcome in comparison.kinds_of_loops for row in _loops(comparison, outcome)])


def _row(comparison: Comparison, outcome: Outcome) -> dict[str, Any]:
    machine, run = comparison.setting.plant.machine, outcome.run
    factors = [SMALL[machine.channel_units[f"{joint}.q"]][1] for joint in machine.joints]
    return {"name": outcome.name, "from": outcome.variant.text, "best": outcome is comparison.winner,
            "stopped": run.stopped, "tip": plain(1e3 * outcome.tip_rms, 3),
            "tip_max": plain(1e3 * float(np.max(outcome.tip)), 3),
            "joints": [plain(factor * np.sqrt(np.mean(error**2)), 3) for factor, error in
                       zip(factors, outcome.error.T, strict=True)],
            "pressure": plain(float(np.max(run.pressure)) / 1e5, 3),
            "supply": plain(float(np.min(run.p_supply)) / 1e5, 3),
            "energy": plain(run.energy / 1e3, 4)}


def _loops(comparison: Comparison, outcome: Outcome) -> list[tuple[str, ...]]:
    """Controller, loop, and the least margins of gain and phase on the way and anywhere, each with its place."""
    rows = []
    on_the_way = [at.name for at in comparison.points if at.on_motion]
    for each in comparison.setting.plant.actuators:
        name = each.actuator.name
        cells = []
        for key, points in (("gain", on_the_way), ("phase", on_the_way), ("gain", ()), ("phase", ())):
            found = outcome.worst(name, key, points)
            value = 20 * np.log10(found.gain) if key == "gain" else np.degrees(found.phase)
            hertz = plain(float(getattr(found, f"{key}_at")) / (2 * np.pi), 2)
            cells.append(f"{plain(float(value), 3)} at {hertz} Hz ({found.point})" if np.isfinite(value) else NONE)
        for key in ("disk", "damping"):
            found = outcome.worst(name, key)
            cells.append(f"{plain(float(getattr(found, key)), 2)} ({found.point})")
        rows.append(("cascade" if outcome.in_cascade else outcome.name, name, *cells))
    return rows


def _errors(comparison: Comparison) -> list[Panel]:
    """Of every joint and of the tip; the PI controller, whose lag would hide what the others do, may leave the axis."""
    machine = comparison.setting.plant.machine
    own = [o for o in comparison.outcomes if o.uses_model] or list(comparison.outcomes)
    panels = []
    for k, joint in enumerate(machine.joints):
        most = 1.1 * max(float(np.max(np.abs(o.error[:, k]))) for o in own)
        panels.append(Panel(f"{joint}: error", machine.channel_units[f"{joint}.q"], [
            Trace(o.name, _full(comparison, o.error[:, k]), look) for o, look in _looks(comparison)], (-most, most)))
    most = 1.1 * max(float(np.max(o.tip)) for o in own)
    return [*panels, Panel("tip: distance from the motion", "m", [
        Trace(o.name, _full(comparison, o.tip), look) for o, look in _looks(comparison)], (0.0, most))]


def _looks(comparison: Comparison) -> Iterator[tuple[Outcome, str]]:
    """Outcomes with the looks of their lines."""
    return zip(comparison.outcomes, cycle(("measured", "other", "predicted", "third", "fourth", "fifth", "sixth")))


def _full(comparison: Comparison, values: Array) -> Array:
    """Values of a run over all samples of the motion; not a number after a run that ended early."""
    missing = len(comparison.setting.t) - len(values)
    return np.concatenate([values, np.full(max(0, missing), np.nan)])[:len(comparison.setting.t)]


def _drives(comparison: Comparison) -> list[Panel]:
    """Chambers, commands and supply of the winner."""
    plant, run = comparison.setting.plant, comparison.winner.run
    panels = []
    for k, each in enumerate(plant.actuators):
        name, command = each.actuator.name, each.valve.command
        panels += [Panel(f"{name}: pressures", "Pa", [
            Trace("chamber a", _full(comparison, run.pressure[:, k, 0])),
            Trace("chamber b", _full(comparison, run.pressure[:, k, 1])),
            Trace("supply", _full(comparison, run.p_supply), "measured")]),
            Panel(f"{name}: command", command, [Trace("", _full(comparison, run.u[:, k]), "third")])]
    return panels


def _lost(comparison: Comparison) -> list[tuple[str, ...]]:
    """Loop, number, its standard deviation, disk margin, and what the number may take from it: the most of each loop.
    """
    rows: list[tuple[str, ...]] = []
    for loop in dict.fromkeys(each.loop for each in comparison.lost_margins):
        own = sorted((each for each in comparison.lost_margins if each.loop == loop), key=lambda each: -each.lost)
        rows += [(loop, each.parameter, with_unit(each.std, each.unit, digits=2), plain(each.disk, 2),
                  plain(each.lost, 2))
                 for each in own[:MOST] if each.lost > LEAST]
    return rows


def _bode(comparison: Comparison) -> list[Curves]:
    """Every loop of the cascade, which all with it share, and of LQG where its Nyquist curve comes nearest to −1."""
    made, shown = [], _shown(comparison)
    omega, responses = comparison.loop_responses
    hertz = omega / (2 * np.pi)
    for k, each in enumerate(comparison.setting.plant.actuators):
        gains, phases = [], []
        for (outcome, look), L in zip(shown, (some[k] for some in responses), strict=True):
            gains.append((_label(outcome), look, 20 * np.log10(np.maximum(np.abs(L), 1e-300))))
            phases.append((_label(outcome), look, np.degrees(np.unwrap(np.angle(L)))))
        made += [Curves(f"{each.actuator.name}: gain of the loop [dB]", "frequency [Hz]", hertz, tuple(gains),
                        limits=(0.0,), logarithmic=(True, False), ticks=20.0),
                 Curves(f"{each.actuator.name}: phase [deg]", "frequency [Hz]", hertz, tuple(phases),
                        limits=(-180.0,), logarithmic=(True, False), ticks=90.0)]
    return made


def _nyquist(comparison: Comparison) -> list[Plane]:
    """Nyquist curves of the same loops, with the circles that both sensitivities keep them out of."""
    made, radius = [], 1 / comparison.setting.sensitivity
    square = comparison.setting.complementary_sensitivity**2
    circles = ((-1.0, 0.0, radius), (-square / (square - 1), 0.0, np.sqrt(square) / (square - 1)))
    for k, each in enumerate(comparison.setting.plant.actuators):
        curves = [(outcome, look, outcome.loops.cut[k]) for outcome, look in _shown(comparison)]
        nearest = "; ".join(f"{_label(outcome)}: nearest to −1 by {plain(float(np.min(np.abs(1 + L))), 3)}"
                         for outcome, _, L in curves)
        title = f"{each.actuator.name}: Nyquist curve"
        made.append(Plane(title, "real part", "imaginary part", NEAR, tuple(
            (_label(outcome), look, L.real, L.imag) for outcome, look, L in curves), circles=circles,
            alt=f"{title}, with a circle of radius {plain(radius, 3)} about −1. {nearest}."))
    return made


def _poles(comparison: Comparison) -> list[Plane]:
    """Poles and zeros of the closed loops of every kind of controller, in the z plane."""
    made = []
    for outcome in comparison.kinds_of_loops:
        loops = outcome.loops
        dots = tuple((label, look, values.real, values.imag) for label, look, values in
                     (("poles", "predicted", loops.poles), ("zeros", "other", loops.zeros)))
        title = f"{_label(outcome)}: poles and zeros of the closed loops"
        alt = (f"{title} in the z plane, with the unit circle: {len(loops.poles)} poles, the largest of size "
               f"{plain(float(np.max(np.abs(loops.poles))), 4)}, and {len(loops.zeros)} zeros.")
        made.append(Plane(title, "real part", "imaginary part", ABOUT_CIRCLE, dots=dots, circles=((0.0, 0.0, 1.0),),
                          alt=alt))
    return made


def _steps(comparison: Comparison) -> Iterator[Curves]:
    """Position of every joint after a step of its reference."""
    machine = comparison.setting.plant.machine
    shown = [(outcome, look, *outcome.loops.steps(STEP)) for outcome, look in _shown(comparison)]
    for k, place in enumerate(shown[0][0].loops.joints):
        yield Curves(f"{machine.joints[place]}: position after a step of its reference", "time [s]", shown[0][2], tuple(
            (_label(outcome), look, y[:, k]) for outcome, look, _, y in shown), limits=(1.0,))


def _shown(comparison: Comparison) -> list[tuple[Outcome, str]]:
    """One outcome for each kind of loops, with the look of its lines."""
    return list(zip(comparison.kinds_of_loops, LOOKS, strict=False))


def _label(outcome: Outcome) -> str:
    return f"{'cascade' if outcome.in_cascade else outcome.name}, {outcome.loops.point}"
