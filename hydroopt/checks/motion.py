"""What motions use of a machine's limits, and which they break: of designed, foreign and recorded ones alike."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from hydroopt.checks.alternatives import UNITS
from hydroopt.checks.plausibility import misread
from hydroopt.limits.limits import Limits, UseOfLimit, courses
from hydroopt.limits.reserves import DEFAULT, Reserves
from hydroopt.limits.uncertain import UncertainParameters
from hydroopt.logs.frames import all_of
from hydroopt.logs.log import Log
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import GivenMachine
from hydroopt.model.model import Model, model_of
from hydroopt.results.answer import Answer
from hydroopt.results.diagnostic import Diagnostic, Meaning
from hydroopt.results.json_file import Job
from hydroopt.results.readable import readable
from hydroopt.results.tables import number
from hydroopt.results.verdict import Action, Claim, NextStep, Purpose, Usable
from hydroopt.simulation.reference_motion import reference_motion
from hydroopt.simulation.simulate import Trajectory

METHOD = "the limits of the machine file"
EXACT = 1e-6
"""Part of a limit's scale that counts as rounding: designed motions touch their limits."""


class LimitInMotion(NamedTuple):
    """What a motion does to a limit.

    `use` is held against the reserves, with uncertain parameters; `beyond` [unit] is by how much the limit itself is
    broken at the nominal parameters, and `at` when [s]; `place` (3,) [m] is where the tip is then.
    """

    log: str
    use: UseOfLimit
    beyond: float
    at: float
    place: tuple[float, float, float]

    @property
    def broken(self) -> bool:
        """Whether the limit itself is broken."""
        return self.beyond > 0

    @property
    def short(self) -> bool:
        """Whether the limit is kept, but not its reserve."""
        return not self.broken and self.use.room < 0


def _of_limit(found: LimitInMotion) -> Diagnostic:
    """A limit that is broken, or of which the reserve is used."""
    evidence = {"amount": readable(found.beyond if found.broken else -found.use.room, found.use.unit), "at": found.at,
                "log": found.log, **dict(zip("xyz", found.place, strict=True))}
    if found.broken:
        return Diagnostic.of("limit broken", (found.use.name,), evidence, (
            "{log}: {subject} is beyond its limit by {amount} at {at:.2f} s, the tip at ({x:.2f}, {y:.2f}, {z:.2f}) "
            "m."),
            "Drive it slower or over less range, or correct the limit in the machine file.", Meaning.CONTRADICTION)
    return Diagnostic.of("reserve used", (found.use.name,), evidence, (
        "{log}: {subject} uses {amount} of its reserve at {at:.2f} s, the tip at ({x:.2f}, {y:.2f}, {z:.2f}) m."),
        "Drive it slower or over less range, or state the reserve that suffices with --reserve.", Meaning.PROPERTY)


@dataclass(frozen=True, eq=False, repr=False)
class MotionCheck(Answer):
    """What motions use of each limit, with time, place and amount; `check_motion` returns it.

    Attributes:
        model: of the machine.
        motions: by name of their logs.
        limits: with the reserves; `itself` are the limits without, at the nominal parameters.

    Example:
        >>> import hydroopt as ho
        >>> machine = ho.load_machine("cat215b")
        >>> t = np.linspace(0, 4, 41)
        >>> log = ho.Log("down", t, {"swing.q": 0 * t, "boom.q": -0.2 + 0.1 * t, "stick.q": 1.4 + 0 * t},
        ...     units={"swing.q": "rad", "boom.q": "rad", "stick.q": "rad"})
        >>> found = check_motion(machine, log)
        >>> found.status.value, [each.use.name for each in found.table if each.broken]
        ('suspect', ['stick above ground'])
    """

    model: Model
    motions: Mapping[str, Trajectory]
    limits: Limits
    itself: Limits
    sources: tuple[Mapping[str, Any], ...] = ()

    job = Job.MOTION_CHECK

    @property
    def machine(self) -> Machine:
        """The machine that it is about."""
        return self.model.machine

    @property
    def method(self) -> str:
        """How it was computed."""
        return METHOD

    @cached_property
    def table(self) -> tuple[LimitInMotion, ...]:
        """Every limit in every motion, those that are broken most first."""
        found = [each for name, path in self.motions.items() for each in self._of(name, path)]
        return tuple(sorted(found, key=lambda each: (not each.broken, not each.short, not each.use.part < np.inf,
                                                     each.use.part)))

    def _of(self, name: str, path: Trajectory) -> Iterator[LimitInMotion]:
        states = path.q, path.qd, path.qdd
        kept, itself = courses(self.limits, *states), courses(self.itself, *states)
        tip = self.model.over(self.model.forward_kinematics, path.q)[-1][:, :3, 3]
        scales = {row.name: row.scale for row in self.limits.rows}
        for limit, course in kept.items():
            # own parts that come near by no more than the reserve are watched for the reserve alone
            own = itself[limit].use if limit in itself else course.use
            beyond = -own.room if limit in itself and own.room < -EXACT * scales[limit] else 0.0
            use = course.use if course.use.room < -EXACT * scales[limit] else _without_rounding(course.use)
            sample = own.sample if beyond else use.sample
            x, y, z = tip[sample].tolist()
            yield LimitInMotion(name, use, beyond, float(path.t[sample]), (x, y, z))

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Angles and strokes in another unit, limits that are broken, and reserves that are used."""
        return (*(found for name, path in self.motions.items() for found in self._misread(name, path)),
                *(_of_limit(each) for each in self.table if each.broken or each.short))

    def _misread(self, name: str, path: Trajectory) -> Iterator[Diagnostic]:
        """Joints that move by more than their range beyond it, and keep to it if their positions have another unit."""
        machine, by_unit = self.model.machine, dict[str, list[str]]()
        for k, joint in enumerate(machine.joints):
            (lower, upper), q = machine.link(joint).joint.range, path.q[:, k]
            if np.max(np.abs(q - np.clip(q, lower, upper))) > upper - lower:
                kind = "length" if machine.link(joint).joint.type == "prismatic" else "angle"
                fitting = [unit for unit, factor in UNITS[kind].items()
                           if np.all((factor * q >= lower) & (factor * q <= upper))]
                for unit in fitting[:1]:
                    by_unit.setdefault(unit, []).append(f"{joint}.q")
        for unit, channels in by_unit.items():
            yield misread(channels, {
                "log": name, "reading": f"{', '.join(channels)} in {unit}", "agrees": "agrees",
                "read_so": "positions keep to the joints' ranges", "as_read": "they are far beyond them"})

    @cached_property
    def claims(self) -> tuple[Claim, ...]:
        """Whether each motion can be driven."""
        made = []
        for name in self.motions:
            broken = [each.use.name for each in self.table if each.log == name and each.broken]
            short = [each.use.name for each in self.table if each.log == name and each.short]
            made.append(Claim(Purpose.DRIVING, name, Usable.NO if broken or short else Usable.YES,
                            condition="within what the machine file limits",
                            reason=f"it breaks {', '.join(broken[:3])}" if broken else
                            f"it uses the reserve of {', '.join(short[:3])}" if short else ""))
        return tuple(made)

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """Another motion, where limits are broken."""
        if any(each.broken or each.short for each in self.table):
            return (NextStep(Action.DRIVE, "Drive it slower or over less range, or design one:",
                             f"hydroopt excite {self.model.machine.source} -o motion"),)
        return ()

    @property
    def inputs(self) -> tuple[Mapping[str, Any], ...]:
        """The motions' files."""
        return self.sources

    def details(self) -> Mapping[str, Any]:
        """Every limit in every motion."""
        return {"reserves": self.limits.reserves._asdict(), "limits": [
            {"log": each.log, "name": each.use.name, "unit": each.use.unit, "lower": number(each.use.lower),
             "lowest": each.use.lowest, "highest": each.use.highest, "upper": number(each.use.upper),
             "room": each.use.room, "beyond": each.beyond, "t": each.at, "tip": list(each.place)}
            for each in self.table]}

    def __str__(self) -> str:
        lines = [f"  {'limit':<34} {'room':>12} {'at':>9}  tip [m]"]
        for each in self.table:
            room = readable(-each.beyond if each.broken else each.use.room, each.use.unit)
            lines.append(f"  {each.use.name:<34} {room:>12} {each.at:>7.2f} s  "
                         f"{' '.join(f'{value:.2f}' for value in each.place)}")
        return "\n".join(lines)


def check_motion(machine: GivenMachine | Model, logs: Log | Sequence[Log], *, reserves: Reserves = DEFAULT,
                 known: UncertainParameters | None = None) -> MotionCheck:
    """Every limit that motions use or break, with time, place and amount; what `excite` designs passes.

    Speeds and accelerations of a designed motion are taken as they stand; those of any other log are smoothed.

    Args:
        machine: with its limits, or its model.
        logs: with positions of all joints.
        reserves: that are to be kept, but for `tracking`: what was driven may use the margin of a plan.
        known: of the parameters, by which pressures, valves and tipping are to keep them; by default the file's.

    Raises:
        LogError: positions of a joint are missing.
        ProblemError: a reserve leaves nothing.

    See `MotionCheck` for an example.
    """
    model = model_of(machine, "check_motion")
    given = all_of(logs, (Log,), "log", model.machine.name)
    motions = {log.path or log.name: reference_motion(model.machine, log, bounded=False) for log in given}
    limits = Limits(model, reserves._replace(tracking=0.0), known)
    return MotionCheck(model, motions, limits, limits.without_reserves(),
                       tuple({"path": log.path or log.name, "sha256": log.sha256 or None, "samples": log.size,
                              "role": "checked"} for log in given))


def _without_rounding(use: UseOfLimit) -> UseOfLimit:
    """The use of a limit that is kept but for rounding."""
    return use._replace(lowest=max(use.lowest, use.lower), highest=min(use.highest, use.upper))
