"""What next against a fixed plan at equal minutes, and whether what is expected of it comes true on drawn machines."""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

import hydroopt
from hydroopt import KinematicModel, Model, Poses, calibration_problem
from hydroopt.errors import HydrooptError
from hydroopt.estimation.inference.identifiability import random_states
from hydroopt.estimation.kinematic.accuracy import machine_end
from hydroopt.estimation.kinematic.calibration import optimum
from hydroopt.excitation.selection.goals import LoadGoal
from hydroopt.excitation.selection.measurements import Addition, Measurement, equipped
from hydroopt.excitation.selection.pose_problem import Postures, pose_problem
from hydroopt.excitation.selection.readings import PostureReadings
from hydroopt.excitation.selection.what_next import plan_next
from hydroopt.excitation.selection.what_next_problem import WhatNextProblem, what_next_problem
from hydroopt.limits.reserves import Reserves
from hydroopt.machine.bundled_files import bundled_files
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine
from hydroopt.simulation.pose_table import simulate_poses

HERE = Path(__file__).parent
BUDGET, POINTS = 60.0, 300
"""Minutes; postures at which the tip is judged."""
DRAWS = {"cat215b_tip": 50, "cat215b_force": 50, "cat215b_load": 50, "bucket_tip": 25}
"""Drawn machines: how many is a matter of time."""
MANY = 1000
"""Candidates from which nothing could be better than stated."""
MOTIONS = 2
"""Motions in the fixed plan; before them 12 postures of the CAT 215B, four to each joint."""


class Work(NamedTuple):
    """Readings by one owner in postures q (N, n), or numbers of motions."""

    owner: str
    q: np.ndarray
    motions: tuple[int, ...] = ()


def on_site(factor: float = 1.0) -> Machine:
    """The CAT 215B with what a crew has; its file states every `sigma` so many times as wide."""
    text = bundled_files()["cat215b"].read_text("utf-8")
    body, rig = text.split("# The calibrator of Section 3.5.1", 1)
    zero = 'theta = { value = "0 deg", sigma = "0.5 deg", source = "zero of the resolver; sigma assumed" }\n'
    for length in ('a = { value = "5.180 m"', 'a = { value = "1.800 m"'):
        body = body.replace(length, zero + length)
    text = body + rig[rig.index("# Where the machine stands"):] + (HERE / "on_site.toml").read_text("utf-8")
    text = text.replace('rate = "50 Hz"', 'rate = "10 Hz"')
    return hydroopt.read_machine(wider(text, factor))


def bucket(factor: float = 1.0) -> Machine:
    """The excavator of the guide to measure-ups."""
    text = (HERE.parents[1] / "docs" / "how-to" / "measure_up.toml").read_text("utf-8")
    return hydroopt.read_machine(wider(text, factor))


def wider(text: str, factor: float) -> str:
    """A machine file with every `sigma` so many times as wide."""
    return re.sub(r'sigma = "([\d.]+)', lambda found: f'sigma = "{factor * float(found[1])}', text)


def fixed_plan(problem: WhatNextProblem) -> list[Work]:
    """What a crew does that knows its purpose, but plans nothing: swing each joint in turn through equal steps before
    the station; for the tip as many as the minutes allow, else so many that the rest is enough to drive motions."""
    named = {each.name: each for each in problem.measurements}
    station, motion = named["station"], named.get("motion")
    left = BUDGET - station.set_up - (0.0 if motion is None else motion.set_up + MOTIONS * motion.minutes)
    count, low_high = int(left / station.minutes), problem.chain.ranges.T
    low, high = (np.asarray(each) for each in low_high)
    swings = []
    for k, some in enumerate(np.array_split(np.arange(count), len(low))):
        q = np.repeat((low + high)[None] / 2, len(some), axis=0)
        q[:, k] = np.linspace(low[k] + 0.05 * (high - low)[k], high[k] - 0.05 * (high - low)[k], len(some))
        swings.append(q)
    work = [Work("station", np.concatenate(swings))]
    return work if motion is None else [*work, Work("motion", np.zeros((0, 0)), tuple(range(MOTIONS)))]


def minutes_of(problem: WhatNextProblem, work: Sequence[Work]) -> float:
    """By the problem's costs."""
    named = {each.name: each for each in problem.measurements}
    count = dict.fromkeys(named, 0)
    for each in work:
        count[each.owner] += len(each.motions) or len(each.q)
    return sum(named[name].set_up + named[name].minutes * some for name, some in count.items() if some)


def chosen(problem: WhatNextProblem, true: WhatNextProblem | None = None) -> list[Work]:
    """The plan of what-next, as far as the minutes of `true` costs allow."""
    plan, left, done, work = plan_next(problem, minutes=2 * BUDGET if true else BUDGET, least=0.0), BUDGET, set(), []
    named = {each.name: each for each in (true or problem).measurements}
    for step in plan.steps:
        cost: Measurement = named[step.measurement.name]
        room = left - (0 if cost.name in done else cost.set_up)
        parts = step.parts[:int(max(room, 0.0) / cost.minutes + 1e-9)]
        if not parts:
            continue
        left = room - cost.minutes * len(parts)
        done.add(cost.name)
        motions = tuple(parts) if step.measurement.motions else ()
        postures = step.measurement.postures
        q = np.zeros((0, 0)) if postures is None else postures.q[list(parts)]
        work.append(Work(cost.name, q, motions))
    return work


def least(problem: WhatNextProblem, minutes: float = BUDGET - 15.0, steps: int = 300) -> float:
    """A standard deviation of the tip that no choice among the candidates reaches in these minutes, which follow the
    first set-up: the optimal shares of minutes, other set-ups for nothing, and the tangent of the variance there, which
    is convex in them, as a bound."""
    goal, known = problem.goals[0], problem.knowledge
    own, posed = known.own, [each for each in problem.measurements if each.postures is not None]
    scale = np.sqrt(np.diag(known.first)[own])
    rows = [row * scale / np.sqrt(each.minutes) for each in posed for row in each.rows]
    rows = np.array([np.pad(row, ((0, max(map(len, rows)) - len(row)), (0, 0))) for row in rows])
    before = np.linalg.inv(known.first[own, own] / np.outer(scale, scale))
    task = goal.rows(known.covariance)[:, own] * scale
    share, best = np.full(len(rows), 1 / len(rows)), 0.0
    for _ in range(steps):
        towards = np.linalg.solve(before + minutes * np.einsum("k,kuf,kug->fg", share, rows, rows), task.T)
        gain = minutes * np.sum((rows @ towards) ** 2, axis=(1, 2))
        best = max(best, np.sum(task.T * towards) - np.max(gain) + np.sum(share * gain))
        share = share * np.sqrt(gain)
        share /= share.sum()
    return float(np.sqrt(best))


def expected(problem: WhatNextProblem, work: Sequence[Work]) -> dict[str, float]:
    """Standard deviations of the goals after some work, by the covariance that what-next computes."""
    known = problem.knowledge
    named, added = {each.name: each for each in problem.measurements}, {each.name for each in problem.additions}
    for each in work:
        if each.motions:
            for k in each.motions:
                known = known.after(named["motion"], k)
        elif each.owner in added:  # which the machine file does not state, in postures that are candidates
            for q in each.q:
                known = known.after(named[each.owner],
                                    int(np.argmin(np.linalg.norm(named[each.owner].postures.q - q, axis=1))))
        else:
            known = known.with_rows(rows_at(problem, each), np.arange(problem.knowledge.geometry), geometry_exact=False)
    return {name: goal.std(known.covariance) for name, goal in zip(problem.targets, problem.goals, strict=True)}


def rows_at(problem: WhatNextProblem, work: Work) -> np.ndarray:
    """Whitened rows (m, f) of readings in postures that are none of the candidates."""
    readings, poses = problem.postures[0].readings, pose_problem(problem.machine, 1, priors=True)
    there = PostureReadings(Postures(poses, work.q, np.zeros(len(work.q), dtype=int)), readings)
    wanted = np.array([each.owner == work.owner or each.kind == "transducer" for each in readings])
    rows = there.rows_of(np.arange(len(work.q)), there.there & wanted)
    made = np.zeros((rows.shape[0] * rows.shape[1], problem.knowledge.geometry))
    made[:, [problem.knowledge.names.index(name) for name in there.names]] = rows.reshape(len(made), -1)
    return made


def achieved(problem: WhatNextProblem, work: Sequence[Work], drawn_by: Machine, draw: int) -> dict[str, float]:
    """Errors of the goals [root mean square] on a machine drawn from the confidences of a file, after some work has
    been measured, calibrated and identified by the file of `problem`."""
    chain, owners = problem.chain, {each.owner for each in work}
    added = [each for each in problem.additions if each.name in owners]
    k = len(chain.parameters)
    read = [each for each in work if not each.motions and each.owner not in ("weigh.stick", "known_load")]
    q = np.concatenate([each.q for each in read]) if read else (chain.ranges.mean(axis=1)[None])
    table = Poses("planned", np.full(len(q), ""), np.full(len(q), ""), channels={
        f"{joint}.q": q[:, i] for i, joint in enumerate(chain.joints)},
        units={f"{joint}.q": "rad" for joint in chain.joints})
    made = simulate_poses(with_added(drawn_by, added), table, random=True, seed=draw)
    true = np.array([made.truth[name] for name in chain.parameters.names])
    found = chain.parameters.nominal
    if read:
        owner = np.repeat([each.owner for each in read], [len(each.q) for each in read])
        others = {each.owner for each in problem.postures[0].readings if each.kind != "transducer"}
        channels = {name: np.where(owner == name.partition(".")[0], values, np.nan)
                    if name.partition(".")[0] in others else values for name, values in made.poses.channels.items()}
        channels = {name: values for name, values in channels.items() if np.isfinite(values).any()}
        poses = Poses("measured", made.poses.stage, made.poses.fixture, setup=made.poses.setup, channels=channels,
                      units={name: made.poses.units[name] for name in channels})
        calibration = calibration_problem(with_added(problem.machine, added).machine, poses)
        found = optimum(calibration, "joint", calibration.start).theta[:k]
    error = {}
    if "tip" in problem.targets:
        at = np.random.default_rng(1).uniform(*chain.ranges.T, (POINTS, len(chain.joints)))
        tips = [chain.over(machine_end(chain)[1], theta, at)[0][:, :, 0] for theta in (found, true)]
        error["tip"] = float(np.sqrt(np.mean(np.sum((tips[0] - tips[1]) ** 2, axis=1))))
    if problem.targets.keys() - {"tip"}:
        error |= forces_error(problem, work, drawn_by, found, true, draw)
    return error


@cache
def _with_added(machine: str, added: tuple[Addition, ...]) -> KinematicModel:
    return KinematicModel(equipped(hydroopt.read_machine(machine), added))


def with_added(machine: Machine, added: Sequence[Addition]) -> KinematicModel:
    """The geometry of a machine with what is measured with."""
    return _with_added(dump_machine(machine), tuple(added))


def forces_error(problem: WhatNextProblem, work: Sequence[Work], drawn_by: Machine, found: np.ndarray,
                 true: np.ndarray, draw: int) -> dict[str, float]:
    """Errors of the goals that rest on forces, by an identification with the geometry that was found."""
    names, machine = problem.chain.parameters.names, problem.machine
    real, own = (Model(machine.with_values(dict(zip(names, theta.tolist(), strict=True)))) for theta in (true, found))
    psi_true = hydroopt.random_truth(Model(drawn_by), draw)
    motions = [problem.motions[k % len(problem.motions)] for each in work for k in each.motions]
    psi = problem.model.parameters.nominal
    if motions:
        logs = [hydroopt.simulate(real, motion, psi=psi_true, seed=100 * draw + k) for k, motion in enumerate(motions)]
        estimation = hydroopt.identification_problem(own, logs)
        if any(each.owner == "weigh.stick" for each in work):
            m = psi_true[problem.model.parameters.index("stick.m")]
            read = m + np.random.default_rng(draw).normal() * 0.005 * 688
            estimation = estimation.with_prior("scale", f"stick.m = {read} +- {0.005 * 688} kg")
        psi = hydroopt.solve(estimation, intervals=False).psi
    error = {}
    for name, goal in zip(problem.targets, problem.goals, strict=True):
        if name == "force":
            task = problem.task
            states = (task.q, task.qd, task.qdd)
            K, K_true, K_0 = (each.over(each.regressor, *states)[0] for each in (own, real, problem.model))
            size = 4 * np.std(K_0 @ problem.model.parameters.nominal, axis=0)
            error[name] = float(np.sqrt(np.mean(((K @ psi - K_true @ psi_true) / size) ** 2)))
        elif isinstance(goal, LoadGoal):
            weights = goal.weights(problem.knowledge.covariance)
            rng = np.random.default_rng(1)
            q = random_states(problem.model, len(weights), rng)[0]
            qd = 0.1 * np.sqrt(np.mean(problem.task.qd**2, axis=0)) * rng.choice([-1.0, 1.0], q.shape)
            off = own.over(own.regressor, q, qd, 0 * q)[0] @ psi - real.over(real.regressor, q, qd, 0 * q)[0] @ psi_true
            error[name] = float(np.sqrt(np.mean(np.sum(weights * off, axis=1) ** 2)
                                        + goal.floor(problem.knowledge.covariance)))
        elif name not in ("tip", "force", "load"):
            k = problem.model.parameters.index(name)
            error[name] = float(abs(psi[k] - psi_true[k]))
    return error


def compared(make: Callable[..., Machine], goals: Sequence[str], label: str, draws: int | None = None,
             without: Sequence[str] = ()) -> dict:
    """All figures of a machine."""
    # swings ask neither for ground, workspace nor strength, and neither do the plans that are compared with them
    nowhere = {"ground": None, "footprint": None, "workspace": None}
    result, (machine, far) = {}, (make(factor).model_copy(update=nowhere) for factor in (1.0, 2.0))
    for name in goals:
        count = draws or DRAWS[f"{label}_{name}"]
        targets = {name: {"tip": 1e-6, "force": 1e-6}.get(name, 1e-3)}
        state = partial(what_next_problem, machine, targets=targets, without=without, reserves=Reserves.none())
        problem = state()
        costs = {f"{each.name}{tail}": 2.0**sign * value for sign, each in zip(
            np.random.default_rng(7).choice([-1, 1], len(problem.measurements)), problem.measurements, strict=True)
            for tail, value in (("", each.minutes), (".set_up", each.set_up))}
        wrong = state(minutes=costs)
        fixed, plan, misled = fixed_plan(problem), chosen(problem), chosen(wrong, problem)
        before, after = expected(problem, [])[name], expected(problem, plan)[name]
        by_fixed, by_plan, by_misled, by_none = (drawn(problem, each, machine, count)[name] for each in (
            fixed, plan, misled, []))
        far_fixed, far_plan = (drawn(problem, each, far, count)[name] for each in (fixed, plan))
        rms, first = (np.sqrt(np.mean(np.square(each))) for each in (by_plan, by_none))
        found = {"std_first": before, "std_fixed": expected(problem, fixed)[name], "std": after,
                 "minutes_fixed": minutes_of(problem, fixed), "minutes": minutes_of(problem, plan),
                 "times_smaller": np.median(by_fixed) / np.median(by_plan),
                 "times_smaller_costs_wrong": np.median(by_fixed) / np.median(by_misled),
                 "times_smaller_twice_as_far_off": np.median(far_fixed) / np.median(far_plan),
                 "achieved_over_expected": rms / after,
                 "gain_achieved_over_expected": np.log(first / rms) / np.log(before / after), "draws": len(by_plan)}
        if name == "tip":
            found["least_std"] = least(replace(problem, candidates=MANY))
        result |= {f"{label}_{name}_{key}": round(float(value), 4) for key, value in found.items()}
        print(label, name, [(each.owner, len(each.motions) or len(each.q)) for each in plan], found, flush=True)
    return result


def drawn(problem: WhatNextProblem, work: Sequence[Work], machine: Machine, draws: int) -> dict[str, np.ndarray]:
    """Errors (draws,) of each goal; machines that a file cannot state, since strokes end, are left out."""
    found = []
    for draw in range(draws):
        try:
            found.append(achieved(problem, work, machine, draw))
        except HydrooptError as error:
            print(f"draw {draw}: {error}")
    return {name: np.array([each[name] for each in found]) for name in problem.targets}


def run(draws: int | None = None) -> dict:
    """Both machines."""
    return compared(on_site, ("tip", "force", "load"), "cat215b", draws) | compared(
        bucket, ("tip",), "bucket", draws, without=("plate",))
