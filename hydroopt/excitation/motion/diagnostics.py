"""Diagnostics of a designed motion."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hydroopt.excitation.motion.expected_accuracy import ExpectedAccuracy
from hydroopt.excitation.motion.problem import ExcitationProblem
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.machine.actuators import Cylinder, Motor
from hydroopt.results.diagnostic import Diagnostic
from hydroopt.results.machine_diagnostics import machine_diagnostics
from hydroopt.results.wording import Kind

UNIMPROVED = 0.9
"""A parameter whose standard deviation stays above this part of what it was before is not improved."""


def excitation_diagnostics(problem: ExcitationProblem, accuracy: ExpectedAccuracy, *,
                           stopped: str, better_random: int) -> tuple[Diagnostic, ...]:
    """Diagnostics of search, machine file and expected accuracy, the most severe first.

    Args:
        problem: of the motion.
        accuracy: to expect of it.
        stopped: what cut the search short, empty if nothing did.
        better_random: number of random motions the best of which is better; 0 if none is.
    """
    return (*machine_diagnostics(problem.information.model), *_search(stopped=stopped, better_random=better_random),
            *_unlimited(problem), *_unstated(problem), *_biased(accuracy), *_unimproved(problem, accuracy))


def _search(*, stopped: str, better_random: int) -> Iterator[Diagnostic]:
    if stopped:
        yield Diagnostic(Kind.SEARCH_CUT_SHORT, (), {"how": stopped})
    if better_random:
        yield Diagnostic(Kind.RANDOM_TELLS_MORE, (), {"motions": better_random})


def _unlimited(problem: ExcitationProblem) -> Iterator[Diagnostic]:
    machine = problem.machine
    limits = {"the flow of the pump": machine.pump.max_flow if machine.pump else None,
              "the height above ground": machine.ground, "the workspace of the tip": machine.workspace,
              "tipping over": machine.footprint}
    hydraulic = any(isinstance(each, Cylinder | Motor) for each in machine.actuators)
    missing = [text for text, stated in limits.items()
               if stated is None and (hydraulic or text not in ("the flow of the pump", "tipping over"))]
    missing += [f"the effort of {each.name}" for each in machine.actuators
                if (each.relief_pressure if isinstance(each, Cylinder | Motor) else each.max_torque) is None]
    for joint in machine.joints:
        own = machine.link(joint).joint
        missing += [f"the {what} of {joint}" for what, value in (
            ("speed", own.max_speed), ("acceleration", own.max_acceleration)) if value is None]
    if missing:
        yield Diagnostic(Kind.NOT_LIMITED, tuple(missing))


def _unstated(problem: ExcitationProblem) -> Iterator[Diagnostic]:
    model = problem.information.model
    forces = [balance.name for balance, std in zip(model.machine.balances, force_noise(model), strict=True)
              if balance.actuators and not np.isfinite(std)]
    if forces:
        yield Diagnostic(Kind.NO_FORCE_ACCURACY, tuple(forces))
    angles = [joint for joint in model.machine.joints if model.machine.sensor(f"{joint}.q") is None]
    if angles:
        yield Diagnostic(Kind.NO_ANGLE_ACCURACY, tuple(angles))


def _biased(accuracy: ExpectedAccuracy) -> Iterator[Diagnostic]:
    biased = np.isfinite(accuracy.base) & (accuracy.bias > accuracy.base)
    if np.any(biased):
        yield Diagnostic(Kind.SMOOTHING_BIAS, (), {"biased": int(np.sum(biased)), "of": len(biased)})


def _unimproved(problem: ExcitationProblem, accuracy: ExpectedAccuracy) -> Iterator[Diagnostic]:
    names = problem.information.model.parameters.names
    unimproved = tuple(name for name, before, after in zip(names, accuracy.before, accuracy.after, strict=True)
                       if not after <= UNIMPROVED * before)
    if unimproved:
        yield Diagnostic(Kind.NOT_IMPROVED, unimproved, {"count": len(unimproved), "of": len(names)})
