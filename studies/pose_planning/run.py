"""CAT 215B: planned poses against thesis-like sweeps, random poses, and planned ones within the sweeps' ranges."""

import math
import time

import numpy as np

from hydroopt import load_machine, solve
from hydroopt.excitation.selection.candidate_postures import Sieve
from hydroopt.excitation.selection.pose_problem import PoseProblem, expected_uncertainty, pose_problem
from hydroopt.limits.reserves import Reserves
from hydroopt.model.closed_chain import KinematicModel
from studies import closed_postures

POSES, FINE = 120, 1200
SWEEPS = {"stick_moves": (60, 115), "boom_moves": (-48, -8), "swing_moves": (-30, 30)}
"""Ranges [deg], assumed: Figures 16 to 18 are missing from the source. Those of the study cat215b_calibration."""
NOWHERE = {"ground": None, "footprint": None, "workspace": None}
"""Sweeps and random postures ask for none of these, and neither do the plans that are compared with them."""
LENGTHS = ("swing.a", "boom.a", "boom.d", "stick.a", "ball.x", "ball.z")


def with_drift(machine, degrees):
    """The machine with a drift of locked joints as a nuisance."""
    stages = tuple(stage.model_copy(update={"drift": math.radians(degrees)}) for stage in machine.stages)
    return machine.model_copy(update={"stages": stages})


def angles_only(machine):
    """The machine without the length transducers of its cylinders, which the thesis does not read."""
    return machine.model_copy(update={"sensors": tuple(
        sensor for sensor in machine.sensors if not sensor.channels[0].endswith(".length"))})


def sweeps(model, count: int = POSES) -> np.ndarray:
    """Every moving joint out and back, twice; the calibrator follows by least motion."""
    out_and_back = np.sin(np.linspace(0, 4 * np.pi, count))[:, None]
    return closed(model, lambda stage, **where: closed_postures.sweep(
        model, stage, np.radians(np.mean(SWEEPS[stage.name]) + np.ptp(SWEEPS[stage.name]) / 2 * out_and_back), **where))


def kept_sweeps(problem: PoseProblem) -> np.ndarray:
    """As many postures of a finer sweep, evenly among those that keep the reserves."""
    made = []
    for group, q in zip(problem.groups, np.split(sweeps(problem.model, FINE), len(problem.groups)), strict=True):
        kept = Sieve(problem.limits, group)(q, problem.model.parameters.nominal)
        made.append(kept[np.linspace(0, len(kept) - 1, POSES).astype(int)])
    return np.concatenate(made)


def narrowed(machine):
    """The machine whose joints move as far as in the sweeps, and no farther."""
    ranges = {stage.moves[0]: np.radians(SWEEPS[stage.name]).tolist() for stage in machine.stages}
    links = []
    for link in machine.links:
        low, high = ranges.get(link.name, link.joint.range)
        links.append(link.model_copy(update={"joint": link.joint.model_copy(update={"lower": low, "upper": high})}))
    return machine.model_copy(update={"links": tuple(links)})


def random(model) -> np.ndarray:
    """As many random postures within the limits."""
    return closed(model, lambda stage, **where: closed_postures.random_postures(model, stage, POSES, **where))


def closed(model, postures_of) -> np.ndarray:
    where = {"geometry": model.parameters.nominal, "fixture": np.array(model.machine.fixtures[0].position)}
    return np.concatenate([postures_of(stage, **where) for stage in model.machine.stages])


def run() -> dict:
    """Expected standard deviations [mm] of all lengths, and how many times less they are by planning."""
    results: dict = {}
    for case, degrees in (("", 0.0), ("_with_drift", 0.3)):
        limited = with_drift(angles_only(load_machine("cat215b")), degrees)
        machine = limited.model_copy(update=NOWHERE)
        model = KinematicModel(machine)
        fixed = {"ball.y": 0.0} | {name: float(value) for name, value in zip(
            model.parameters.names, model.parameters.nominal, strict=True) if "cylinder" in name}
        began = time.perf_counter()
        plan = solve(pose_problem(machine, POSES, fixed=fixed, reserves=Reserves.none()))
        took = time.perf_counter() - began
        labels = plan.stage, plan.fixture
        std = {"planned": dict(zip(plan.names, plan.std, strict=True))}
        within = solve(pose_problem(narrowed(machine), POSES, fixed=fixed, reserves=Reserves.none())).q
        safe = solve(pose_problem(limited, POSES, fixed=fixed))
        for way, q in (("sweep", sweeps(model)), ("random", random(model)), ("within", within),
                       ("kept_sweep", kept_sweeps(safe.problem)), ("safe", safe.q)):
            seen = expected_uncertainty(machine, q, *labels, fixed=fixed)
            std[way] = dict(zip(seen.names, seen.std, strict=True))
        ratio = {way: min(float(std["kept_sweep" if way == "safe" else "sweep"][name] / values[name])
                          for name in LENGTHS) for way, values in std.items()}
        default = min(float(std["sweep"][name] / std["safe"][name]) for name in LENGTHS)
        results |= {f"worst_length_ratio{case}": round(ratio["planned"], 2),
                    f"worst_random_ratio{case}": round(ratio["random"], 2),
                    f"worst_within_ratio{case}": round(ratio["within"], 2),
                    f"worst_ratio_with_reserves{case}": round(ratio["safe"], 2),
                    f"worst_ratio_of_default_plan{case}": round(default, 2), f"plan_seconds{case}": round(took, 1)}
        results |= {f"{way}_a1_mm{case}": round(1e3 * float(std[way]["swing.a"]), 2) for way in std}
        results |= {f"{way}_std_mm{case}": {name: round(1e3 * float(std[way][name]), 2) for name in LENGTHS}
                    for way in std}
    return results
