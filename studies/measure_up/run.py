"""A measure-up by the fewest readings against joint-by-joint swings, and whether the planned accuracy comes true."""

import re
from pathlib import Path

import numpy as np

import hydroopt
from hydroopt import KinematicModel, calibration_problem, load_machine
from hydroopt.estimation.kinematic.accuracy import machine_end
from hydroopt.estimation.kinematic.calibration import optimum
from hydroopt.estimation.kinematic.observability import linearise, observability, spread
from hydroopt.excitation.selection.candidate_postures import Sieve
from hydroopt.excitation.selection.measure_up import MeasureUpPlan, fewest_readings, measure_up_problem
from hydroopt.excitation.selection.pose_problem import PoseProblem, Postures, pose_problem
from hydroopt.limits.reserves import DEFAULT, Reserves
from hydroopt.machine.machine import Machine
from hydroopt.simulation.pose_table import simulate_poses

MACHINE = Path(__file__).parents[2] / "docs" / "how-to" / "measure_up.toml"
STEPS = (3, 5, 12, 28)
"""Steps of each joint's swing: three are the fewest that tell a circle."""
DRAWS, POINTS = 60, 400
"""Machines drawn from the file's confidences; postures at which the tip is judged."""
REST = {"swing": 0.0, "boom": 0.2, "stick": -1.6, "bucket": -1.0}
"""Where the other joints stand [rad] while one is swung, and where they do so that swings keep more of the reserves."""
RAISED = REST | {"boom": 0.7, "stick": -1.0}


def workspace(model: KinematicModel) -> np.ndarray:
    """Postures (K, n), other than those that the plan judges by."""
    return np.random.default_rng(1).uniform(*model.ranges.T, (POINTS, len(model.joints)))


def swings(problem: PoseProblem, count: int, standing: dict[str, float]) -> np.ndarray:
    """Curl, crowd, lift and swing: every joint through so many equal steps, all others at rest (4·count, n)."""
    low, high = problem.model.ranges.T
    rest = np.array([standing[joint] for joint in problem.model.joints])
    made = []
    for k in range(len(rest)):
        q = np.repeat(rest[None], count, axis=0)
        q[:, k] = np.linspace(low[k] + 0.05 * (high - low)[k], high[k] - 0.05 * (high - low)[k], count)
        made.append(q)
    return np.concatenate(made)


def tip_std(machine: Machine, q: np.ndarray) -> float:
    """Of the tip [m] over the workspace, after the station has seen the edge in postures (N, n)."""
    problem = pose_problem(machine, len(q), priors=True)
    calibration = Postures(problem, q, np.zeros(len(q), dtype=int)).calibration
    seen = observability(calibration, linearise(calibration, calibration.parameters.nominal, q))
    _, function = machine_end(problem.model)
    by_g = problem.model.over(function, problem.model.parameters.nominal, workspace(problem.model))[1]
    return float(np.sqrt(np.mean(spread(problem.model, seen, by_g) ** 2)))


def edge_alone(machine: Machine) -> Machine:
    """The same machine where the station sees the bucket's edge alone, and there is no tape and no plate."""
    sensors = [each for each in machine.sensors if any(channel.endswith(".q") for channel in each.channels)]
    station = next(each for each in machine.sensors if "station.tip.x" in each.channels)
    own = station.model_copy(update={"channels": tuple(f"station.tip.{axis}" for axis in "xyz")})
    return machine.model_copy(update={"sensors": (*sensors, own), "datums": (), "distances": ()})


def achieved(plan: MeasureUpPlan, machine: Machine, true: Machine) -> tuple[float, float]:
    """RMS error of the tip [m] of machines drawn from the confidences of `true`, calibrated by the file of `machine`
    from the planned readings; and the part of 95 % intervals that contain the truth."""
    model = KinematicModel(machine)
    q, function = workspace(model), machine_end(model)[1]
    count, squares, within = len(model.parameters), [], []
    for draw in range(DRAWS):
        made = simulate_poses(KinematicModel(true), plan.postures, random=True, seed=draw)
        channels = {name: np.where(taken_of(plan, name), values, np.nan)
                    for name, values in made.poses.channels.items()}
        problem = calibration_problem(machine, hydroopt.Poses(
            name="measured", stage=made.poses.stage, fixture=made.poses.fixture, setup=made.poses.setup,
            channels=channels, units=made.poses.units))
        found = optimum(problem, "joint", problem.start)
        drawn = np.array([made.truth[name] for name in problem.parameters.names])
        tips = [model.over(function, theta[:count], q)[0][:, :, 0] for theta in (found.theta, drawn)]
        squares.append(np.mean(np.sum((tips[0] - tips[1]) ** 2, axis=1)))
        std = observability(problem, linearise(problem, found.theta, found.q)).std
        error = np.abs((found.theta - drawn)[problem.free])
        within.append((error < 1.959964 * std)[np.isfinite(std)])
    return float(np.sqrt(np.mean(squares))), float(np.mean(np.concatenate(within)))


def twice_as_far_off() -> Machine:
    """The machine whose file states every confidence twice as wide."""
    text = MACHINE.read_text("utf-8")
    return hydroopt.read_machine(re.sub(r'sigma = "([\d.]+)', lambda found: f'sigma = "{2 * float(found[1])}', text))


def taken_of(plan: MeasureUpPlan, channel: str) -> np.ndarray:
    """In which postures (N,) a channel is read."""
    for r, each in enumerate(plan.readings):
        if channel in each.channels:
            return plan.taken[:, r]
    return np.ones(len(plan.q), dtype=bool)


def kept_swings(problem: PoseProblem, count: int) -> np.ndarray:
    """Swings in so many steps (4·count, n), each over the part of its range that keeps the reserves."""
    sieve, many = Sieve(problem.limits, problem.groups[0]), 400
    made = []
    for one in np.split(swings(problem, many, RAISED), len(problem.model.joints)):
        kept = sieve(one, problem.model.parameters.nominal)
        made.append(kept[np.linspace(0, len(kept) - 1, count).astype(int)])
    return np.concatenate(made)


def compared(machine: Machine, q: np.ndarray, reserves: Reserves, ending: str) -> dict:
    """Readings for the accuracy that swings (N, n) give, and errors of drawn machines over the planned deviation."""
    alone = edge_alone(machine)
    target, name = tip_std(alone, q), f"{len(q)}_swings{ending}"
    plan = fewest_readings(measure_up_problem(machine, tip=target, reserves=reserves))
    own = fewest_readings(measure_up_problem(alone, tip=target, reserves=reserves))
    error, coverage = achieved(plan, machine, machine)
    wider, _ = achieved(plan, machine, twice_as_far_off())
    return {f"tip_mm_{name}": round(1e3 * target, 1), f"readings_{name}": plan.count,
            f"postures_{name}": len(plan.q), f"minutes_{name}": plan.minutes,
            f"fewer_{name}": round(len(q) / plan.count, 2), f"fewer_edge_alone_{name}": round(len(q) / own.count, 2),
            f"achieved_over_planned_{name}": round(error / plan.tip, 3), f"coverage_{name}": round(coverage, 3),
            f"achieved_over_planned_twice_as_far_off_{name}": round(wider / plan.tip, 3)}


def run() -> dict:
    """By number of steps: without ground and reserves, and with those that are kept by default."""
    machine, result = load_machine(MACHINE), {}
    bare = machine.model_copy(update={"ground": None})
    problem = pose_problem(edge_alone(bare), 1, priors=True)
    for steps in STEPS:
        result |= compared(bare, swings(problem, steps, REST), Reserves.none(), "")
    problem = pose_problem(edge_alone(machine), 1, priors=True)
    for steps in STEPS:
        result |= compared(machine, kept_swings(problem, steps), DEFAULT, "_with_reserves")
    return result
