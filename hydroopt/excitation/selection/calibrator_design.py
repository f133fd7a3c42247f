"""A designed calibrator: its parts, where they are mounted, the poses to measure, and what its own errors cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from hydroopt.excitation.selection.construction import BRACKET, Construction, Workshop, fixture_of
from hydroopt.excitation.selection.pose_plan import PosePlan
from hydroopt.machine.machine_file import dump_machine
from hydroopt.results.json_file import Job
from hydroopt.results.readable import readable
from hydroopt.results.tables import csv_text, number
from hydroopt.results.verdict import NORMAL, Action, NextStep, Purpose, Usable, Use

PART = ("theta", "d", "a", "alpha")
"""Numbers of a part, in the order of Eq. 3.8."""


class Tried(NamedTuple):
    """A construction that was sized: its links, the accuracy [rad] of their sensors, its cost, and its largest
    deviation over what is asked for."""

    links: int
    accuracy: tuple[float, ...]
    cost: float
    ratio: float


class OwnError(NamedTuple):
    """What it costs that a number of the calibrator is not exact: its address, its confidence [rad, m], the length that
    suffers most, and by what factor its deviation would be less if the number were exact."""

    name: str
    std: float
    length: str
    factor: float


@dataclass(frozen=True, eq=False, repr=False)
class CalibratorDesign(PosePlan):
    """A calibrator to build, with the poses to measure with it; the plan's machine carries it.

    Attributes:
        construction: links and sensors; `values` their sizes [rad, m] by address, and the place of the ball.
        workshop: what was allowed, and how accurately it is built.
        length_std: deviations [m] asked for by length; `least` if they only weigh.
        cost: of links and sensors.
        tried: constructions in the order in which they were sized.
        bound: below this, in units of what is asked for, no choice of as many of the candidate poses brings the largest
            deviation (see `Shares`); NaN where locked joints drift.

    >>> import hydroopt
    >>> problem = hydroopt.calibrator_problem(hydroopt.load_machine("cat215b"), 8, links=(4, 4))
    >>> design = hydroopt.solve(problem, starts=1, effort=0.02)
    >>> [part["name"] for part in design.parts][:2], len(design.q), design.machine.calibrator.parent
    (['calibrator_bracket', 'calibrator_1'], 24, 'stick')
    """

    construction: Construction
    values: Mapping[str, float]
    workshop: Workshop
    length_std: Mapping[str, float]
    least: bool
    cost: float
    tried: tuple[Tried, ...]
    bound: float

    job = Job.CALIBRATOR

    @property
    def method(self) -> str:
        """How it was found."""
        return "sizes and poses together, from several starts"

    @property
    def ball(self) -> tuple[float, ...]:
        """Place (3,) [m] of the ball in the base frame."""
        return tuple(self.machine.fixtures[0].position)

    @property
    def parts(self) -> list[dict[str, Any]]:
        """Bracket and links: name, θ [rad], d [m], a [m], α [rad] of Eq. 3.8, and the sensor's accuracy [rad]."""
        calibrator = self.machine.calibrator
        assert calibrator is not None
        accuracy = dict(zip(self.construction.names, self.construction.sensors, strict=True))
        return [{"name": link.name, **{key: getattr(link.joint, key) for key in PART},
                 "accuracy": accuracy[link.name].accuracy if link.name in accuracy else None}
                for link in calibrator.links if link.name in (BRACKET, *accuracy)]

    @cached_property
    def length_deviations(self) -> dict[str, float]:
        """Standard deviations to expect [m] of the lengths asked for."""
        std = dict(zip(self.names, self.std.tolist(), strict=True))
        return {name: std[name] for name in self.length_std}

    @property
    def reached(self) -> bool:
        """Whether all lengths are as accurate as asked for."""
        return all(self.length_deviations[name] <= asked for name, asked in self.length_std.items())

    @cached_property
    def own_errors(self) -> tuple[OwnError, ...]:
        """What each uncertain number of the calibrator costs, the dearest first."""
        own = [k for k, name in enumerate(self.names) if name.partition(".")[0] in (BRACKET, *self.construction.names)]
        total = self.observability.information + self.observability.prior
        places = {name: self.names.index(name) for name in self.length_std}
        prior = np.sqrt(np.diag(self.observability.prior))
        found = []
        for k in own:
            rest = np.delete(np.arange(len(total)), k)
            variance = np.diag(np.linalg.inv(total[np.ix_(rest, rest)]))
            factor = {name: self.length_deviations[name] / np.sqrt(variance[np.flatnonzero(rest == place)[0]])
                      for name, place in places.items()}
            most = max(factor, key=lambda name: factor[name])
            found.append(OwnError(self.names[k], float(1 / prior[k]) if prior[k] else float("inf"), most,
                                  float(factor[most])))
        return tuple(sorted(found, key=lambda each: -each.factor))

    @property
    def exact_deviations(self) -> dict[str, float]:
        """Standard deviations to expect [m] of the lengths, if every number of the calibrator were exact."""
        own = [name.partition(".")[0] in (BRACKET, *self.construction.names) for name in self.names]
        rest = np.flatnonzero(~np.array(own))
        total = (self.observability.information + self.observability.prior)[np.ix_(rest, rest)]
        std = np.sqrt(np.diag(np.linalg.inv(total)))
        return {name: float(std[np.flatnonzero(rest == self.names.index(name))[0]]) for name in self.length_std}

    @property
    def headline(self) -> str:
        """The calibrator in a sentence."""
        worst = max(self.length_deviations, key=lambda name: self.length_deviations[name] / self.length_std[name])
        ball = ", ".join(f"{each:.2f}" for each in self.ball).replace("-", "−")
        return (f"{self.construction.links} links, the ball at {ball} m: "
                f"{worst} to {readable(self.length_deviations[worst], 'm')}.")

    @property
    def uses(self) -> tuple[Use, ...]:
        """How well each length will be known."""
        return tuple(Use(Purpose.DIMENSIONS, name, Usable.YES, NORMAL * std, "m", condition=(
            f"expected 95 % interval after {len(self.q)} poses")) for name, std in self.length_deviations.items())

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """Build, measure, and calibrate."""
        typed = self.command_line
        return (NextStep(Action.USE, "Build the calibrator of calibrator.svg and mount it; correct its numbers in "
                                     f"{self.machine.name}.toml by what was built."),
                NextStep(Action.MEASURE, "Measure the poses of sheet.txt and fill their readings in poses.csv."),
                NextStep(Action.USE, "Then:", f"hydroopt calibrate {typed.path(f'{self.machine.name}.toml')} "
                                              f"{typed.path('poses.csv')} -o calibration"))

    def details(self) -> Mapping[str, Any]:
        """The calibrator, what was tried, and what its own errors cost."""
        return {**super().details(), "parts": self.parts, "ball_m": list(self.ball), "cost": number(self.cost),
                "length_std_m": {name: number(each) for name, each in self.length_std.items()},
                "expected_m": {name: number(each) for name, each in self.length_deviations.items()},
                "expected_if_exact_m": {name: number(each) for name, each in self.exact_deviations.items()},
                "bound": number(self.bound), "tried": [each._asdict() for each in self.tried],
                "own_errors": [each._asdict() for each in self.own_errors]}

    def files(self) -> Mapping[str, str]:
        """Those of the plan, the machine that carries the calibrator, and a table of its parts."""
        return {**super().files(), f"{self.machine.name}.toml": dump_machine(self.machine),
                "parts.csv": csv_text(self.parts)}

    def sheet(self) -> str:
        """Parts of the calibrator, where it is mounted, and the measuring sheet."""
        text = [f"calibrator of {self.construction.links} links on '{self._carrier}' of {self.machine.name}", "",
                "  part                 zero [deg]  offset d [mm]  length a [mm]  twist [deg]"]
        text += [f"  {part['name']:20s} {np.degrees(part['theta']):10.1f} {1e3 * part['d']:14.0f} "
                 f"{1e3 * part['a']:14.0f} {np.degrees(part['alpha']):12.0f}" for part in self.parts]
        text += ["", f"ball '{fixture_of(self.machine)}' at x {self.ball[0]:.3f}, y {self.ball[1]:.3f}, "
                     f"z {self.ball[2]:.3f} m in the base frame", ""]
        return "\n".join(text) + "\n" + super().sheet()

    @property
    def _carrier(self) -> str:
        calibrator = self.machine.calibrator
        assert calibrator is not None
        first = next(link for link in calibrator.links if link.name == BRACKET)
        return first.parent
