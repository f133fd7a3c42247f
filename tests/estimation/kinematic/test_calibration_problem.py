"""The calibration as an optimisation model: it prints itself, and its program has the solver's optimum."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import hydroopt
from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.problem import CalibrationProblem, calibration_problem
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.simulation import postures
from studies import closed_postures

QUIET = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-10}


@pytest.fixture(scope="module")
def problem() -> CalibrationProblem:
    machine = load_machine("cat215b")
    model = KinematicModel(machine)
    away = np.random.default_rng(7).standard_normal(len(model.parameters)) * ["cylinder" not in name
                                                                             for name in model.parameters.names]
    geometry = model.parameters.nominal + 0.3 * away * model.parameters.scale
    fixture = np.array(machine.fixtures[0].position)
    q = [closed_postures.random_postures(model, stage, 8, geometry=geometry, fixture=fixture, seed=k)
         for k, stage in enumerate(machine.stages)]
    stages = [stage.name for stage in machine.stages for _ in range(8)]
    poses = postures.record(model, np.concatenate(q), stages, ["ball"] * len(stages), geometry=geometry, seed=1)
    return calibration_problem(machine, poses, fixed={"ball.y": 0.0})


@pytest.mark.slow
def test_the_program_has_the_same_optimum(problem: CalibrationProblem) -> None:
    solved = hydroopt.solve(problem)
    program = problem.nlp()
    assert len(program.x_names) == int(problem.free.sum()) + 24 * 5, "four angles are read, one moves"
    found = program.values(ca.nlpsol("solver", "ipopt", program.as_dict(), QUIET)(**program.arguments())["x"])
    for k, name in enumerate(problem.parameters.names):
        if problem.free[k]:
            assert abs(found[name] - solved.theta[k]) < 1e-4 * problem.parameters.scale[k], name
    yoke = problem.model.joints.index("yoke")
    assert found["pose 3: yoke.q"] == pytest.approx(solved.q[2, yoke], abs=1e-6)
    assert dict.fromkeys(program.g_names) == dict.fromkeys(f"pose {k + 1}: loop closure" for k in range(24))


@pytest.mark.slow
def test_a_constraint_of_the_user_holds(problem: CalibrationProblem) -> None:
    program, arguments = problem.nlp(), problem.nlp().arguments()
    free = hydroopt.solve(problem)
    total = free["boom.a"].value + free["stick.a"].value + 0.01
    g = ca.vertcat(program.g, program["boom.a"] + program["stick.a"])
    arguments |= {side: np.append(arguments[side], total) for side in ("lbg", "ubg")}
    found = program.values(ca.nlpsol("solver", "ipopt", {**program.as_dict(), "g": g}, QUIET)(**arguments)["x"])
    assert found["boom.a"] + found["stick.a"] == pytest.approx(total, abs=1e-8)


def test_the_problem_prints_itself(problem: CalibrationProblem) -> None:
    assert repr(problem) == f"<CalibrationProblem of cat215b: {int(problem.free.sum())} parameters from 24 poses>"
    text = str(problem)
    for part in ("calibration of cat215b: 24 poses", f"variables θ ({len(problem.parameters)})", "swing.a",
                 "120 angles of the poses", "readings of yoke.q", "priors of the machine file",
                 "loop closure: tip − fixture = 0 [m], 72 rows"):
        assert part in text
    assert "pose 1: loop closure" in str(problem.nlp())


def test_there_is_no_convex_program(problem: CalibrationProblem) -> None:
    with pytest.raises(ProblemError, match="not convex"):
        problem.cvxpy()
