"""Which joints give way under gravity, chosen by how well poses are predicted that took no part in the calibration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.initial_guesses import guess_unsensed
from hydroopt.estimation.kinematic.observability import linearise, observability
from hydroopt.estimation.kinematic.optimum import optimum, solvable
from hydroopt.estimation.kinematic.problem import CalibrationProblem, calibration_problem
from hydroopt.estimation.kinematic.residuals import predicted
from hydroopt.estimation.kinematic.solution import JOINT
from hydroopt.logs.poses import Poses
from hydroopt.machine.calibrated_numbers import standing_for
from hydroopt.machine.links import Link, Note
from hydroopt.machine.machine import Machine
from hydroopt.results.readable import readable
from hydroopt.results.tables import number
from hydroopt.spatial.inertia import Array

LARGEST = 1.0
"""Deflection [rad, m] that no joint has: poses that show only larger ones show none."""
CLEAR = 2.0
"""Standard errors by which errors of held-out poses must lie along what one more compliant joint changes."""
RULE = ("Joints are taken in one after the other, the one first that lowers the squared errors of held-out poses most, "
        f"as long as they fall and the evidence is above {CLEAR:g} standard errors.")


@dataclass(frozen=True)
class ComplianceCandidate:
    """Joints that give way, and the squared error of held-out poses (mean per row, in σ²; noise alone gives at most 1).

    `difference` is that from the set that was chosen before, `evidence` how clearly held-out poses show the joint that
    was added, in standard errors.
    """

    joints: tuple[str, ...]
    held_out: float
    difference: float
    evidence: float
    chosen: bool


@dataclass(frozen=True)
class ComplianceChoice:
    """The sets of compliant joints that were tried, in their order; the last that is `chosen` holds.

    Attributes:
        candidates: the sets.
        detectable: by how much each joint must give way at most [rad, m] to be found with a probability of 95 %;
            infinite where it never is. `units` are those of the joints.
    """

    candidates: tuple[ComplianceCandidate, ...]
    detectable: Mapping[str, float]
    units: Mapping[str, str]

    @property
    def joints(self) -> tuple[str, ...]:
        """Those that give way."""
        return [each for each in self.candidates if each.chosen][-1].joints

    def as_dict(self) -> dict[str, Any]:
        """The entry ``compliance_choice`` of estimate.json."""
        return {"rule": RULE, "joints": list(self.joints), "candidates": [
            {"joints": list(each.joints), "held_out": number(each.held_out), "difference": number(each.difference),
             "evidence": number(each.evidence), "chosen": each.chosen} for each in self.candidates],
             "detectable_sag": {joint: number(sag) for joint, sag in self.detectable.items()}}

    def __str__(self) -> str:
        names = [", ".join(each.joints) or "none" for each in self.candidates]
        width = max(map(len, ("compliant", *names)))
        lines = [f"  {'compliant':<{width}}  held-out [σ²]  difference  evidence"]
        for name, each in zip(names, self.candidates, strict=True):
            change = "" if each is self.candidates[0] else f"{each.difference:+10.4f}  {each.evidence:8.1f}"
            lines.append(f"{'*' if each.chosen else ' '} {name:<{width}}  {each.held_out:>13.4f}  {change}")
        shown = ", ".join(f"{joint} from {readable(sag, self.units[joint])}" if sag < LARGEST else f"{joint} never"
                          for joint, sag in self.detectable.items())
        return "\n".join([*lines, RULE, "Deflections that would show in these poses with a probability of 95 %: "
                          f"{shown}."])


FOLDS = 4
"""Parts of the poses, each of which is predicted from the others."""
ROUNDING = 1e-6
"""Change of a prediction in standard deviations of an error that is none."""
SHOWN = (CLEAR + 1.645) / np.sqrt(1 - 1 / FOLDS)
"""Standard deviations of a compliance by which it is above `CLEAR` standard errors with a probability of 95 %, where
each part of the poses is predicted from the others."""
LARGEST_SAG = {"rad": np.radians(0.5), "m": 5e-3}
"""Standard deviation of a joint's deflection at its largest torque or force, where the file states no compliance."""

def with_compliance(machine: Machine, sigmas: Mapping[str, float]) -> Machine:
    """The machine in which these joints give way, by compliances with these standard deviations [rad/(N·m), m/N], and
    no others; a compliance of the file keeps its value."""
    data = machine.model_dump()
    notes, units = dict(machine.notes), {link.name: link for link in _moving(machine)}
    for link in (*data["links"], *(data["calibrator"]["links"] if machine.calibrator else ())):
        name = link["name"]
        path = f"{name}.joint.compliance"
        if name not in sigmas:
            if name in units:
                link["joint"]["compliance"] = None
            notes.pop(path, None)
        else:
            link["joint"]["compliance"] = units[name].joint.compliance or 0.0
            notes[path] = notes.get(path, Note()).model_copy(update={"sigma": sigmas[name], "relative": False})
    return standing_for(Machine.model_validate(data | {"notes": notes}), machine)


def choose_compliance(machine: Machine, poses: Poses) -> ComplianceChoice:
    """The joints of machine and calibrator whose compliance predicts held-out poses better.

    Args:
        machine: with masses; joints whose compliance it states are judged like the others.
        poses: each stage is parted into four; each part is predicted from the other three.

    Raises:
        ProblemError: gravity loads no joint by the machine file's masses, or there are too few poses.

    >>> from hydroopt import KinematicModel, load_machine, pose_problem, solve
    >>> from hydroopt.simulation.pose_table import simulate_poses
    >>> machine = load_machine("panda_mukca")
    >>> plan = solve(pose_problem(machine, 20), candidates=50)
    >>> poses = simulate_poses(KinematicModel(machine), plan.postures, seed=0).poses
    >>> choose_compliance(machine, poses).candidates[0].joints
    ()
    """
    sigmas = dict(_sigmas(calibration_problem(machine, poses)))
    if not sigmas:
        raise ProblemError("gravity loads no joint by the masses of the machine file, so that no compliance shows",
                           where=f"machine '{machine.name}'", remedy="state the bodies of its links")
    part = np.zeros(len(poses), dtype=int)
    for stage in np.unique(poses.stage):
        own = np.flatnonzero(poses.stage == stage)
        part[own] = np.arange(len(own)) % FOLDS
    if np.bincount(part, minlength=FOLDS).min() < 1:
        raise ProblemError(f"{len(poses)} poses are too few to hold a part of them out", where="--compliance",
                           remedy=f"measure {FOLDS} or more in each stage")

    def errors(joints: Sequence[str]) -> list[Array]:
        return _held_out(with_compliance(machine, {joint: sigmas[joint] for joint in joints}), poses, part)

    chosen: tuple[str, ...] = ()
    best = errors(chosen)
    found = [ComplianceCandidate((), _mean_square(best), 0.0, 0.0, chosen=True)]
    while left := [joint for joint in sigmas if joint not in chosen]:
        tried = {joint: errors((*chosen, joint)) for joint in left}
        joint = min(tried, key=lambda name: _mean_square(tried[name]))
        square = _mean_square(tried[joint])
        change, evidence = square - _mean_square(best), _evidence(best, tried[joint])
        better = change < 0 and evidence > CLEAR
        found.append(ComplianceCandidate((*chosen, joint), square, change, evidence, chosen=better))
        if not better:
            break
        chosen, best = (*chosen, joint), tried[joint]
    return ComplianceChoice(tuple(found), {joint: detectable_sag(machine, poses, joint) for joint in sigmas},
                            {joint: machine.channel_units[f"{joint}.q"] for joint in sigmas})


def compliant(machine: Machine, poses: Poses, joints: Sequence[str]) -> Machine:
    """The machine in which these joints give way, and no others.

    Raises:
        ProblemError: gravity does not load one of them in the poses.
    """
    sigmas = dict(_sigmas(calibration_problem(machine, poses)))
    if unknown := [joint for joint in joints if joint not in sigmas]:
        raise ProblemError(f"gravity loads no joint '{unknown[0]}' in the poses, by the masses of the machine file",
                           where="--compliance", remedy=f"use auto, none, or some of {', '.join(sigmas)}" if sigmas else
                           "state the bodies of its links")
    return with_compliance(machine, {joint: sigmas[joint] for joint in joints})


def _moving(machine: Machine) -> Iterator[Link]:
    links = (*machine.links, *(machine.calibrator.links if machine.calibrator else ()))
    yield from (link for link in links if link.joint.moving)


def _loads(problem: CalibrationProblem) -> Iterator[tuple[str, float]]:
    """Joints that gravity loads in the poses, and their largest torques or forces [N·m, N]."""
    model, theta = problem.model, problem.start
    q = problem.angles(theta, guess_unsensed(problem, theta))
    torque = np.abs(model.over(model.gravity_torque, theta[: len(model.parameters)], q)[0][:, :, 0])
    for k, joint in enumerate(model.joints):
        largest = float(np.max(torque[:, k], initial=0.0))
        if f"{joint}.compliance" in problem.parameters.names or largest > 1e-6 * float(np.max(torque, initial=0.0)) > 0:
            yield joint, largest


def _sigmas(problem: CalibrationProblem) -> Iterator[tuple[str, float]]:
    """Joints that gravity loads in the poses, and the standard deviations of their compliances."""
    parameters = problem.parameters
    for joint, largest in _loads(problem):
        name, unit = f"{joint}.compliance", problem.model.machine.channel_units[f"{joint}.q"]
        yield joint, float(parameters.scale[parameters.index(name)]) if name in parameters.names else (
            LARGEST_SAG[unit] / largest)


def detectable_sag(machine: Machine, poses: Poses, joint: str) -> float:
    """By how much a joint must give way at most [rad, m] to be found with a probability of 95 %: `SHOWN` standard
    deviations of its compliance by the Cramér-Rao bound, without what the file states of it, times the largest torque.

    It is large where the joint is not read while it moves, since its angle then takes up the sag.

    >>> from hydroopt import KinematicModel, load_machine, pose_problem, solve
    >>> from hydroopt.simulation.pose_table import simulate_poses
    >>> machine = load_machine("cat215b")
    >>> plan = solve(pose_problem(machine, 20, priors=True), candidates=40)
    >>> poses = simulate_poses(KinematicModel(machine), plan.postures, seed=0).poses
    >>> detectable_sag(machine, poses, "boom") > 5 * detectable_sag(machine, poses, "stick")
    True
    """
    stated = calibration_problem(machine, poses)
    loads, sigma = dict(_loads(stated)), dict(_sigmas(stated))[joint]
    problem = solvable(calibration_problem(with_compliance(machine, {joint: sigma}), poses), JOINT)
    found = optimum(problem, JOINT, problem.start)
    identified = observability(problem, linearise(problem, found.theta, found.q))
    name = f"{joint}.compliance"
    if name not in identified.names:
        return float("inf")
    information = identified.std[identified.names.index(name)] ** -2.0 - (sigma**-2.0 if problem.priors else 0.0)
    return float(SHOWN * loads[joint] / np.sqrt(information)) if information > 0 else float("inf")


def _held_out(machine: Machine, poses: Poses, part: NDArray[np.intp]) -> list[Array]:
    """Whitened errors (n, m) of the n poses of each part, predicted from the other parts; a pose's squares add up to 1
    where they are noise alone."""
    found = []
    for k in range(FOLDS):
        aside = part == k
        problem = solvable(calibration_problem(machine, poses.select(~aside)), JOINT)
        theta = optimum(problem, JOINT, problem.start).theta
        rows = linearise(*predicted(problem, theta, poses.select(aside)))
        found.append(rows.residual / np.sqrt(np.maximum(rows.rank, 1))[:, None])
    return found


def _mean_square(errors: Sequence[Array]) -> float:
    return float(np.mean(np.concatenate([np.sum(part**2, axis=1) for part in errors])))


def _evidence(stiff: Sequence[Array], soft: Sequence[Array]) -> float:
    """By how many standard errors the errors of held-out poses lie along what one more joint changes of them.

    If it does not give way, what it changes was learned from other poses and is independent of these errors, so that
    the products of both are zero on average. Squared errors grow even then by that change: without it, their
    difference is the test of nested models by Clark and West (2007), which shows sags half as large.
    """
    changes = [a - b for a, b in zip(stiff, soft, strict=True)]
    if max(float(np.max(np.abs(change))) for change in changes) < ROUNDING:
        return 0.0  # stiff wherever it was learned
    along = np.concatenate([np.sum(a * change, axis=1) for a, change in zip(stiff, changes, strict=True)])
    return float(np.mean(along) / (np.std(along, ddof=1) / np.sqrt(len(along))))
