"""A calibrator designed for the CAT 215B against the thesis's, at equal sensors and numbers of poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import hydroopt
from hydroopt import KinematicModel, calibration_problem, load_machine
from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.calibration import optimum
from hydroopt.estimation.kinematic.observability import linearise, observability
from hydroopt.excitation.selection.calibrator_design import CalibratorDesign, design_calibrator, planned
from hydroopt.excitation.selection.calibrator_problem import BRACKET, CalibratorProblem, Construction, carrying
from hydroopt.excitation.selection.calibrator_sizing import ROUNDS, Sizing
from hydroopt.machine.machine import Machine
from hydroopt.simulation.pose_table import simulate_poses

POSES, DRAWS = 120, 40
KEPT = ("grapple_swing", "grapple")
SITE = ((1.9, 0.0, -1.4), (4.0, 0.0, -0.3))
"""Where the ball may stand [m]: beyond the tracks, on a post of at most 1.4 m."""
ERRORS = {"length_error": 5e-4, "angle_error": float(np.radians(0.02))}
"""To which a calibrator is known that was measured after assembly."""
THESIS = {f"{BRACKET}.theta": 0.0, f"{BRACKET}.d": 0.0, f"{BRACKET}.a": 0.0, f"{BRACKET}.alpha": 0.0,
          "calibrator_1.theta": 0.0, "calibrator_1.d": 0.0, "calibrator_1.a": 0.0, "calibrator_1.alpha": np.pi / 2,
          "calibrator_2.theta": 0.0, "calibrator_2.d": -2.994, "calibrator_2.a": 0.0, "calibrator_2.alpha": np.pi / 2,
          "calibrator_3.theta": float(np.radians(30.7)), "calibrator_3.d": -0.082, "calibrator_3.a": 3.505,
          "ball.x": 2.16, "ball.y": 0.0, "ball.z": -0.84}
"""Yoke, upper arm and forearm of Table 2. Their twists of -90 and 90 degrees are written as 90 and 90, which turns the
senses of the last two joints; the zero of the last is the middle of the file's range."""


def angles_alone() -> Machine:
    """The machine without the transducers of its cylinders, which the thesis does not read."""
    machine = load_machine("cat215b")
    return machine.model_copy(update={"sensors": tuple(
        sensor for sensor in machine.sensors if not sensor.channels[0].endswith(".length"))})


def problem_of(asked: dict[str, float] | None, **workshop: object) -> CalibratorProblem:
    """Three links with sensors behind the grapple, which has one: as many as in the thesis."""
    problem = hydroopt.calibrator_problem(angles_alone(), POSES, links=(3, 3), keep=KEPT)
    usual = replace(problem.workshop, site=SITE, **workshop)
    return replace(problem, workshop=usual, length_std=asked or problem.length_std)


def of_thesis(problem: CalibratorProblem) -> CalibratorDesign:
    """The thesis's calibrator, whose joints all turn as far as its farthest, with poses optimised by the same means."""
    construction = Construction((False, True, True), (problem.sensors[0],) * 3)
    search, rng = Sizing(problem, construction), np.random.default_rng(0)
    search.sizes = ()
    sized = search.refined(THESIS, rng, ROUNDS)
    assert sized is not None
    found = planned(problem, construction, sized, (), rng, 0)
    assert found is not None
    return found


def both(**errors: float) -> tuple[dict[str, float], CalibratorDesign]:
    """Deviations [m] by length with the thesis's calibrator, the better ones of two optimisations of its poses, and the
    design, where calibrators are known to these errors."""
    wide = {"span": float(np.radians(220.0)), **errors}
    first = dict(of_thesis(problem_of(None, **wide)).length_deviations)
    second = of_thesis(problem_of(first, **wide)).length_deviations
    thesis = {name: min(std, second[name]) for name, std in first.items()}
    return thesis, design_calibrator(replace(problem_of(thesis, **errors), least=True), starts=2)


def less_exact(design: CalibratorDesign, factor: float) -> Machine:
    """Machine and calibrator, whose numbers are known to so many times the errors only."""
    workshop = replace(design.workshop, **{name: factor * each for name, each in ERRORS.items()})
    return carrying(angles_alone(), design.construction, design.values, workshop, KEPT)


def estimated(design: CalibratorDesign, machine: Machine, true: Machine) -> tuple[dict[str, float], float, int]:
    """Root of the mean square error over the deviation to expect, by length, of machines and calibrators drawn from
    the confidences of `true`, calibrated by the file of `machine`; the part of 95 % intervals that hold the truth; and
    how many of them do not reach a posture, and are left out.
    """
    errors, within = {name: [] for name in design.length_std}, []
    drawn, missed = KinematicModel(true), 0
    for draw in range(DRAWS):
        try:
            made = simulate_poses(drawn, design.postures, random=True, seed=draw)
        except ProblemError:  # the drawn machine does not reach a posture
            missed += 1
            continue
        problem = calibration_problem(machine, made.poses)
        found = optimum(problem, "joint", problem.start)
        std = dict(zip([name for name, free in zip(problem.parameters.names, problem.free, strict=True) if free],
                       observability(problem, linearise(problem, found.theta, found.q)).std, strict=True))
        for name, each in errors.items():
            k = problem.parameters.index(name)
            error = float(found.theta[k] - made.truth[name])
            each.append(error)
            within.append(abs(error) < 1.959964 * std[name])
    return ({name: float(np.sqrt(np.mean(np.square(each)))) / design.length_deviations[name]
             for name, each in errors.items()}, float(np.mean(within)), missed)


def run() -> dict:
    """Deviations of both calibrators, and what drawn machines and calibrators make of them."""
    result: dict = {}
    (thesis, design), (built_thesis, built) = both(), both(**ERRORS)
    for tail, asked, found in (("", thesis, design), ("_with_own_errors", built_thesis, built)):
        for name, std in found.length_deviations.items():
            result |= {f"thesis_mm_{name}{tail}": round(1e3 * asked[name], 2),
                       f"designed_mm_{name}{tail}": round(1e3 * std, 2)}
        result[f"least_ratio{tail}"] = round(min(asked[name] / std for name, std in found.length_deviations.items()), 2)
    result["dearest_own_error"] = f"{built.own_errors[0].name} {built.own_errors[0].factor:.2f}"
    for case, one, true in (("exact", design, design.machine), ("own_errors", built, built.machine),
                            ("twice_as_inaccurate", built, less_exact(built, 2.0))):
        over, coverage, missed = estimated(one, one.machine, true)
        result |= {f"achieved_over_expected_{case}": round(max(over.values()), 3),
                   f"least_achieved_over_expected_{case}": round(min(over.values()), 3),
                   f"coverage_{case}": round(coverage, 3), f"not_reached_{case}": missed}
    for tail, found in (("", design), ("_with_own_errors", built)):
        result[f"parts{tail}"] = {part["name"]: [round(float(np.degrees(part["theta"])), 1), part["d"], part["a"],
                                                 round(float(np.degrees(part["alpha"])))] for part in found.parts}
        result[f"ball{tail}"] = list(found.ball)
    return result
