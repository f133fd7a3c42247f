"""Diagnostics of a comparison of controllers: small margins, runs that ended early, saturated valves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hydroopt.control.outcome import FEEDFORWARD, Outcome
from hydroopt.control.setting import Setting
from hydroopt.results.diagnostic import Diagnostic
from hydroopt.results.machine_diagnostics import machine_diagnostics
from hydroopt.results.wording import Kind

SMALL_DB, SMALL_DEG = 6.0, 45.0
"""Gain and phase margins below which a loop is reported."""
SATURATED = 0.01
"""Part of the time for which a valve may be fully open."""


def control_diagnostics(setting: Setting, outcomes: Sequence[Outcome],
                        feedforward: Outcome | None) -> tuple[Diagnostic, ...]:
    """Impossible nominal bodies, small margins, runs that ended early, valves that saturate; `feedforward` is the best.
    """
    return (*machine_diagnostics(setting.plant.model), *_margins(setting, outcomes, feedforward),
            *_runs(setting, outcomes))


def _margins(setting: Setting, outcomes: Sequence[Outcome], feedforward: Outcome | None) -> Iterator[Diagnostic]:
    for outcome in outcomes:
        for each in setting.plant.actuators:
            gain, phase = (outcome.worst(each.actuator.name, key) for key in ("gain", "phase"))
            if outcome.kind == FEEDFORWARD and outcome is not feedforward:
                continue  # all feedforwards have the same loops
            if unstable := next((m for m in (gain, phase) if m.damping < 0), None):
                yield Diagnostic(Kind.UNSTABLE_ELSEWHERE, (outcome.name,), {"point": unstable.point})
                break
            decibels, degrees = 20 * np.log10(gain.gain), np.degrees(phase.phase)
            if decibels < SMALL_DB or degrees < SMALL_DEG:
                yield Diagnostic(Kind.SMALL_MARGINS, (outcome.name,), {
                    "loop": each.actuator.name, "gain_db": float(decibels), "gain_point": gain.point,
                    "phase_deg": float(degrees), "phase_point": phase.point})


def _runs(setting: Setting, outcomes: Sequence[Outcome]) -> Iterator[Diagnostic]:
    low, high = setting.demands.valves.limits
    for outcome in outcomes:
        if outcome.run.stopped:
            yield Diagnostic(Kind.RUN_STOPPED, (outcome.name,), {"reason": outcome.run.stopped})
        part = np.mean((outcome.run.u <= low) | (outcome.run.u >= high), axis=0)
        for k, each in enumerate(setting.plant.actuators):
            if part[k] > SATURATED:
                yield Diagnostic(Kind.VALVE_SATURATED, (outcome.name,), {
                    "valve": each.actuator.name, "part": float(part[k])})
