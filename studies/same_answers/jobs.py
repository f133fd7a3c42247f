"""The jobs: each returns the most probable values, the standard deviations and the status that a user would get.

Logs are simulated with the machine file's own noise, or read from data that ship. A job is a name and a function
without arguments; a design returns its criterion instead of values.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import hydroopt as ho
from hydroopt.excitation.motion.basis import Fourier
from hydroopt.simulation.pose_table import simulate_poses

DATA = Path(__file__).parents[2] / "data"
LOWER_IS_BETTER = "criterion"
"""Name of the only value of a design."""
Answer = dict[str, Any]


@cache
def log(machine: str, seed: int = 1, *, duration: float = 20.0, rate: float = 50.0) -> ho.Log:
    """A simulated log of a machine whose true parameters are drawn from the file's standard deviations."""
    model = ho.Model(ho.load_machine(machine))
    try:
        truth = ho.random_truth(model, seed=1)
    except ho.HydrooptError:  # shapes, symmetries or total masses are stated, which draws do not satisfy
        truth = None
    motion = ho.random_trajectory(model, duration=duration, rate=rate, seed=seed)
    return ho.simulate(model, motion, truth, seed=seed)


def identified(problem: Any, method: str = "sdp", **options: Any) -> Answer:
    """The most probable point, and intervals from the posterior's samples where the method has them."""
    if method in ("wls", "ridge", "tsvd"):
        answer = ho.solve(problem, method, **options)
        rows = answer.base_parameters
        return {"value": [row["value"] for row in rows], "std": [row["std"] for row in rows], "status": answer.status}
    point = ho.solve(problem, method, intervals=False, **options)
    answer = ho.solve(problem, method, **options)
    return {"value": point.psi, "std": [row.std for row in answer.parameters.values()], "status": answer.status}


def _of_machine(name: str) -> Answer:
    return identified(ho.identification_problem(name, log(name)))


def _cat(change: Callable[[Any], Any] = lambda problem: problem, method: str = "sdp", **options: Any) -> Answer:
    return identified(change(ho.identification_problem("cat215b", log("cat215b"))), method, **options)


def _streamed(rows: int) -> Answer:
    path = Path("same_answers.csv")
    log("cat215b", 4, duration=rows / 50).write(path)
    try:
        return identified(ho.identification_problem("cat215b", ho.read_log(path)))
    finally:
        path.unlink()


def _kr300(**options: Any) -> Answer:
    run = ho.read_log(DATA / "kr300" / "run_A.mat", mapping=DATA / "kr300" / "map.toml")
    return identified(ho.identification_problem("kr300", run), **options)


def _tables(answer: Any) -> Answer:
    rows = list(answer.parameters.values())
    return {"value": [row.value for row in rows], "std": [row.std for row in rows], "status": answer.status}


def _combined(machine: str) -> Answer:
    return _tables(ho.solve(ho.combined_problem(machine, log(machine)), intervals=False))


@cache
def poses(machine: str) -> ho.Poses:
    """A simulated pose table of a random geometry at planned postures."""
    plan = ho.solve(ho.pose_problem(machine, 25), seed=1)
    return simulate_poses(ho.KinematicModel(ho.load_machine(machine)), plan.postures, random=True, seed=1).poses


def _calibrated(machine: str, loss: str = "squares") -> Answer:
    return _tables(ho.solve(ho.calibration_problem(machine, poses(machine)).with_loss(loss)))


def _mukca(*places: str) -> Answer:
    folder = DATA / "mukca_panda_2"
    files = [file for place in places for file in sorted((folder / place).glob("*.csv"))]
    table = ho.read_pose_files(files, mapping=folder / "map.toml")
    return _tables(ho.solve(ho.calibration_problem("panda_mukca", table)))


def _sensors() -> Answer:
    return _tables(ho.solve(ho.sensor_problem("excavator_imu", log("excavator_imu", duration=10))))


def _valves() -> Answer:
    model = ho.Model("patu655_lift")
    motion = ho.random_trajectory(model, duration=20, rate=50, seed=1, fastest=0.06)
    plant = ho.Plant(model)
    driven = ho.drive(plant, motion.t, ho.commands_for(plant, motion), motion.q[0], seed=1)
    return _tables(ho.solve(ho.hydraulic_problem("patu655_lift", driven)))


def _motion(machine: str, criterion: str) -> Answer:
    problem = ho.excitation_problem(machine, Fourier(10.0, 3), criterion=criterion)
    motion = ho.solve(problem, starts=2, seed=0)
    return {LOWER_IS_BETTER: motion.details()["value"], "status": motion.status}


def _poses(machine: str) -> Answer:
    plan = ho.solve(ho.pose_problem(machine, 20), seed=0)
    return {LOWER_IS_BETTER: -plan.log_det / len(plan.parameters), "status": plan.status}


def _changes() -> Answer:
    found = ho.compare("cat215b", [log("cat215b", seed) for seed in (1, 2, 3)])
    return {"value": [row.p_value for row in found.differences], "std": [1.0] * len(found.differences),
            "status": found.status}


def _weighed() -> Answer:
    load = ho.CarriedLoad("lift", (3.0, 0.0, 0.0), (0.05, 0.05, 0.05), full_scale=1000.0)
    scale = ho.scale(ho.Model("patu655_lift"), log("patu655_lift", 1, duration=30), load)
    found = ho.weigh(scale.on_slope(*scale.tilt), log("patu655_lift", 2, duration=30))
    read = [each.weighed for each in found.readings]
    return {"value": [each.mass for each in read], "std": [each.mass_std for each in read], "status": found.status}


def jobs() -> Iterator[tuple[str, Callable[[], Answer]]]:
    """All jobs by name."""
    for name in ho.bundled():
        yield f"identify {name}", partial(_of_machine, name)
    for method in ("qp", "nlp", "wls", "ridge", "tsvd"):
        yield f"identify cat215b {method}", partial(_cat, method=method)
    changes: dict[str, Callable[[Any], Any]] = {
        "huber": lambda p: p.with_loss("huber"), "student_t": lambda p: p.with_loss("student_t"),
        "log-det": lambda p: p.with_distance("log-det"), "correlated": lambda p: p.with_correlated_channels(),
        "fitted motion": lambda p: p.with_fitted_motion(),
        "constraint": lambda p: p.subject_to("stick is lighter", "stick.m <= boom.m"),
        "prior": lambda p: p.with_prior("arm", "boom.m + stick.m", value=2600, sigma=20),
        "free delay": lambda p: p.free("delay"), "fix": lambda p: p.fix("boom.m")}
    for name, change in changes.items():
        yield f"identify cat215b {name}", partial(_cat, change)
    for smoothing in (ho.SmoothingSpline(2.0), ho.Butterworth(2.0), ho.Fourier(20.0, 10)):
        yield f"identify cat215b {type(smoothing).__name__}", lambda smoothing=smoothing: identified(
            ho.identification_problem("cat215b", log("cat215b"), smoothing=smoothing))
    yield "identify cat215b three logs", lambda: identified(
        ho.identification_problem("cat215b", [log("cat215b", seed) for seed in (1, 2, 3)]))
    for rows in (10**3, 10**5):
        yield f"identify cat215b streamed {rows}", partial(_streamed, rows)
    yield "identify kr300 run A", _kr300
    yield "identify kr300 run A wls", partial(_kr300, method="wls")
    for machine in ("cat215b", "wheel_loader", "mini_excavator"):
        yield f"identify with geometry {machine}", partial(_combined, machine)
    for machine in ("cat215b", "panda_mukca", "excavator_bucket", "forestry_crane", "wheel_loader"):
        yield f"calibrate {machine}", partial(_calibrated, machine)
    yield "calibrate cat215b student_t", partial(_calibrated, "cat215b", loss="student_t")
    yield "calibrate panda_mukca data", partial(_mukca, "back_left", "front_right", "mid_left", "mid-high")
    yield "calibrate panda_mukca data with high", partial(_mukca, "back_left", "front_right", "high")
    yield "calibrate sensors", _sensors
    yield "valves", _valves
    for machine, criterion in (("cat215b", "D"), ("patu655_lift", "A"), ("patu655_lift", "E"), ("wheel_loader", "D")):
        yield f"excite {machine} {criterion}", partial(_motion, machine, criterion)
    for machine in ("cat215b", "panda_mukca"):
        yield f"plan poses {machine}", partial(_poses, machine)
    yield "compare cat215b", _changes
    yield "weigh patu655_lift", _weighed
