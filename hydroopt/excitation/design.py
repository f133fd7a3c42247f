"""The motion that tells most about a machine's parameters within all of its limits (Gautier and Khalil 1992).

Coefficients of the motion are the variables of a nonlinear program with exact first derivatives, which IPOPT solves
from several starts. What it returns is checked at the controller's rate and, if a limit is touched in between, drawn
towards a posture of rest until none is: a motion that breaks a limit never comes out.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.excitation.basis import Basis, Rows, check
from hydroopt.excitation.criteria import Information
from hydroopt.excitation.limits import Limits
from hydroopt.identifiability import random_states
from hydroopt.inertia import Array
from hydroopt.synthetic import Trajectory

BACK_OFF = 0.01
"""Part of every limit's range that the program leaves, so that nothing is exceeded between its nodes."""
PER_WAVE = 12
"""Nodes in a period of the fastest wave."""
WIDEST = 3.0
"""Bound of a coefficient, in halves of its joint's range."""
POSTURES = 2000
"""Random postures among which one to rest in is sought."""


class State(NamedTuple):
    """States (N, n) of the joints."""

    q: Array
    qd: Array
    qdd: Array


@dataclass(frozen=True, eq=False)
class Excitation:
    """A motion to drive.

    Attributes:
        basis: its functions; `coefficients` (m, n) of all joints, those that rest included.
        trajectory: samples at the controller's rate.
        criterion: its name; `value` what it comes to.
        factor: (r, r) of the information of all samples and of what was known before.
        std: (r,) standard deviations to expect of the base parameters `names`, in `units`.
        condition_number: of the weighted, scaled regressor.
        limits: by name, the greatest part of its range that the motion uses; at most 1.
        stopped: whether the search was interrupted.
    """

    basis: Basis
    coefficients: Array
    trajectory: Trajectory
    criterion: str
    value: float
    factor: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    std: Array
    condition_number: float
    limits: dict[str, float]
    stopped: bool


class Program:
    """The nonlinear program of a design: `x` holds the coefficients (m, active) of the joints that move."""

    def __init__(self, information: Information, limits: Limits, basis: Basis, rate: float,
                 resting: dict[str, float] | None = None) -> None:
        check(basis, information.model.machine.bandwidth)
        self.information, self.limits, self.basis, self.rate = information, limits, basis, rate
        joints = information.model.machine.joints
        resting = resting or {}
        for name in resting:
            if name not in joints:
                raise ProblemError(f"'{name}' is no moving joint that could rest", where="excitation",
                                   remedy=f"use {', '.join(joints)}")
        self.active = [k for k, joint in enumerate(joints) if joint not in resting]
        if not self.active:
            raise ProblemError("all joints rest", where="excitation", remedy="let one joint move")
        self.still = np.array([resting.get(joint, 0.0) for joint in joints])
        nodes = int(np.ceil(PER_WAVE * basis.fastest * basis.duration)) + 1
        self.nodes = basis.rows(np.linspace(0, basis.duration, max(nodes, 20)))
        self.samples = round(basis.duration * rate) + 1
        self.worth = self.samples / len(self.nodes.position)
        ranges = np.array([information.model.machine.link(joint).joint.range for joint in joints])
        self.size = np.diff(ranges, axis=1)[self.active, 0] / 2
        self.mean = ranges.mean(axis=1)

    def coefficients(self, x: Array) -> Array:
        """(m, n) of all joints."""
        made = np.zeros((self.nodes.position.shape[1], len(self.still)))
        made[:, self.active] = np.reshape(x, (-1, len(self.active))) * self.size
        return made

    def states(self, x: Array, rows: Rows) -> State:
        """Joint states (N, n) at the times of some rows."""
        c = self.coefficients(x)
        q = rows.position @ c
        rest = [k for k in range(len(self.still)) if k not in self.active]
        q[:, rest] = self.still[rest]
        return State(q, rows.speed @ c, rows.acceleration @ c)

    def posture(self, q: Array) -> Array:
        """x of resting at a posture (n,)."""
        one = np.linalg.lstsq(self.nodes.position, np.ones(len(self.nodes.position)), rcond=None)[0]
        return np.asarray(np.outer(one, q[self.active] / self.size).ravel())

    def objective(self, x: Array) -> tuple[float, Array]:
        """Criterion and gradient."""
        value, by_state = self.information.value(*self.states(x, self.nodes), self.worth)
        return value, self._chain(by_state)

    def _chain(self, by_state: Array) -> Array:
        n = len(self.still)
        parts = [by_state[:, k * n:(k + 1) * n][:, self.active] for k in range(3)]
        total = sum(rows.T @ part for rows, part in zip(self.nodes, parts, strict=True))
        return np.asarray((total * self.size).ravel())

    def constraints(self, x: Array) -> Array:
        """Limits at the nodes (N·m,), each divided by its scale."""
        model = self.information.model
        return np.asarray(model.over(self.limits.function, *self.states(x, self.nodes))[0].ravel())

    def constraints_jacobian(self, x: Array) -> Array:
        """Their derivatives (N·m, len(x))."""
        _, *by = self.information.model.over(self.limits.function, *self.states(x, self.nodes))
        blocks = sum(part[:, :, None, self.active] * rows[:, None, :, None]
                     for part, rows in zip(by, self.nodes, strict=True)) * self.size
        return np.asarray(blocks.reshape(-1, len(x)))

    def excess(self, x: Array, rows: Rows) -> Array:
        """By how much (m,) each limit is exceeded at most, in parts of its scale."""
        values = self.information.model.over(self.limits.function, *self.states(x, rows))[0][:, :, 0]
        found: Array = np.max(self.limits.excess(values), axis=0)
        return np.where(np.isfinite(found), found, np.inf)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds (N·m,) of `constraints`, with the back-off."""
        lower, upper, count = self.limits.lower, self.limits.upper, len(self.nodes.position)
        room = BACK_OFF * np.where(np.isfinite(upper - lower), upper - lower, 1.0)
        return np.tile(lower + room, count), np.tile(upper - room, count)


def design(program: Program, *, starts: int = 2, seed: int = 0, seconds: float = 60.0,
           say: Callable[[str], None] = lambda _: None) -> Excitation:
    """The best motion found from several starts.

    Args:
        program: what is asked, within which limits, with which functions.
        starts: random motions to begin with.
        seed: of these.
        seconds: after which the best motion so far is taken.
        say: hears of progress.

    Raises:
        ProblemError: not even rest keeps all limits; the limits in conflict are named.
    """
    rng = np.random.default_rng(seed)
    rest = _rest(program, rng)
    best, value, stopped = rest, program.objective(rest)[0], False
    with _interruptible() as interrupted:
        for number in range(starts):
            start = shrunk(program, rest + _random(program, rng), rest)
            which = f"start {number + 1} of {starts}: {program.information.criterion}"
            found = _solve(program, start, seconds / starts, interrupted, partial(_tell, say, which, value))
            for x in (start, found):
                kept = shrunk(program, x, rest)
                reached = program.objective(kept)[0]
                if reached < value:
                    best, value = kept, reached
            if interrupted():
                stopped = True
                break
    return finished(program, best, stopped=stopped)


def _tell(say: Callable[[str], None], which: str, best: float, reached: float) -> None:
    say(f"{which} = {min(best, reached):.4g}")


def finished(program: Program, x: Array, *, stopped: bool = False) -> Excitation:
    """All that is to be said of a motion."""
    information, basis = program.information, program.basis
    t = np.arange(program.samples) / program.rate
    states = program.states(x, basis.rows(t))
    factor = information.factor(*states, 1.0)
    values = information.model.over(program.limits.function, *states)[0][:, :, 0]
    used: dict[str, float] = {}
    for k, row in enumerate(program.limits.rows):
        low, high = program.limits.lower[k], program.limits.upper[k]
        part = (np.max(np.abs(values[:, k] - (low + high) / 2)) / ((high - low) / 2) if np.isfinite(high - low)
                else np.max(values[:, k]) / high if np.isfinite(high) else 1 + np.max(low - values[:, k]))
        used[row.name] = max(used.get(row.name, -np.inf), float(part))
    units = information.model.parameters.units
    c = program.coefficients(x)
    for k in set(range(len(program.still))) - set(program.active):
        c[:, k] = np.linalg.lstsq(program.nodes.position, np.full(len(program.nodes.position), program.still[k]),
                                  rcond=None)[0]
    return Excitation(basis, c, Trajectory(t, *states), information.criterion, program.objective(x)[0], factor,
                      information.asked.names, tuple(units[k] for k in information.asked.columns),
                      information.std(factor), information.condition_number(factor), used, stopped)


def shrunk(program: Program, x: Array, rest: Array) -> Array:
    """The motion nearest to x, on the way to rest, that keeps all limits at the controller's rate and at the nodes."""
    rows = program.basis.rows(np.arange(program.samples) / program.rate)

    def keeps(part: float) -> bool:
        at = rest + part * (x - rest)
        return bool(np.all(np.isfinite(at)) and max(np.max(program.excess(at, rows)),
                                                    np.max(program.excess(at, program.nodes))) <= 0)

    if keeps(1.0):
        return x
    low, high = 0.0, 1.0
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if keeps(middle) else (low, middle)
    return np.asarray(rest + low * (x - rest))


def _rest(program: Program, rng: np.random.Generator) -> Array:
    """A posture in which all limits are kept by the most."""
    model, limits = program.information.model, program.limits
    q = np.vstack([program.mean, random_states(model, POSTURES, rng)[0]])
    q[:, [k for k in range(len(program.still)) if k not in program.active]] = program.still[
        [k for k in range(len(program.still)) if k not in program.active]]
    values = model.over(limits.function, q, 0 * q, 0 * q)[0][:, :, 0]
    excess = limits.excess(values)
    worst = np.max(np.where(np.isfinite(excess), excess, np.inf), axis=1)
    best = int(np.argmin(worst))
    if worst[best] > 0:
        broken = dict.fromkeys(limits.rows[k].name for k in np.flatnonzero(excess[best] > 0))
        never = dict.fromkeys(limits.rows[k].name for k in np.flatnonzero(np.min(excess, axis=0) > 0))
        named = list(never or broken)
        what = "cannot be kept in any posture" if never else "cannot be kept together in any posture"
        raise ProblemError(f"{', '.join(named)} {what}", where="excitation",
                           remedy="correct these limits in the machine file, or the posture of joints that rest")
    return program.posture(q[best])


def _random(program: Program, rng: np.random.Generator) -> Array:
    """A random motion about nothing, as large as a joint's range or so."""
    m = program.nodes.position.shape[1]
    drawn = rng.standard_normal((m, len(program.active))) / np.sqrt(m)
    return np.asarray((drawn - drawn.mean(axis=0)).ravel())


def _solve(program: Program, start: Array, seconds: float, interrupted: Callable[[], bool],
           heard: Callable[[float], None]) -> Array:
    """IPOPT's best point from a start, whatever ended it."""
    (lower, upper), size = program.bounds, len(start)
    vector, rows, one, nothing = (ca.Sparsity.dense(size), ca.Sparsity.dense(len(lower)), ca.Sparsity.dense(1),
                                  ca.Sparsity(0, 1))
    f = _Called("f", [vector], [one], lambda x: [program.objective(x)[0]])
    g = _Called("g", [vector], [rows], lambda x: [program.constraints(x)])
    slope = _Called("grad_f", [vector, nothing], [one, vector], lambda x, _: list(program.objective(x)))
    slopes = _Called("jac_g", [vector, nothing], [rows, ca.Sparsity.dense(len(lower), size)],
                     lambda x, _: [program.constraints(x), program.constraints_jacobian(x)])
    watch = _Watch(start, lower, upper, interrupted, heard)
    x = ca.MX.sym("x", size)
    solver = ca.nlpsol("excitation", "ipopt", {"x": x, "f": f(x), "g": g(x)}, {
        "grad_f": slope, "jac_g": slopes, "iteration_callback": watch, "no_nlp_grad": True, "print_time": False,
        "ipopt.print_level": 0, "ipopt.sb": "yes", "error_on_fail": False,
        "ipopt.hessian_approximation": "limited-memory", "ipopt.limited_memory_max_history": 6,
        "ipopt.mumps_pivot_order": 6,  # the default order fills the factors: twenty times slower with dense rows
        "ipopt.tol": 1e-5, "ipopt.acceptable_tol": 1e-3, "ipopt.acceptable_iter": 8, "ipopt.max_iter": 300,
        "ipopt.max_wall_time": max(seconds, 0.1), "ipopt.mu_strategy": "adaptive", "ipopt.bound_push": 1e-3})
    solver(x0=start, lbx=-WIDEST, ubx=WIDEST, lbg=lower, ubg=upper)
    return watch.best


class _Called(ca.Callback):  # type: ignore[misc]
    """A NumPy function as a casadi.Function."""

    def __init__(self, name: str, inputs: Sequence[ca.Sparsity], outputs: Sequence[ca.Sparsity],
                 function: Callable[..., list[Array | float]]) -> None:
        ca.Callback.__init__(self)
        self._inputs, self._outputs, self._function = inputs, outputs, function
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self._inputs)

    def get_n_out(self) -> int:
        return len(self._outputs)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return self._inputs[i]

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return self._outputs[i]

    def eval(self, arguments: list[ca.DM]) -> list[Array | float]:
        return self._function(*(np.asarray(a).ravel() for a in arguments))


class _Watch(ca.Callback):  # type: ignore[misc]
    """Keeps the best point that fulfils the constraints, tells of it, and stops when asked to."""

    def __init__(self, start: Array, lower: Array, upper: Array, interrupted: Callable[[], bool],
                 heard: Callable[[float], None]) -> None:
        ca.Callback.__init__(self)
        size, rows = len(start), len(lower)
        self._sizes = (size, 1, rows, size, rows, 0)
        self._bounds, self._interrupted, self._heard = (lower, upper), interrupted, heard
        self.best, self._value = start, np.inf
        self.construct("watch", {})

    def get_n_in(self) -> int:
        return len(self._sizes)

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes[i])

    def eval(self, arguments: list[ca.DM]) -> list[int]:
        x, value, g = (np.asarray(a).ravel() for a in arguments[:3])
        over = max(float(np.max(self._bounds[0] - g)), float(np.max(g - self._bounds[1])))
        if over < BACK_OFF / 2 and value[0] < self._value:
            self.best, self._value = x.copy(), float(value[0])
            self._heard(self._value)
        return [int(self._interrupted())]


@contextmanager
def _interruptible() -> Iterator[Callable[[], bool]]:
    """Ctrl-C becomes something that can be asked for; elsewhere than in the main thread nothing changes."""
    pressed = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield pressed.is_set
        return
    before = signal.signal(signal.SIGINT, lambda *_: pressed.set())
    try:
        yield pressed.is_set
    finally:
        signal.signal(signal.SIGINT, before)
