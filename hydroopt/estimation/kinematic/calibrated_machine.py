"""The calibrated geometry written back into the machine."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from hydroopt.errors import HydrooptError
from hydroopt.estimation.kinematic.solution import KinematicSolution
from hydroopt.machine.calibrated_numbers import closed_flat
from hydroopt.machine.joint_limits import NarrowedLimits, within_strokes
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine, read_machine


class WidenedLimits(NamedTuple):
    """Limits (lower, upper) [rad, m] of a joint before, and after poses that lie beyond them."""

    joint: str
    before: tuple[float, float]
    after: tuple[float, float]


class CalibratedMachine(NamedTuple):
    """The machine with the calibrated geometry, and joint limits that gave way: to its strokes, and to its poses."""

    machine: Machine
    narrowed: tuple[NarrowedLimits, ...]
    widened: tuple[WidenedLimits, ...]


class MachineText(NamedTuple):
    """Text of the calibrated machine's file; or "" and the reason why no machine can have this geometry."""

    text: str = ""
    reason: str = ""
    narrowed: tuple[NarrowedLimits, ...] = ()
    widened: tuple[WidenedLimits, ...] = ()


def calibrated_machine(solution: KinematicSolution) -> CalibratedMachine:
    """The machine with the calibrated geometry and its confidences.

    Joint limits beyond the ends of a stroke give way to it, and those short of poses to these, since limits are often
    assumed or rounded. A vector keeps
    the largest of its confidences, and correlations are lost; angles of locked joints belong to the poses and are not
    written.

    Raises:
        MachineError: no machine can have this geometry.
    """
    problem = solution.problem
    machine = problem.model.machine
    source = f"calibrated by {solution.algorithm} from {problem.poses.name}"
    numbers, values, notes = machine.numbers, {}, {}
    of_paths = dict(machine.notes)
    written: dict[str, float] = {}
    for name, value, std in zip(problem.parameters.names, solution.theta, solution.std, strict=True):
        if name not in numbers:  # angles of locked joints, drifts, places of fixtures that move
            continue
        held = name in problem.fixed or solution.at_bound[problem.parameters.index(name)]
        category = solution.category(name)
        identified = category == "full" or (category == "combination" and np.isfinite(std))
        if not (held or identified):  # an arbitrary number of a combination is no result
            continue
        values[name] = float(value)
        if name in problem.fixed:
            continue
        path = numbers[name].path
        before = of_paths.get(path, Note())
        if np.isfinite(std) and std > 0:
            written[path] = max(written.get(path, 0.0), float(std))
            before = before.model_copy(update={"sigma": written[path], "relative": False})
        notes[name] = of_paths[path] = before.model_copy(update={"source": source})
    widened = tuple(_widened(solution))
    reached = machine.with_joint_limits({each.joint: each.after for each in widened}) if widened else machine
    return CalibratedMachine(*within_strokes(reached.with_values(closed_flat(reached, values), notes)), widened)


def _widened(solution: KinematicSolution) -> Iterator[WidenedLimits]:
    """Limits of the machine's joints that poses exceed, without the poses that contradict the others."""
    problem = solution.problem
    for link in problem.model.machine.links:
        if link.name not in problem.model.joints or link.joint.type == "locked":
            continue
        k = problem.model.joints.index(link.name)
        angles = solution.q[problem.layout.sensed[:, k] & ~solution.suspicious, k]
        lower, upper = link.joint.range
        after = min(lower, float(np.min(angles, initial=lower))), max(upper, float(np.max(angles, initial=upper)))
        if after != (lower, upper):
            yield WidenedLimits(link.name, (lower, upper), after)


def machine_text(solution: KinematicSolution) -> MachineText:
    """The calibrated machine's file, where a machine can have this geometry."""
    try:
        made = calibrated_machine(solution)
        text = dump_machine(made.machine)
        read_machine(text, where="the calibrated machine")
    except (HydrooptError, ValueError) as error:
        return MachineText(reason=_reason(solution.problem.model.machine, error))
    return MachineText(text, narrowed=made.narrowed, widened=made.widened)


def _reason(machine: Machine, error: Exception) -> str:
    """The first reason in words, with the name of the part."""
    lines = [line.split(" [type=")[0].strip() for line in str(error).splitlines()]
    if len(lines) < 3:
        return lines[0]
    kind, number, *rest = lines[1].split(".")
    parts = getattr(machine, kind, ())
    named = number.isdigit() and int(number) < len(parts)
    place = ".".join([parts[int(number)].name, *rest]) if named else lines[1]
    return f"{place}: {lines[2][0].lower()}{lines[2][1:]}."
