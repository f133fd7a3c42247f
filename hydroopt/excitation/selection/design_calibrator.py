"""Designing a calibrator: constructions from the cheapest on, each sized from several starts, until one suffices."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.excitation.selection.calibrator_design import CalibratorDesign, Tried
from hydroopt.excitation.selection.calibrator_problem import CalibratorProblem
from hydroopt.excitation.selection.calibrator_program import Sized
from hydroopt.excitation.selection.calibrator_search import Search
from hydroopt.excitation.selection.candidate_postures import in_passes
from hydroopt.excitation.selection.construction import Construction, SensorOffer, carrying, fixture_of
from hydroopt.excitation.selection.exchange import best_poses
from hydroopt.excitation.selection.pose_problem import measured_along, pose_problem
from hydroopt.progress import Progress, silent

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


def design_calibrator(problem: CalibratorProblem, *, starts: int = 3, effort: float = 1.0, seed: int = 0,
                      progress: Progress = silent) -> CalibratorDesign:
    """The cheapest calibrator that suffices, or with `least` the best one of the most links, with its poses.

    Args:
        problem: what may be built, and how well lengths are to be known.
        starts: calibrators of each construction that are sized together with their poses.
        effort: part of the usual number of random calibrators and rounds.
        seed: of all random numbers.
        progress: receives the steps, see `hydroopt.progress`.

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
        search = search_of(problem, construction)
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


def search_of(problem: CalibratorProblem, construction: Construction) -> Search:
    """The sizes of one of its constructions."""
    return Search(problem.machine, construction, problem.workshop, problem.keep, problem.length_std, problem.count,
                  problem.fixed, problem.priors, problem.reserves)


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
            sensors: list[SensorOffer] = list(construction.sensors)
            sensors[joint] = offer
            other = construction._replace(sensors=tuple(sensors))
            search = search_of(problem, other)
            again = search.refined(sized.values, rng, 0)
            if again is not None:
                tried.append(_tried(problem, other, again))
                if again.worst <= math.log(MARGIN):
                    construction, sized = other, again
                    break
    return construction, sized


def planned(problem: CalibratorProblem, construction: Construction, sized: Sized, tried: tuple[Tried, ...],
             rng: np.random.Generator, seed: int) -> CalibratorDesign | None:
    """The calibrator in round numbers with whole numbers of poses; None where too few postures close."""
    search = search_of(problem, construction)
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
    shares = search.program.shares(values, q, 400)
    units = {name: target / math.sqrt(max(float(weight), 1e-6))
             for (name, target), weight in zip(problem.length_std.items(), shares.weight, strict=True)}
    drifts = any(group.drift for group in base.groups)  # these depend on the order, too
    return CalibratorDesign(
        base, least, seed, base.labels(problem.count), best_poses(base, q, units=units), search.left_out,
        construction, values,
        problem.workshop, problem.length_std, problem.least, problem.cost(construction), tried,
        math.nan if drifts else math.sqrt(shares.bound))


def _rounded(values: Mapping[str, float], search: Search) -> dict[str, float]:
    """Sizes in whole millimetres and tenths of a degree, the ball's place in whole centimetres."""
    fixture = fixture_of(search.machine)
    step = {size.name: 1e-2 if size.name.startswith(f"{fixture}.") else ROUNDED[size.unit] for size in search.sizes}
    return {name: round(value / step[name]) * step[name] if name in step else value for name, value in values.items()}
