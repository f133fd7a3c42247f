"""The motion with the most information on a machine's parameters within all of its limits (Gautier and Khalil 1992).

Coefficients of the motion are the variables of a nonlinear problem with exact first derivatives, which is solved from
many starts, in parallel processes. What it returns is checked at the controller's rate and, if a limit
is violated in between, scaled towards a posture at rest until none is: a returned motion satisfies all limits. Passive
joints are designed as variables that nearly balance themselves; at last they are simulated as they swing.
"""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from multiprocessing import get_context
from multiprocessing.queues import Queue
from multiprocessing.synchronize import Event

import numpy as np
from threadpoolctl import threadpool_limits

from hydroopt.errors import ProblemError, SolverError
from hydroopt.excitation.criteria import Information, design_parameters, presumed_noise
from hydroopt.excitation.motion.basis import Basis
from hydroopt.excitation.motion.excitation import Excitation
from hydroopt.excitation.motion.expected_accuracy import measured_information
from hydroopt.excitation.motion.limits import Limits, margins
from hydroopt.excitation.motion.problem import ExcitationProblem
from hydroopt.excitation.motion.random_motion import random_motion, resting_posture, shrunk
from hydroopt.excitation.motion.sqp import sequential_quadratic_programming
from hydroopt.interrupt import blocked, deferred, end_with_parent, ignore
from hydroopt.logs.any_log import AnyLog
from hydroopt.machine.given_machine import GivenMachine, machine_of
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import sampling_rate
from hydroopt.spatial.inertia import Array

RANDOM_MOTIONS = 4
"""Random motions, of which the best is an initial guess."""
BACK_OFF, ROUNDS = 0.001, 4
"""Part of every limit's range by which bounds are tightened, and how often this is increased."""
STILL = 1e-6
"""Speed [rad/s, m/s] below which a motion counts as standstill."""
SMALLEST, TRIES = 0.1, 10
"""Size of the smallest of so many copies of a motion that are tried with passive joints that swing."""
Report = Callable[[int, float], None]


def excitation_problem(machine: GivenMachine, basis: Basis, *, criterion: str = "D", focus: Sequence[str] = (),
                       priors: bool = False, logs: Sequence[AnyLog] = (), rate: float | None = None,
                       resting: Mapping[str, float] | None = None) -> ExcitationProblem:
    """The design of a motion with the most information on a machine's parameters, within its limits.

    Args:
        machine: with all of its limits.
        basis: functions of time, of which the motion is a sum: `Fourier` or `Spline`.
        criterion: ``D``, ``A``, ``E`` or ``condition``.
        focus: parameters, parts, ``payload`` or ``friction`` to which the criterion is restricted.
        priors: whether the machine file's confidences count as information (Bayesian design).
        logs: already measured; their information is added to that of the motion.
        rate: samples per second of the controller; by default the highest that the file states for a joint's sensor,
            or 50.
        resting: joints that rest, with their positions [rad, m]; those of a moving base rest level if not stated.

    Raises:
        ProblemError: an argument is wrong; the sentence states a remedy.
        IdentifiabilityError: no motion excites the focus.
        LogError: a log cannot be used.

    Example:
        >>> import hydroopt as ho
        >>> from hydroopt.excitation.motion.basis import Fourier
        >>> problem = ho.excitation_problem(ho.load_machine("patu655_lift"), Fourier(period=6.0, harmonics=2))
        >>> problem
        ExcitationProblem(patu655_lift: 5 coefficients, 5 base parameters, criterion D, 10 s at 100 Hz)
        >>> motion = ho.solve(problem, starts=1, seconds=2.0)
        >>> motion.trajectory.q.shape
        (1001, 1)
    """
    machine = machine_of(machine, "excitation_problem")
    model = Model(machine)
    model.refuse_seals("excitation")
    level = {joint: float(np.clip(0.0, *machine.link(joint).joint.range)) for joint in machine.base_joints}
    measured = measured_information(machine, logs) if logs else None
    parameters = design_parameters(model, presumed_noise(model), focus=focus, bayesian=priors, measured=measured)
    return ExcitationProblem(Information(model, parameters, criterion), Limits(model, margins(model)), basis,
                             sampling_rate(machine) if rate is None else rate, level | dict(resting or {}),
                             [{"path": log.path or log.name, "sha256": log.sha256 or None, "samples": log.size,
                               "role": "measured before"} for log in logs])


def design(problem: ExcitationProblem, *, starts: int = 16, seed: int = 0, seconds: float = 60.0, processes: int = 1,
           progress: Callable[[str], None] = lambda _: None) -> Excitation:
    """The best motion found from several starts; Ctrl-C ends the search and keeps it.

    Args:
        problem: see `excitation_problem`.
        starts: random motions from which the search starts.
        seed: of the random motions.
        seconds: time limit, after which the best motion so far is returned; at least one start is begun.
        processes: how many starts run at the same time; with more than one, a script that calls this needs the usual
            ``if __name__ == "__main__"``.
        progress: is called with a sentence on the progress.

    Raises:
        ProblemError: no posture at rest, or no motion, satisfies all limits; the limits in conflict are named.
        SolverError: a process ended without an answer.
        KeyboardInterrupt: Ctrl-C was pressed before a motion was found.
    """
    if not (starts >= 1 and processes >= 1 and seconds > 0):
        raise ProblemError("the search has no start, process or time", where="excitation",
                           remedy="give at least one start, one process and some seconds")
    at_rest = resting_posture(problem, np.random.default_rng(seed))
    found: list[tuple[Array, float]] = []
    criterion, best = problem.information.criterion, np.inf

    def report(start: int, value: float) -> None:
        nonlocal best
        best = min(best, value)
        progress(f"start {start + 1} of {starts}: {criterion} = {value:.4g}, best {best:.4g}")

    processes, end = min(processes, starts), time.time() + seconds
    with deferred() as interrupted:
        if processes == 1:
            for start in range(starts):
                found.append(_attempt(problem, at_rest, (seed, start), end, interrupted, report))
                if interrupted():
                    break
        else:
            found += _in_parallel(problem, at_rest, seed, starts, processes, end, interrupted, report)
        stopped = interrupted()
    moving = [each for each in found if np.max(np.abs(problem.states(each[0], problem.fine).qd)) > STILL]
    if moving:
        return _as_it_swings(Excitation(problem, min(moving, key=lambda each: each[1])[0], seed, starts, stopped),
                             at_rest)
    if stopped:
        raise KeyboardInterrupt
    raise ProblemError(f"{', '.join(_conflicting_limits(problem, at_rest))} cannot be kept by any motion that was "
                       "tried, however small", where="excitation",
                       remedy="correct these limits in the machine file, or give more time")


def _as_it_swings(found: Excitation, rest: Array) -> Excitation:
    """The motion itself, or made smaller until limits are kept while passive joints swing as they do.

    Raises:
        ProblemError: they are not kept however small the motion is.
    """
    if not found.problem.limits.hanging.joints:
        return found
    for part in np.linspace(1.0, SMALLEST, TRIES):
        x = found.x if part == 1 else found.problem.hung(rest + part * (found.x - rest))
        one = replace(found, x=x)
        try:
            if min(use.room for use in one.limits) >= 0:
                return one
        except ProblemError:  # a passive joint leaves its range
            continue
    raise ProblemError("passive joints swing beyond limits in every motion that was tried", where="excitation",
                       remedy="give a slower motion: fewer harmonics, or a longer period")


def _attempt(problem: ExcitationProblem, rest: Array, seed: tuple[int, int], end: float,
             interrupted: Callable[[], bool],
             report: Report) -> tuple[Array, float]:
    """The best motion found from a start, and its value; the posture at rest if ``time.time()`` is beyond `end`."""
    end += time.monotonic() - time.time()
    if interrupted() or (time.monotonic() > end and seed[1] > 0):  # the first start always yields a random motion
        return rest, np.inf
    # the matrices are too small for threads
    with threadpool_limits(limits=1, user_api="blas"):
        rng = np.random.default_rng(seed)
        best = min((random_motion(problem, rest, rng) for _ in range(RANDOM_MOTIONS)), key=problem.value)
        x, back_off = best, BACK_OFF
        for _ in range(ROUNDS):
            x = sequential_quadratic_programming(problem, x, back_off, end, interrupted,
                                                 lambda value: report(seed[1], value))
            over = problem.excess(x, problem.fine)
            if over <= 0:
                break
            back_off += BACK_OFF / 4 + 1.5 * over  # violated between the times of the grid
        best = min(best, shrunk(problem, x, rest), key=problem.value)
        return best, problem.value(best)


class _Worker:
    """State of a process of the pool."""

    problem: ExcitationProblem
    rest: Array
    stop: Event
    values: Queue[tuple[int, float]]

    @classmethod
    def start(cls, problem: ExcitationProblem, rest: Array, stop: Event, values: Queue[tuple[int, float]]) -> None:
        ignore()
        cls.problem, cls.rest, cls.stop, cls.values = problem, rest, stop, values

    @classmethod
    def attempt(cls, seed: tuple[int, int], end: float) -> tuple[Array, float]:
        return _attempt(cls.problem, cls.rest, seed, end, cls.stop.is_set, lambda *reported: cls.values.put(reported))


def _in_parallel(problem: ExcitationProblem, rest: Array, seed: int, starts: int, processes: int, end: float,
                 interrupted: Callable[[], bool], report: Report) -> list[tuple[Array, float]]:
    context = get_context("spawn")
    stop, values = context.Event(), context.Queue()
    try:
        with ProcessPoolExecutor(processes, context, end_with_parent, (
                pickle.dumps((_Worker.start, (problem, rest))), stop, values)) as pool:
            with blocked():
                attempts = [pool.submit(_Worker.attempt, (seed, start), end) for start in range(starts)]
            running = set(attempts)
            while running:
                _, running = wait(running, timeout=0.2)
                while not values.empty():
                    report(*values.get())
                if interrupted() and not stop.is_set():
                    stop.set()
                    for attempt in running:  # starts that have not begun
                        attempt.cancel()
            return [attempt.result() for attempt in attempts if not attempt.cancelled()]
    except BrokenProcessPool:
        raise SolverError("a process ended without an answer", where="excitation",
                          remedy="use fewer processes, so that memory suffices") from None


def _conflicting_limits(problem: ExcitationProblem, rest: Array) -> list[str]:
    """Names of limits that a small random motion about rest violates."""
    slight = rest + STILL * np.random.default_rng(0).standard_normal(len(rest))
    values = problem.limits.values(*problem.states(slight, problem.grid))
    broken = np.flatnonzero(np.max(problem.limits.excess(values), axis=0) > 0)
    return list(dict.fromkeys(problem.limits.rows[k].name for k in broken)) or ["all limits together"]
