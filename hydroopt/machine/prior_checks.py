"""Whether a machine file's gravity and totals can be true, and whether anything uses its confidences and bounds."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from hydroopt.machine.environment import CHASSIS
from hydroopt.machine.machine import Machine
from hydroopt.machine.parameter_kind import ParameterKind
from hydroopt.machine.quantity import ImpossibleError

STRONGEST_GRAVITY = 30.0
"""Gravity [m/s²] above that of any planet."""
TOTAL_FACTOR = 10.0
"""How many times a weighed total may differ from the nominal masses before one of them is a mistake."""
_UNBOUNDED = (ParameterKind.FIRST_MOMENT, ParameterKind.MOMENT_OF_INERTIA)


def check(machine: Machine) -> None:
    """Check what a machine file states beside its numbers: standard deviations, bounds, totals, gravity.

    Raises:
        ImpossibleError: names the number, its place and the remedy.
    """
    if machine.gravity > STRONGEST_GRAVITY:
        raise ImpossibleError(f"gravity is {machine.gravity:.4g} m/s^2", "on earth it is 9.81 m/s^2", "gravity")
    numbers = tuple(machine.numbers.values())
    bounded = {number.path for number in numbers if number.kind not in _UNBOUNDED}
    calibrated = {*(number.path for number in numbers), *_further_calibrated(machine)}
    for path, note in machine.notes.items():
        if note.sigma is not None:
            _refuse_unused("sigma", path, calibrated, machine)
        if note.lower is not None or note.upper is not None:
            _refuse_unused("bounds", path, bounded, machine)
    _totals(machine)


def _further_calibrated(machine: Machine) -> Iterator[str]:
    """Paths of what estimators use with its sigma, but which is no number of the machine by itself."""
    for number in machine.numbers.values():
        if number.kind is ParameterKind.MASS:
            body = number.path.removesuffix(".m")
            yield from (f"{body}.com", f"{body}.inertia_com")
    yield from (f"{distance.name}.length" for distance in machine.distances)
    yield from (f"{total.name}.value" for total in machine.total_masses)
    yield from CHASSIS
    for stage in machine.stages:
        yield from (f"{stage.name}.locked.{joint}" for joint in stage.locked)
    yield from machine.lags


def _refuse_unused(what: str, path: str, used: Collection[str], machine: Machine) -> None:
    if path not in used:
        raise ImpossibleError(f"nothing uses the {what} of this number", f"remove the {what}", machine.place(path))


def _totals(machine: Machine) -> None:
    masses = {number.name.removesuffix(".m"): number.value for number in machine.numbers.values()
              if number.kind is ParameterKind.MASS}
    for total in machine.total_masses:
        nominal = sum(masses[body] for body in total.bodies)
        if nominal > 0 and not 1 / TOTAL_FACTOR < total.value / nominal < TOTAL_FACTOR:
            raise ImpossibleError(f"the bodies are weighed as {total.value:.6g} kg together, but their masses in this "
                                  f"file add up to {nominal:.6g} kg", "correct the total, its unit, or the masses",
                                  f"total_masses[{total.name}]")
