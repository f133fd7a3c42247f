"""Designing a calibrator: constructions from the cheapest on, each sized from several starts, until one suffices.

The design states its parts, where they are mounted, the poses to measure, and what its own errors cost.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.excitation.selection.calibrator_problem import (
    BRACKET,
    CalibratorProblem,
    Construction,
    Workshop,
    carrying,
    fixture_of,
)
from hydroopt.excitation.selection.calibrator_sizing import Sized, Sizing
from hydroopt.excitation.selection.candidate_postures import in_passes
from hydroopt.excitation.selection.exchange import best_poses
from hydroopt.excitation.selection.pose_plan import PosePlan
from hydroopt.excitation.selection.pose_problem import Postures, measured_along, pose_problem
from hydroopt.machine.machine_file import dump_machine
from hydroopt.results.json_file import Job
from hydroopt.results.readable import readable
from hydroopt.results.tables import csv_text, number
from hydroopt.results.verdict import NORMAL, Action, Claim, NextStep, Purpose, Usable
from hydroopt.support.progress import Progress, silent

PART = ("theta", "d", "a", "alpha")
"""Numbers of a part, in the order of Eq. 3.8."""
MARGIN = 0.95
"""Part of the deviations asked for that sizes must reach, since poses are whole numbers."""
ROUNDED = {"m": 1e-3, "rad": math.radians(0.1)}
"""Steps of lengths [m] and angles [rad] of what is built."""
TRIES = 8
"""Times that so many postures are drawn, where few of them close within the limits."""
MORE = 3.0
"""Postures to choose from for each one to measure."""
SWEEPS = 8
"""Times that a stage whose locked joints drift is driven through its postures."""


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
    def _own(self) -> NDArray[np.bool_]:
        """Which of the parameters (f,) are numbers of the calibrator."""
        return np.array([name.partition(".")[0] in (BRACKET, *self.construction.names) for name in self.names])

    @cached_property
    def own_errors(self) -> tuple[OwnError, ...]:
        """What each uncertain number of the calibrator costs, the dearest first."""
        covariance, names = self.observability.covariance, list(self.length_std)
        places = [self.names.index(name) for name in names]
        found = []
        for k in np.flatnonzero(self._own).tolist():
            # an exact number leaves of each variance what does not follow it
            left = 1 - covariance[places, k] ** 2 / (covariance[k, k] * np.diag(covariance)[places])
            most, prior = int(np.argmin(left)), self.observability.prior[k, k]
            found.append(OwnError(self.names[k], float(1 / np.sqrt(prior)) if prior else math.inf, names[most],
                                  float(1 / np.sqrt(left[most]))))
        return tuple(sorted(found, key=lambda each: -each.factor))

    @property
    def exact_deviations(self) -> dict[str, float]:
        """Standard deviations to expect [m] of the lengths, if every number of the calibrator were exact."""
        rest = np.flatnonzero(~self._own)
        total = (self.observability.information + self.observability.prior)[np.ix_(rest, rest)]
        std = dict(zip(rest.tolist(), np.sqrt(np.diag(np.linalg.inv(total))).tolist(), strict=True))
        return {name: std[self.names.index(name)] for name in self.length_std}

    @property
    def headline(self) -> str:
        """The calibrator in a sentence."""
        worst = max(self.length_deviations, key=lambda name: self.length_deviations[name] / self.length_std[name])
        ball = ", ".join(f"{each:.2f}" for each in self.ball).replace("-", "−")
        return (f"{self.construction.links} links, the ball at {ball} m: "
                f"{worst} to {readable(self.length_deviations[worst], 'm')}.")

    @property
    def claims(self) -> tuple[Claim, ...]:
        """How well each length will be known."""
        return tuple(Claim(Purpose.LENGTH, name, Usable.YES, NORMAL * std, "m", condition=(
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


def design_calibrator(problem: CalibratorProblem, *, starts: int = 3, effort: float = 1.0, seed: int = 0,
                      progress: Progress = silent) -> CalibratorDesign:
    """The cheapest calibrator that suffices, or with `least` the best one of the most links, with its poses.

    Args:
        problem: what may be built, and how well lengths are to be known.
        starts: calibrators of each construction that are sized together with their poses.
        effort: part of the usual number of random calibrators and rounds.
        seed: of all random numbers.
        progress: receives the steps, see `hydroopt.support.progress`.

    Raises:
        ProblemError: no calibrator closes within the limits, or none suffices.
    """
    rng = np.random.default_rng(seed)
    offered = list(problem.constructions())
    if problem.least:
        offered = offered[-1:] if len(problem.sensors) == 1 else [
            max(offered, key=lambda each: (each[1].links, -each[1].sensors[0].accuracy))]
    tried: list[Tried] = []
    for k, (_, construction) in enumerate(offered):
        search = Sizing(problem, construction)
        sized = search.best(starts, rng, progress, (0.9 * k / len(offered), 0.9 * (k + 1) / len(offered)), effort)
        built = construction._replace(crossing=search.crossing(sized.values)) if sized.values else construction
        tried.append(_tried(problem, built, sized))
        if not sized.values or not (problem.least or sized.worst <= math.log(MARGIN)):
            continue
        if not problem.least:
            built, sized = _cheaper(problem, built, sized, rng, tried)
        progress("choosing poses", 0.9)
        if (design := planned(problem, built, sized, tuple(tried), rng, seed)) is not None and (
                problem.least or design.reached):
            return design
    best = min(tried, key=lambda each: each.ratio)
    if problem.least and math.isfinite(best.ratio):
        raise ProblemError(f"fewer than {problem.count} random postures of a stage close within the limits",
                           where=f"calibrator for {problem.machine.name}", remedy="measure fewer poses, or allow more "
                           "starts, longer links, or another place of the ball")
    if not math.isfinite(best.ratio):
        raise ProblemError("no calibrator closes the loop within its limits in the poses of all stages",
                           where=f"calibrator for {problem.machine.name}",
                           remedy="allow longer links, another place of the ball, or lock joints elsewhere")
    raise ProblemError(f"the best calibrator found, of {best.links} links, leaves a length at {best.ratio:.3g} times "
                       "the accuracy asked for", where=f"calibrator for {problem.machine.name}",
                       remedy="ask for less, measure more poses, or allow better sensors, more or longer links")


def _tried(problem: CalibratorProblem, construction: Construction, sized: Sized) -> Tried:
    return Tried(construction.links, tuple(each.accuracy for each in construction.sensors), problem.cost(construction),
                 math.exp(sized.worst))


def _cheaper(problem: CalibratorProblem, construction: Construction, sized: Sized, rng: np.random.Generator,
             tried: list[Tried]) -> tuple[Construction, Sized]:
    """The same sizes with a cheaper sensor at each joint where it suffices."""
    for joint in range(construction.links):
        for offer in sorted(problem.sensors, key=lambda each: each.cost):
            if offer.cost >= construction.sensors[joint].cost:
                break
            own = construction.sensors
            other = construction._replace(sensors=(*own[:joint], offer, *own[joint + 1:]))
            again = Sizing(problem, other).refined(sized.values, rng, 0)
            if again is not None:
                tried.append(_tried(problem, other, again))
                if again.worst <= math.log(MARGIN):
                    construction, sized = other, again
                    break
    return construction, sized


def planned(problem: CalibratorProblem, construction: Construction, sized: Sized, tried: tuple[Tried, ...],
             rng: np.random.Generator, seed: int) -> CalibratorDesign | None:
    """The calibrator in round numbers with whole numbers of poses; None where too few postures close."""
    search = Sizing(problem, construction)
    values = _rounded(sized.values, search)
    found, wanted = search.about(replace(sized, values=values), problem.count, rng), int(MORE * problem.count)
    for _ in range(TRIES):
        found = [np.concatenate(pair) for pair in zip(found, search.postures(values, wanted, rng, 0.0), strict=True)]
        if (least := min(map(len, found))) >= wanted:
            break
    if least < problem.count:
        return None
    machine = carrying(problem.machine, construction, values, problem.workshop, problem.keep)
    base = pose_problem(machine, problem.count, criterion="A", focus=tuple(problem.length_std), priors=problem.priors,
                        fixed={name: values.get(name, value) for name, value in problem.fixed.items()},
                        reserves=problem.reserves)
    q = np.array([each[in_passes(each[:, measured_along(base.model, group)], SWEEPS if group.drift else 1)]
                  for group, each in zip(base.groups, (each[:least] for each in found), strict=True)])
    shares = search.shares(values, q, 400)
    units = {name: target / math.sqrt(max(float(weight), 1e-6))
             for (name, target), weight in zip(problem.length_std.items(), shares.weight, strict=True)}
    drifts = any(group.drift for group in base.groups)  # these depend on the order, too
    return CalibratorDesign(
        Postures(base, best_poses(base, q, units=units)), least, seed, search.left_out, construction, values,
        problem.workshop, problem.length_std, problem.least, problem.cost(construction), tried,
        math.nan if drifts else math.sqrt(shares.bound))


def _rounded(values: Mapping[str, float], search: Sizing) -> dict[str, float]:
    """Sizes in whole millimetres and tenths of a degree, the ball's place in whole centimetres."""
    step = {size.name: 1e-2 if size.name.startswith(f"{search.fixture}.") else ROUNDED[size.unit]
            for size in search.sizes}
    return {name: round(value / step[name]) * step[name] if name in step else value for name, value in values.items()}
