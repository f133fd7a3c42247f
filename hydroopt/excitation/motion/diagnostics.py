"""What a reader should know before a designed motion is driven."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hydroopt.excitation.motion.excitation import Excitation
from hydroopt.excitation.motion.expected_accuracy import Expectation
from hydroopt.logs.readings import force_noise
from hydroopt.machine.components import Cylinder, Motor

HARDLY = 0.9
"""A parameter whose standard deviation stays above this part of what it was before is hardly told."""
NAMED = 4
"""How many of a list are named."""


def doubts(excitation: Excitation, expectation: Expectation) -> tuple[str, ...]:
    """Reasons to hesitate, in plain words; the gravest first."""
    return (*_search(excitation), *_unlimited(excitation), *_unstated(excitation),
            *_biased(expectation), *_untold(excitation, expectation))


def _search(excitation: Excitation) -> Iterator[str]:
    if excitation.stopped:
        yield "The search was interrupted; a longer one may find a better motion."


def _unlimited(excitation: Excitation) -> Iterator[str]:
    machine = excitation.program.information.model.machine
    missing = {"the flow of the pump": machine.pump.max_flow if machine.pump else None,
               "the height above ground": machine.ground, "where the tip may go": machine.workspace,
               "tipping over": machine.footprint}
    hydraulic = any(isinstance(each, Cylinder | Motor) for each in machine.actuators)
    free = [text for text, stated in missing.items()
            if stated is None and (hydraulic or text not in ("the flow of the pump", "tipping over"))]
    free += [f"the effort of {each.name}" for each in machine.actuators
             if (each.relief_pressure if isinstance(each, Cylinder | Motor) else each.max_torque) is None]
    for joint in machine.joints:
        own = machine.link(joint).joint
        free += [f"the {what} of {joint}" for what, value in (("speed", own.max_speed),
                                                             ("acceleration", own.max_acceleration)) if value is None]
    if free:
        yield f"Not limited, because the machine file states nothing of it: {_some(free)}."


def _unstated(excitation: Excitation) -> Iterator[str]:
    model = excitation.program.information.model
    blind = [actuator.name for actuator, std in zip(model.machine.actuators, force_noise(model), strict=True)
             if not np.isfinite(std)]
    if blind:
        yield (f"The machine file states no accuracy for the force of {_some(blind)}; a tenth of a typical force is "
               "taken for its noise.")
    unread = [joint for joint in model.machine.joints if model.machine.sensor(f"{joint}.q") is None]
    if unread:
        yield (f"The machine file states no accuracy for the angle of {_some(unread)}; it counts as exact, so that σ "
               "will be larger.")


def _biased(expectation: Expectation) -> Iterator[str]:
    off = np.isfinite(expectation.base) & (expectation.bias > expectation.base)
    if np.any(off):
        yield (f"Smoothing noisy angles will put {int(np.sum(off))} of {len(off)} base parameters off by more than "
               "their σ: drive slower, or read the angles more accurately.")


def _untold(excitation: Excitation, expectation: Expectation) -> Iterator[str]:
    names = excitation.program.information.model.parameters.names
    seen = [k for k, (before, after) in enumerate(zip(expectation.before, expectation.after, strict=True))
            if not after <= HARDLY * before]
    if seen:
        yield (f"{len(seen)} of {len(names)} parameters will stay about as uncertain as they are: "
               f"{_some([names[k] for k in seen])}.")


def _some(names: list[str]) -> str:
    rest = len(names) - NAMED
    return ", ".join(names) if rest <= 1 else f"{', '.join(names[:NAMED])} and {rest} more"
