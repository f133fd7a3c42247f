"""Diagnostics of a designed motion."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hydroopt.excitation.motion.expected_accuracy import ExpectedAccuracy
from hydroopt.excitation.motion.problem import ExcitationProblem
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.machine.actuators import Cylinder, Motor
from hydroopt.results.diagnostic import Diagnostic, Meaning
from hydroopt.results.machine_diagnostics import machine_diagnostics

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
        yield Diagnostic.of("search cut short", (), {"how": stopped}, (
            "The search was cut short {how}: the motion keeps all limits, but may not be the best."),
            "Search longer, without `--search-seconds` or with more of them.")
    if better_random:
        yield Diagnostic.of("a random motion tells more", (), {"motions": better_random}, (
            "The best of {motions} random motions determines more than this one: the search ended too early."),
            "Search longer (`--search-seconds`) or from more starts (`--starts`).")


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
        yield Diagnostic.of("not limited", tuple(missing), {}, (
            "The machine file does not limit {subject}."),
            "State what must be limited.", Meaning.PROPERTY)


def _unstated(problem: ExcitationProblem) -> Iterator[Diagnostic]:
    model = problem.information.model
    forces = [balance.name for balance, std in zip(model.machine.balances, force_noise(model), strict=True)
              if balance.actuators and not np.isfinite(std)]
    if forces:
        yield Diagnostic.of("no accuracy of forces stated", tuple(forces), {}, (
            "The machine file states no accuracy for the force of {subject}; its noise is assumed as a tenth of a "
            "typical force."),
            "State the accuracy in [[sensors]].", Meaning.PROPERTY)
    angles = [joint for joint in model.machine.joints if model.machine.sensor(f"{joint}.q") is None]
    if angles:
        yield Diagnostic.of("no accuracy of angles stated", tuple(angles), {}, (
            "The machine file states no accuracy for the angle of {subject}; it counts as exact here: the true σ will "
            "be larger than stated."),
            "State the accuracy in [[sensors]].", Meaning.PROPERTY)


def _biased(accuracy: ExpectedAccuracy) -> Iterator[Diagnostic]:
    biased = np.isfinite(accuracy.base) & (accuracy.bias > accuracy.base)
    if np.any(biased):
        yield Diagnostic.of("bias by smoothing", (), {"biased": int(np.sum(biased)), "of": len(biased)}, (
            "Smoothing noisy angles will bias {biased} of {of} base parameters by more than their σ."),
            "Drive slower, or measure the angles more accurately.")


def _unimproved(problem: ExcitationProblem, accuracy: ExpectedAccuracy) -> Iterator[Diagnostic]:
    names = problem.information.model.parameters.names
    unimproved = tuple(name for name, before, after in zip(names, accuracy.before, accuracy.after, strict=True)
                       if not after <= UNIMPROVED * before)
    if unimproved:
        yield Diagnostic.of("parameters not improved", unimproved, {"count": len(unimproved), "of": len(names)}, (
            "{count} of {of} parameters will stay about as uncertain as they are: {subject}."),
            meaning=Meaning.PROPERTY)
