"""The motion with the most information on a machine's parameters within all of its limits (Gautier and Khalil 1992).

Coefficients of the motion are the variables of a nonlinear problem with exact first derivatives, which is solved from
many starts, in parallel processes: all take some steps, first by the criterion D, and the best of them go on. What it
returns is checked at the controller's rate and, if a limit is violated in between, scaled towards a posture at rest
until none is: a returned motion satisfies all limits. Passive joints are designed as variables that nearly balance
themselves; at last they are simulated as they swing.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from multiprocessing.queues import Queue
from multiprocessing.synchronize import Event
from typing import Any, NamedTuple, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from hydroopt.errors import ProblemError, SolverError
from hydroopt.excitation.criteria import CRITERIA, Information, design_parameters, presumed_noise
from hydroopt.excitation.motion.basis import Basis
from hydroopt.excitation.motion.excitation import Excitation
from hydroopt.excitation.motion.expected_accuracy import measured_information
from hydroopt.excitation.motion.problem import ExcitationProblem
from hydroopt.excitation.motion.random_motion import random_motion, resting_posture, shrunk
from hydroopt.excitation.motion.sqp import Search, sequential_quadratic_programming
from hydroopt.limits.limits import Limits
from hydroopt.limits.reserves import DEFAULT, Reserves
from hydroopt.limits.uncertain import UncertainParameters
from hydroopt.logs.log import Log
from hydroopt.machine.machine_file import GivenMachine, machine_of
from hydroopt.model.model import recent_model
from hydroopt.simulation.simulate import sampling_rate
from hydroopt.spatial.inertia import Array
from hydroopt.support.interrupt import deferred
from hydroopt.support.processes import pool
from hydroopt.support.progress import Progress, silent

FIRST_CRITERION, FIRST_STEPS, OWN_STEPS = "D", 25, 15
"""Criterion by which each start takes so many steps, and steps by another criterion before the best by it go on. D asks
for all combinations of parameters at once. A, E and the condition number see little but the worst one, follow it from a
random motion into poor local optima, and say little of where a search will end before they have been followed."""
PART, FEWEST = 4, 4
"""One start in so many goes on, and so many at least."""
RANDOM_MOTIONS = 4
"""Random motions, of which the best is an initial guess."""
BACK_OFF, ROUNDS = 0.001, 4
"""Part of every limit's range by which bounds are tightened, and how often this is increased."""
STILL = 1e-6
"""Speed [rad/s, m/s] below which a motion counts as standstill."""
Report = Callable[[int, str, float | None], None]
"""Receives a start, its criterion, and a better value or that its search has ended."""
T = TypeVar("T")


def excitation_problem(machine: GivenMachine, basis: Basis, *, criterion: str = "D", focus: Sequence[str] = (),
                       priors: bool = False, logs: Sequence[Log] = (), rate: float | None = None,
                       resting: Mapping[str, float] | None = None, reserves: Reserves = DEFAULT,
                       known: UncertainParameters | None = None) -> ExcitationProblem:
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
        reserves: that are kept of all limits.
        known: of the parameters, by which pressures, valves and tipping keep them; by default what the file states.

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
        >>> motion = ho.solve(problem, starts=1, search_seconds=0.5)
        >>> motion.trajectory.q.shape
        (1001, 1)
    """
    machine = machine_of(machine, "excitation_problem")
    model = recent_model(machine)
    model.refuse_seals("excitation")
    level = {joint: float(np.clip(0.0, *machine.link(joint).joint.range)) for joint in machine.base_joints}
    measured = measured_information(machine, logs) if logs else None
    parameters = design_parameters(model, presumed_noise(model), focus=focus, bayesian=priors, measured=measured)
    return ExcitationProblem(Information(model, parameters, criterion), Limits(model, reserves, known), basis,
                             sampling_rate(machine) if rate is None else rate, level | dict(resting or {}),
                             [{"path": log.path or log.name, "sha256": log.sha256 or None, "samples": log.size,
                               "role": "measured before"} for log in logs])


def design(problem: ExcitationProblem, *, starts: int = 16, seed: int = 0, search_seconds: float | None = None,
           processes: int = 1, progress: Progress = silent) -> Excitation:
    """The best motion found from several starts; Ctrl-C ends the search and keeps it.

    Without a time limit the motion depends on problem, starts and seed alone.

    Args:
        problem: see `excitation_problem`.
        starts: random motions from which the search starts.
        seed: of the random motions.
        search_seconds: time limit [s], if any, after which the best motion so far is returned; at least one start is
            begun.
        processes: how many starts run at the same time; with more than one, a script that calls this needs the usual
            ``if __name__ == "__main__"``.
        progress: receives how far the search is.

    Raises:
        ProblemError: no posture at rest, or no motion, satisfies all limits; the limits in conflict are named.
        SolverError: a process ended without an answer.
        KeyboardInterrupt: Ctrl-C was pressed before a motion was found.
    """
    if not (starts >= 1 and processes >= 1 and (search_seconds is None or search_seconds > 0)):
        raise ProblemError("the search has no start, process or time", where="excitation",
                           remedy="give at least one start, one process and some seconds")
    at_rest = resting_posture(problem, np.random.default_rng(seed))
    kept = min(max(-(-starts // PART), FEWEST), starts)
    end = np.inf if search_seconds is None else time.monotonic() + search_seconds
    best, done = dict.fromkeys(CRITERIA, np.inf), 0.0

    def report(start: int, criterion: str, value: float | None) -> None:
        nonlocal done
        if value is None:  # a search has ended
            done += 1.0 / (starts + kept)
        else:
            best[criterion] = min(best[criterion], value)
            progress(f"start {start + 1} of {starts}: {criterion} = {value:.4g}, best {best[criterion]:.4g}",
                     min(done, 1.0))

    with (deferred() as interrupted,
          _workers(problem, at_rest, min(processes, starts), end, interrupted, report) as run):
        begun = [each for each in run(_begun, [(seed, start) for start in range(starts)]) if each is not None]
        begun.sort(key=lambda each: each.search.value)
        found = run(_ended, begun[:kept])
        ended = interrupted()
        stopped = "by Ctrl-C" if ended else f"after {search_seconds:g} s" if time.monotonic() > end else ""
    moving = [each for each in found if np.max(np.abs(problem.states(each[0], problem.fine).qd)) > STILL]
    if moving:
        best_first = [Excitation(problem, x, seed, starts, stopped)
                      for x, _ in sorted(moving, key=lambda each: each[1])]
        return _least_smoothed(best_first).within_limits(at_rest)
    if ended:
        raise KeyboardInterrupt
    tried = f"tried in {search_seconds:g} s" if stopped else "tried"
    raise ProblemError(f"{', '.join(_conflicting_limits(problem, at_rest))} cannot be kept by any motion that was "
                       f"{tried}, however small", where="excitation",
                       remedy="correct these limits in the machine file, keep smaller reserves, or give more time")


def _least_smoothed(found: Sequence[Excitation]) -> Excitation:
    """The first, which is the best by the criterion; or, where smoothing takes more from it than noise adds, the one of
    which noise and smoothing together leave the parameters known best (the geometric mean of their errors)."""
    def error(each: Excitation) -> float:
        places = list(each.problem.parameters.focus) or slice(None)
        try:
            return float(np.sum(np.log(each.accuracy.base[places] ** 2 + each.accuracy.bias[places] ** 2)))
        except ProblemError:  # too slow to identify anything
            return np.inf

    first = found[0]
    biased = len(found) > 1 and (error(first) == np.inf or np.any(first.accuracy.bias > first.accuracy.base))
    return min(found, key=error) if biased else first


@dataclass(frozen=True)
class _Stop:
    """When a search ends early: Ctrl-C, and a value of ``time.monotonic()``, which processes share."""

    interrupted: Callable[[], bool]
    end: float

    def __call__(self) -> bool:
        return self.interrupted() or time.monotonic() > self.end


class _Begun(NamedTuple):
    """A search after its first steps, and the random motion from which it started."""

    start: int
    random: Array
    search: Search


def _begun(problem: ExcitationProblem, rest: Array, seed: tuple[int, int], stop: _Stop,
           report: Report) -> _Begun | None:
    """The first steps from a start; None if no time is left, but for the first start."""
    start = seed[1]
    if stop.interrupted() or (stop() and start > 0):
        return None
    rng, first = np.random.default_rng(seed), problem.by(FIRST_CRITERION)
    random = min((random_motion(problem, rest, rng) for _ in range(RANDOM_MOTIONS)), key=first.value)
    search = sequential_quadratic_programming(first, Search.at(random), BACK_OFF, stop,
                                              partial(report, start, FIRST_CRITERION), FIRST_STEPS)
    if (criterion := problem.information.criterion) != FIRST_CRITERION:
        search = sequential_quadratic_programming(problem, search.again(), BACK_OFF, stop,
                                                  partial(report, start, criterion), OWN_STEPS)
    report(start, criterion, None)
    return _Begun(start, random, search)


def _ended(problem: ExcitationProblem, rest: Array, begun: _Begun, stop: _Stop,
           report: Report) -> tuple[Array, tuple[float, float]]:
    """The best motion found from a start, and its rank."""
    search, back_off, criterion = begun.search, BACK_OFF, problem.information.criterion
    for _ in range(ROUNDS):
        search = sequential_quadratic_programming(problem, search, back_off, stop,
                                                  partial(report, begun.start, criterion))
        over = problem.excess(search.best, problem.fine)
        if over <= 0:
            break
        back_off += BACK_OFF / 4 + 1.5 * over  # violated between the times of the grid
        search = search.again()
    best = min(begun.random, shrunk(problem, search.best, rest), key=problem.rank)
    report(begun.start, criterion, None)
    return best, problem.rank(best)


class _Worker:
    """State of a process of the pool."""

    problem: ExcitationProblem
    rest: Array
    stop: _Stop
    values: Queue[tuple[int, str, float | None]]

    @classmethod
    def start(cls, problem: ExcitationProblem, rest: Array, end: float, stop: Event,
              values: Queue[tuple[int, str, float | None]]) -> None:
        cls.problem, cls.rest, cls.stop, cls.values = problem, rest, _Stop(stop.is_set, end), values

    @classmethod
    def do(cls, work: Callable[..., T], given: object) -> T:
        with threadpool_limits(limits=1, user_api="blas"):
            return work(cls.problem, cls.rest, given, cls.stop, lambda *reported: cls.values.put(reported))


@contextmanager
def _workers(problem: ExcitationProblem, rest: Array, processes: int, end: float,
             interrupted: Callable[[], bool], report: Report) -> Iterator[Callable[..., list[Any]]]:
    """A function that does some work with each of some things, here or in so many processes; results in their order."""
    if processes == 1:
        with threadpool_limits(limits=1, user_api="blas"):  # the matrices are too small for threads
            yield lambda work, things: [work(problem, rest, each, _Stop(interrupted, end), report) for each in things]
        return
    context = get_context("spawn")
    cancelled, values = context.Event(), context.Queue()

    def run(work: Callable[..., T], things: Sequence[object]) -> list[T]:
        tasks = [crew.submit(_Worker.do, work, each) for each in things]
        running = set(tasks)
        while running:
            _, running = wait(running, timeout=0.2)
            while not values.empty():
                report(*values.get())
            if interrupted():
                cancelled.set()
        return [task.result() for task in tasks]

    try:
        with pool(processes, _Worker.start, problem, rest, end, shared=(cancelled, values)) as crew:
            yield run
    except BrokenProcessPool:
        raise SolverError("a process ended without an answer", where="excitation",
                          remedy="use fewer processes, so that memory suffices") from None


def _conflicting_limits(problem: ExcitationProblem, rest: Array) -> list[str]:
    """Names of limits that a small random motion about rest violates."""
    slight = rest + STILL * np.random.default_rng(0).standard_normal(len(rest))
    values = problem.limits.values(*problem.states(slight, problem.grid))
    return problem.limits.names(np.max(problem.limits.excess(values), axis=0) > 0) or ["all limits together"]
