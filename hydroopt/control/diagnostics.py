"""Diagnostics of a comparison of controllers: small margins, little damping, runs that ended early, saturated valves.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hydroopt.control.outcome import FEEDFORWARD, Outcome
from hydroopt.control.setting import Setting
from hydroopt.control.valve_sensitivity import LostMargin
from hydroopt.results.diagnostic import Diagnostic, Meaning
from hydroopt.results.machine_diagnostics import machine_diagnostics

SMALL_MARGINS, UNSTABLE = "small margins", "loop unstable in a posture"
"""Kinds of diagnostics by which a controller's use is decided."""
SMALL_DB, SMALL_DEG, SMALL_DISK = 6.0, 30.0, 0.5
"""Gain, phase and disk margins below which a loop is reported. A sensitivity of 2 leaves so much: gains are tuned to
more, on the machine as it is known, so that the true one may differ. Within a disk margin of 0.5 the gain may change by
a factor of 1.67, or the phase by 28 degrees, or both at once by less."""
LITTLE_DAMPING = 0.02
"""Damping ratio below which an oscillation of a closed loop is reported."""
SIGMAS = 2.0
"""Standard deviations of valves and oil within which margins should last."""
SATURATED = 0.01
"""Part of the time for which a valve may be fully open."""


def control_diagnostics(setting: Setting, outcomes: Sequence[Outcome],
                        feedforward: Outcome | None) -> tuple[Diagnostic, ...]:
    """Impossible nominal bodies, small margins, runs that ended early, valves that saturate; `feedforward` is the best.
    """
    return (*machine_diagnostics(setting.plant.model), *_margins(setting, outcomes, feedforward),
            *_runs(setting, outcomes))


def margin_diagnostics(best: Outcome, lost: Sequence[LostMargin]) -> Iterator[Diagnostic]:
    """Oscillations of the best controller's loops that hardly decay, and margins that uncertain valves may take."""
    least = min(best.margins, key=lambda margin: margin.damping)
    if 0 <= least.damping < LITTLE_DAMPING:
        yield Diagnostic.of("little damping", (best.name,), {
            "damping": least.damping, "hertz": least.damping_at / (2 * np.pi), "point": least.point,
            "undisturbed": least.undisturbed},
            "With {subject} an oscillation at {hertz:.1f} Hz is damped by a ratio of only {damping:.3f} ({point}); "
            "without feedback the least is {undisturbed:.3f}.",
            "Leaks, friction and measured pressures damp oil: see the table of loops.", Meaning.PROPERTY)
    for loop in dict.fromkeys(each.loop for each in lost):
        own = [each for each in lost if each.loop == loop]
        low = own[0].disk - SIGMAS * float(np.linalg.norm([each.lost for each in own]))
        if low < SMALL_DISK <= own[0].disk:
            yield Diagnostic.of("margins depend on uncertain valves", (best.name,), {
                "loop": loop, "disk": own[0].disk, "low": max(low, 0.0), "point": best.loops.point,
                "parameter": max(own, key=lambda each: each.lost).parameter},
                "Numbers of valves and oil are so uncertain that the disk margin of {loop} with {subject} may be "
                "{low:.2f} instead of {disk:.2f} ({point}), most of all by {parameter}.",
                "Identify them: `hydroopt plan-valve-test`.", Meaning.PROPERTY)


def _margins(setting: Setting, outcomes: Sequence[Outcome], feedforward: Outcome | None) -> Iterator[Diagnostic]:
    for outcome in outcomes:
        for each in setting.plant.actuators:
            gain, phase, disk, growing = (
                outcome.worst(each.actuator.name, key) for key in ("gain", "phase", "disk", "damping"))
            if outcome.kind == FEEDFORWARD and outcome is not feedforward:
                continue  # all feedforwards have the same loops
            if growing.damping < 0:
                yield Diagnostic.of(UNSTABLE, (outcome.name,), {
                    "point": growing.point, "hertz": growing.damping_at / (2 * np.pi),
                    "growth": float(np.expm1(growing.growth))},
                    "With {subject} errors at {hertz:.2g} Hz grow by {growth:.0%} a second in the posture of {point}, "
                    "which the motion passes too fast to be disturbed, or does not reach.",
                    "Do not stay there with this controller; a load that hangs almost undamped needs a brake.")
                break
            decibels, degrees = 20 * np.log10(gain.gain), np.degrees(phase.phase)
            if decibels < SMALL_DB or degrees < SMALL_DEG or disk.disk < SMALL_DISK:
                yield Diagnostic.of(SMALL_MARGINS, (outcome.name,), {
                    "loop": each.actuator.name, "gain_db": float(decibels), "gain_point": gain.point,
                    "phase_deg": float(degrees), "phase_point": phase.point, "disk": disk.disk,
                    "disk_point": disk.point},
                    "{subject} leaves the loop of {loop} margins of only {gain_db:.1f} dB ({gain_point}), "
                    "{phase_deg:.0f} degrees ({phase_point}), and a disk margin of {disk:.2f} ({disk_point}).")


def _runs(setting: Setting, outcomes: Sequence[Outcome]) -> Iterator[Diagnostic]:
    low, high = setting.demands.valves.limits
    for outcome in outcomes:
        if outcome.run.stopped:
            yield Diagnostic.of("run ended early", (outcome.name,), {"reason": outcome.run.stopped}, (
                "With {subject} {reason}."))
        part = np.mean((outcome.run.u <= low) | (outcome.run.u >= high), axis=0)
        for k, each in enumerate(setting.plant.actuators):
            if part[k] > SATURATED:
                yield Diagnostic.of("valve saturated", (outcome.name,), {
                    "valve": each.actuator.name, "part": float(part[k])},
                    "With {subject} the valve of {valve} is fully open {part:.0f %} of the time.")
