"""A planned measure-up: which readings to take by hand in which posture, and how well the tip is then known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.inference.listing import counted
from hydroopt.excitation.poses.plan import PosePlan
from hydroopt.excitation.poses.readings import DRIVE, Reading
from hydroopt.logs.poses import Poses
from hydroopt.results.readable import readable
from hydroopt.results.tables import number
from hydroopt.results.verdict import NORMAL, Action, NextStep, Purpose, Usable, Use


@dataclass(frozen=True, eq=False, repr=False)
class MeasureUpPlan(PosePlan):
    """Readings to take by hand, posture by posture, in the order of measuring.

    Attributes:
        readings: R that the machine file offers; `taken` (N, R) which of them to take in which posture.
        expected: the pose table that the nominal geometry would give.
        target: standard deviation of the tip [m] that was asked for, `tip` the one to expect and `tip_before` that of
            the machine file, each a root mean square over the workspace.

    >>> import hydroopt
    >>> machine = hydroopt.read_machine('''
    ... based_on = "excavator_bucket"
    ... [tracker]
    ... [calibrator]
    ... parent = "bucket"
    ... [[links]]
    ... name = "stick"
    ... joint = { theta = { value = "0 deg", sigma = "1 deg" } }
    ... [[sensors]]
    ... channels = ["swing.q", "boom.q", "stick.q", "bucket.q"]
    ... accuracy = "0.1 deg"
    ... [[sensors]]
    ... channels = ["tip.x", "tip.y", "tip.z"]
    ... accuracy = "5 mm"
    ... ''')
    >>> plan = hydroopt.solve(hydroopt.measure_up_problem(machine, tip=0.01), candidates=20)
    >>> plan.count, plan.tip <= 0.01 < plan.tip_before
    (1, True)
    """

    readings: tuple[Reading, ...]
    taken: NDArray[np.bool_]
    expected: Poses
    target: float
    tip: float
    tip_before: float

    @property
    def method(self) -> str:
        """How it was chosen."""
        return "fewest readings, per minute"

    @property
    def count(self) -> int:
        """Readings by hand."""
        return int(self.taken[:, [each.by_hand for each in self.readings]].sum())

    @property
    def minutes(self) -> float:
        """Minutes for driving and reading."""
        return float(DRIVE * len(self.q) + (self.taken * [each.minutes for each in self.readings]).sum())

    @property
    def by_themselves(self) -> tuple[str, ...]:
        """Channels that the plan counts on in every posture: joints' sensors, and readings that need no hand."""
        return (*(f"{joint}.q" for joint in self.joints if f"{joint}.q" in self.problem.channels),
                *(channel for each in self.readings if not each.by_hand for channel in each.channels))

    @property
    def uses(self) -> tuple[Use, ...]:
        """How well the tip will be known."""
        return (Use(Purpose.POSITION, "tip", Usable.YES, NORMAL * self.tip, "m", condition=(
            f"expected 95 % interval over the workspace after {self._effort}")),)

    @property
    def _effort(self) -> str:
        return f"{counted(self.count, 'reading')} in {counted(len(self.q), 'posture')}"

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """Measure, and calibrate."""
        along = " and what reads by itself" if self.by_themselves else ""
        return (NextStep(Action.MEASURE, f"Take the readings of sheet.txt (about {self.minutes:.0f} min), and fill "
                                         f"them{along} into poses.csv; leave all other cells empty."),
                NextStep(Action.USE, "Then:", f"hydroopt calibrate {self.machine.source} "
                                              f"{self.command_line.path('poses.csv')} -o calibration"))

    def details(self) -> Mapping[str, Any]:
        """What was chosen, and how well the tip will be known."""
        return {**super().details(), "readings": self.count, "minutes": number(self.minutes),
                "tip_m": number(self.tip), "tip_before_m": number(self.tip_before), "target_m": number(self.target),
                "taken": [[each.name for each, there in zip(self.readings, row, strict=True) if there]
                          for row in self.taken]}

    def sheet(self) -> str:
        """The measuring sheet as plain text: where to drive, what to read there, and what to expect."""
        text = [f"{self._effort} for {self.machine.name}: about {self.minutes:.0f} min. The tip is then known to "
                f"{readable(self.tip, 'm')}, now to {readable(self.tip_before, 'm')}."]
        text += ["", self.watch.list, "", self.left_out.sentence, self.ways]
        if self.by_themselves:
            text += [f"In every posture, record along: {', '.join(self.by_themselves)}."]
        read = [joint for joint in self.joints if f"{joint}.q" in self.problem.channels]
        printed = {joint: self._printed(joint) for joint in read}
        before: tuple[str, ...] = ()
        for k in range(len(self.q)):
            group = tuple(str(each[k]) for each in self.labels)
            if group != before and any(group):
                text += ["", ", ".join(f"{name} '{value}'" for name, value in
                                       zip(self.labels._fields, group, strict=True) if value)]
            before = group
            places = ", ".join(f"{joint} {texts[k]} {unit}" for joint, (unit, texts) in printed.items())
            lengths = ", ".join(f"{cylinder.name} {1e3 * length:.0f} mm" for cylinder, length in
                                zip(self.machine.cylinders, self.lengths[k], strict=True))
            text += ["", f"posture {k + 1}: {places or lengths}"]
            text += [f"  read {each.name}{self._expected(each, k)}"
                     for each, there in zip(self.readings, self.taken[k], strict=True) if there and each.by_hand]
        return "\n".join(text) + "\n"

    def _expected(self, reading: Reading, k: int) -> str:
        """The values that the nominal geometry gives; none where the instrument's place is not known."""
        if any(each.name == reading.name.partition(".")[0] and not each.stands for each in self.machine.instruments):
            return ""
        values = [(channel.rpartition(".")[2], float(self.expected.channels[channel][k]),
                   self.expected.units[channel]) for channel in reading.channels]
        return ": " + ", ".join(f"{name} {1e3 * value:.0f} mm" if unit == "m" else f"{name} {np.degrees(value):.1f} deg"
                         if unit == "rad" else f"{name} {value:.4g} {unit}" for name, value, unit in values)
