"""Design of a motion: our solver against SciPy's SLSQP with finite differences, from the same start."""

import contextlib
import math
import time

import numpy as np
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from hydroopt import excitation_problem, load_machine
from hydroopt.excitation.motion.basis import Fourier
from hydroopt.excitation.motion.design import BACK_OFF, RANDOM_MOTIONS, design
from hydroopt.excitation.motion.problem import ExcitationProblem
from hydroopt.excitation.motion.random_motion import random_motion, resting_posture
from hydroopt.excitation.motion.sqp import FEASIBLE, LARGEST_RADIUS, Search, sequential_quadratic_programming
from studies.bench.goals import Row

STARTS = 16
PATIENCE = 300.0
"""Starts of the whole design, and seconds after which the baseline is stopped."""
ROOM = 0.01
"""What the baseline leaves of every limit: to its advantage it keeps them at a quarter of our times only."""


class _OutOfTimeError(Exception):
    pass


def _baseline(program: ExcitationProblem, start: np.ndarray) -> tuple[float, float]:
    """Seconds until it ends, and the best it reached, with the same compiled functions but no derivatives."""
    lower, upper = program.bounds(ROOM)
    count = len(program.nodes.position)
    low, high = np.isfinite(np.tile(lower, count)), np.isfinite(np.tile(upper, count))

    def room(x: np.ndarray) -> np.ndarray:
        values = program.limits.values(*program.states(x, program.nodes))
        return np.concatenate([(values - lower).ravel()[low], (upper - values).ravel()[high]])

    began, best = time.perf_counter(), math.inf

    def watch(x: np.ndarray) -> None:
        nonlocal best
        if np.min(room(x)) >= -FEASIBLE:  # it may end where limits are broken
            best = min(best, program.value(x))
        if time.perf_counter() - began > PATIENCE:
            raise _OutOfTimeError

    with contextlib.suppress(_OutOfTimeError):
        minimize(program.value, start, method="SLSQP", callback=watch,
                 bounds=[(-LARGEST_RADIUS, LARGEST_RADIUS)] * len(start), constraints={"type": "ineq", "fun": room},
                 options={"maxiter": 1000, "ftol": 1e-5})
    return time.perf_counter() - began, best


def _ours(program: ExcitationProblem, start: np.ndarray, target: float) -> tuple[float, int, float]:
    """Seconds to the target, starts that it took, and what the first of them came to.

    Where the first ends in a worse local optimum the next begin at random, as in a design.
    """
    began, reached, values = time.perf_counter(), math.inf, []

    def heard(value: float) -> None:
        nonlocal reached
        if value <= target:
            reached = min(reached, time.perf_counter() - began)

    still, rng = resting_posture(program, np.random.default_rng(0)), np.random.default_rng(99)
    while math.isinf(reached) and time.perf_counter() - began < PATIENCE:
        found = sequential_quadratic_programming(program, Search.at(start), BACK_OFF, lambda: (
            not math.isinf(reached) or time.perf_counter() - began > PATIENCE), heard)
        values.append(program.value(found.best))
        start = random_motion(program, still, rng)
    return reached, len(values), values[0]


def excitation() -> list[Row]:
    """CAT 215B, 33 s, 10 harmonics, D-optimal, all limits of the machine file."""
    program = excitation_problem(load_machine("cat215b"), Fourier(29.0, 10))
    still = resting_posture(program, np.random.default_rng(0))
    print(f"{'start':>5} {'D there':>8} {'SLSQP s':>8} {'its D':>8} {'ours s to it':>13} {'ratio':>6} "
          f"{'starts':>7} {'D of the first':>14}")
    times = []
    with threadpool_limits(1):
        for seed in range(1, 9):
            start = random_motion(program, still, np.random.default_rng(seed))
            taken, value = _baseline(program, start)
            if math.isinf(value):
                print(f"{seed:5d} {program.value(start):8.3f} {taken:8.1f}     SLSQP ends without keeping the limits")
                continue
            reached, starts, first = _ours(program, start, value)
            times.append((taken, reached))
            print(f"{seed:5d} {program.value(start):8.3f} {taken:8.1f} {value:8.3f} {reached:13.2f} "
                  f"{taken / reached:6.1f} {starts:7d} {first:14.3f}")
    if times:
        theirs, ours = np.array(times).T
        print(f"median ratio {np.median(theirs / ours):.1f}, target 20; of the sums {theirs.sum() / ours.sum():.1f}")
    began = time.process_time()
    found = design(program)
    ours = time.process_time() - began
    smooth = program.value(found.x)  # the criterion of the search, not the stated one
    began = time.process_time()
    whole = min(to_the_end(program, still, start) for start in range(STARTS))
    theirs = time.process_time() - began
    print(f"whole design: {ours:.1f} s of CPU, D {smooth:.3f}; with every start to its end {theirs:.1f} s, "
          f"D {whole:.3f}, ratio {ours / theirs:.2f}")
    every = "every start to its end"
    return [Row("excite", ours, every, theirs), Row("excite criterion", smooth - whole)]


def to_the_end(program: ExcitationProblem, still: np.ndarray, start: int) -> float:
    """The criterion where a start of the design ends if none is dropped."""
    rng = np.random.default_rng((0, start))
    best = min((random_motion(program, still, rng) for _ in range(RANDOM_MOTIONS)), key=program.value)
    with threadpool_limits(1):
        found = sequential_quadratic_programming(program, Search.at(best), BACK_OFF, lambda: False, lambda _: None)
    return program.value(found.best)
