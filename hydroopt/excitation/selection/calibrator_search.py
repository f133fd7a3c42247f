"""The best calibrator of one construction: random sizes, then sizes and poses together, in turn with fresh poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hydroopt.excitation.selection.calibrator_program import STEPS, JointProgram, Sized
from hydroopt.excitation.selection.candidate_postures import Sieve
from hydroopt.excitation.selection.construction import BRACKET, Construction, Workshop, carrying, fixture_of, sizes
from hydroopt.excitation.selection.pose_problem import PoseGroup, PoseProblem, pose_problem
from hydroopt.limits.postures import LeftOut
from hydroopt.limits.reserves import DEFAULT, Reserves
from hydroopt.machine.machine import Machine
from hydroopt.progress import Progress
from hydroopt.simulation import postures
from hydroopt.spatial.inertia import Array

FEW, MANY = 16, 150
"""Closed postures of each group by which sizes are judged at first, and from which the best are taken."""
SUPPORT = 12
"""Postures of each group that are moved together with the sizes."""
DRAWN = 40
"""Random calibrators for each start."""
ROUNDS = 3
"""Rounds with fresh postures."""
NEARLY = 0.95
"""Part of the distance from limits that closed postures of the solver keep."""
ABOUT = float(np.radians(1.0))
"""Standard deviation [rad, m] of postures that are measured instead of one posture again and again."""
DENSE = 4
"""Postures about one that are tried for each that is wanted."""
RIGHT_ANGLE = 0.5 * np.pi


class Search:
    """Sizes of one construction on one machine.

    Attributes:
        machine: what is calibrated.
        construction: what is built; which axes cross is left open here.
        workshop: ranges of sizes, and their errors.
        keep: links of the machine's own calibrator that stay.
        program: sizes and poses as a nonlinear program.
        left_out: closed postures that were left out so far to keep reserves.
    """

    def __init__(self, machine: Machine, construction: Construction, workshop: Workshop, keep: Sequence[str],
                 targets: Mapping[str, float], count: int, fixed: Mapping[str, float], priors: bool,
                 reserves: Reserves = DEFAULT) -> None:
        self.machine, self.construction, self.workshop, self.keep = machine, construction, workshop, tuple(keep)
        self.sizes = tuple(sizes(construction, workshop, fixture_of(machine)))
        middle = {size.name: (size.lower + size.upper) / 2 for size in self.sizes}
        # sizes are parameters of the template also where the workshop builds them exactly
        uncertain = replace(workshop, length_error=workshop.length_error or 1e-3,
                            angle_error=workshop.angle_error or 1e-3)
        template = carrying(machine, construction, middle, uncertain, keep)
        exact = {"m": not workshop.length_error, "rad": not workshop.angle_error}
        made = (BRACKET, *construction.names)
        problem = pose_problem(template, count, priors=priors, fixed=fixed, reserves=reserves)
        held = {name: float(value) for name, unit, value in zip(
            problem.parameters.names, problem.parameters.units, problem.parameters.nominal, strict=True)
            if name.partition(".")[0] in made and exact[unit]}
        self.problem: PoseProblem = replace(problem, fixed={**held, **fixed})
        self.program = JointProgram(self.problem, self.sizes, dict(targets),
                                    max(workshop.clearance, reserves.clearance))
        self.left_out = LeftOut()
        self.twists = tuple(f"{name}.alpha" for name in made[:-1])

    def best(self, starts: int, rng: np.random.Generator, progress: Progress, done: tuple[float, float],
             effort: float = 1.0) -> Sized:
        """From some starts; `done` are the parts of all work before and after it."""
        begin, end = done
        drawn_each, rounds = max(2, round(DRAWN * effort)), max(1, round(ROUNDS * effort))
        steps = max(5, round(STEPS * min(effort, 1.0)))
        drawn = []
        for k in range(starts * drawn_each):
            if k % drawn_each == 0:
                progress(f"drawing calibrators of {self.construction.links} links",
                         begin + 0.3 * (end - begin) * k / (starts * drawn_each))
            values = self.random(rng)
            drawn.append((self.judged(values, rng), k, values))
        drawn.sort(key=lambda each: each[:2])
        found = []
        for k, (_, _, values) in enumerate(drawn[:starts]):
            progress(f"sizing calibrator {k + 1} of {starts} with {self.construction.links} links",
                     begin + (0.3 + 0.7 * k / starts) * (end - begin))
            if (sized := self.refined(values, rng, rounds, steps)) is not None:
                found.append(sized)
        return min(found, key=lambda each: each.worst, default=Sized({}, np.zeros(0), np.zeros(0), np.inf))

    def random(self, rng: np.random.Generator) -> dict[str, float]:
        """Sizes and twists."""
        values = {size.name: float(rng.uniform(size.lower, size.upper)) for size in self.sizes}
        return values | {name: RIGHT_ANGLE * int(rng.integers(2)) for name in self.twists}

    def crossing(self, values: Mapping[str, float]) -> tuple[bool, ...]:
        """Which axes cross at right angles."""
        return tuple(values[name] > 0 for name in self.twists)

    def judged(self, values: Mapping[str, float], rng: np.random.Generator) -> float:
        """Logarithm of the largest deviation by a few postures; beyond all others where these do not close."""
        found = self.postures(values, FEW, rng)
        least = min(map(len, found))
        if least < FEW // 2:
            return 100.0 - sum(min(len(each), FEW) for each in found)
        q = np.array([each[:least] for each in found])
        return float(0.5 * np.log(np.max(self.program.shares(values, q, 30).variance)))

    def postures(self, values: Mapping[str, float], count: int, rng: np.random.Generator,
                 aside: float = 1.0) -> list[Array]:
        """Up to so many closed postures (K, n) of each group within all limits; fewer where they are rare."""
        model, fixture = self.problem.model, fixture_of(self.machine)
        geometry = self.program.theta(values)[: len(model.parameters)]
        turning, found = postures.sensed_joints(model), []
        for group in self.problem.groups:
            free = self._free(group)
            q, _ = postures.closed_postures(
                model, 8 * count, rng, geometry=geometry, turning=turning, within_limits=free,
                locked=group.locked, fixture=np.array([values[f"{fixture}.{axis}"] for axis in "xyz"]),
                batch=4 * count, give_up=lambda closed, tried: tried >= 8 * count)
            found.append(self._fitting(values, group, q, aside)[:count])
        return found

    def _fitting(self, values: Mapping[str, float], group: PoseGroup, q: Array, aside: float) -> Array:
        """Of closed postures (N, n) of a group those (K, n) within all limits and their reserves."""
        if not len(q):
            return q
        sieve = Sieve(self.problem.limits, group)
        found = sieve(q[self.program.fits(values, q, self._free(group), aside)],
                      self.program.theta(values)[: len(self.problem.model.parameters)])
        self.left_out = self.left_out.with_more(sieve.left_out)
        return found

    def _free(self, group: PoseGroup) -> list[int]:
        """Places of the joints that are not locked."""
        model = self.problem.model
        return [*postures.sensed_joints(model), *map(model.joints.index, group.moves)]

    def refined(self, values: Mapping[str, float], rng: np.random.Generator, rounds: int,
                steps: int = STEPS) -> Sized | None:
        """Better sizes and poses near by in some rounds, without any the best poses; None where no postures close."""
        best: Sized | None = None
        near, moved = dict(values), None
        for k in range(rounds + 1):
            found = self.postures(near, MANY, rng)
            if moved is not None:
                found = [np.concatenate(pair) for pair in zip(moved, found, strict=True)]
            least = min(map(len, found))
            if least < SUPPORT:
                break
            support = self.support(near, np.array([each[:least] for each in found]))
            if best is None or support.worst < best.worst:
                best = support
            if k < rounds:
                near, q = self.program.solve(support.values, support.q, support.share, steps)
                moved = [self.closed(near, *each, NEARLY) for each in zip(self.problem.groups, q, strict=True)]
        return best

    def closed(self, values: Mapping[str, float], group: PoseGroup, q: Array, aside: float = 1.0) -> Array:
        """Of postures (N, n) of a group that nearly close, those (K, n) that can be closed within all limits."""
        model, fixture = self.problem.model, fixture_of(self.machine)
        geometry = self.program.theta(values)[: len(model.parameters)]
        place = np.array([values[f"{fixture}.{axis}"] for axis in "xyz"])
        closed, good = postures.close(model, geometry, q, postures.sensed_joints(model), place)
        return self._fitting(values, group, closed[good], aside)

    def about(self, sized: Sized, count: int, rng: np.random.Generator) -> list[Array]:
        """Closed postures (K, n) of each group about those of a design, of each so many of `count` as its share says:
        a posture that counts much is measured often, each time a little elsewhere."""
        found = []
        for group, q, share in zip(self.problem.groups, sized.q, sized.share, strict=True):
            free, parts = self._free(group), []
            for middle, wanted in zip(q, np.ceil(count * share).astype(int).tolist(), strict=True):
                some = np.repeat(middle[None], 1 + DENSE * wanted, axis=0)
                some[1:, free] += rng.normal(0.0, ABOUT, (DENSE * wanted, len(free)))
                parts.append(self.closed(sized.values, group, some, 0.0)[: 1 + wanted])
            found.append(np.concatenate(parts))
        return found

    def support(self, values: Mapping[str, float], q: Array) -> Sized:
        """The postures (G, m, n) of many (G, C, n) that count most, with their shares."""
        shares = self.program.shares(values, q, 150)
        most = np.argsort(-shares.share, axis=1)[:, :SUPPORT]
        share = np.take_along_axis(shares.share, most, axis=1)
        return Sized(dict(values), np.take_along_axis(q, most[:, :, None], axis=1),
                     share / share.sum(axis=1, keepdims=True), float(0.5 * np.log(np.max(shares.variance))))
