"""A calibrator designed for the CAT 215B against the thesis's, at equal sensors and numbers of poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import hydroopt
from hydroopt import KinematicModel, calibration_problem, load_machine
from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.calibrate import optimum
from hydroopt.estimation.kinematic.observability import linearise, observability
from hydroopt.excitation.calibrator.calibrator_design import CalibratorDesign
from hydroopt.excitation.calibrator.construction import BRACKET, Construction, carrying
from hydroopt.excitation.calibrator.design import design_calibrator, planned, search_of
from hydroopt.excitation.calibrator.problem import CalibratorProblem
from hydroopt.excitation.calibrator.program import JointProgram
from hydroopt.excitation.calibrator.search import ROUNDS
from hydroopt.excitation.poses.problem import linearised
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
    search, rng = search_of(problem, construction), np.random.default_rng(0)
    search.program = JointProgram(search.problem, (), dict(problem.length_std), problem.workshop.clearance)
    sized = search.refined(THESIS, rng, ROUNDS)
    assert sized is not None
    found = planned(problem, construction, sized, (), rng, 0)
    assert found is not None
    return found


def again(design: CalibratorDesign, **errors: float) -> CalibratorDesign:
    """The same calibrator and poses, where its numbers are known to these errors only."""
    workshop = replace(design.workshop, **errors)
    machine = carrying(angles_alone(), design.construction, design.values, workshop, KEPT)
    problem = replace(design.problem, machine=machine)
    return replace(design, problem=problem, workshop=workshop,
                   observability=observability(*linearised(problem, design.q, design.labels)))


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
    wide = {"span": float(np.radians(220.0))}
    first = of_thesis(problem_of(None, **wide))
    asked = dict(first.length_deviations)
    thesis = of_thesis(problem_of(asked, **wide))
    asked = {name: min(std, thesis.length_deviations[name]) for name, std in asked.items()}
    design = design_calibrator(replace(problem_of(asked), least=True), starts=2)
    result: dict = {}
    for name, std in design.length_deviations.items():
        result |= {f"thesis_mm_{name}": round(1e3 * asked[name], 2), f"designed_mm_{name}": round(1e3 * std, 2)}
    result["least_ratio"] = round(min(asked[name] / std for name, std in design.length_deviations.items()), 2)
    built, old = again(design, **ERRORS), again(thesis, **ERRORS)
    ratios = [old.length_deviations[name] / std for name, std in built.length_deviations.items()]
    result["least_ratio_with_own_errors"] = round(min(ratios), 2)
    result |= {f"with_own_errors_mm_{name}": round(1e3 * std, 2) for name, std in built.length_deviations.items()}
    result["dearest_own_error"] = f"{built.own_errors[0].name} {built.own_errors[0].factor:.2f}"
    twice = again(design, **{name: 2 * each for name, each in ERRORS.items()}).machine
    for case, one, machine, true in (("exact", design, design.machine, design.machine),
                                     ("own_errors", built, built.machine, built.machine),
                                     ("twice_as_inaccurate", built, built.machine, twice)):
        over, coverage, missed = estimated(one, machine, true)
        result |= {f"achieved_over_expected_{case}": round(max(over.values()), 3),
                   f"least_achieved_over_expected_{case}": round(min(over.values()), 3),
                   f"coverage_{case}": round(coverage, 3), f"not_reached_{case}": missed}
    result["parts"] = {part["name"]: [round(float(np.degrees(part["theta"])), 1), part["d"], part["a"],
                                      round(float(np.degrees(part["alpha"])))] for part in design.parts}
    result["ball"] = list(design.ball)
    return result
