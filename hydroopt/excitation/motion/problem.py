"""The nonlinear program of a motion: coefficients in, criterion and limits out, with exact derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, NoReturn

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hydroopt.errors import ProblemError
from hydroopt.estimation.inference.program import NonlinearProgram
from hydroopt.excitation.criteria import DesignParameters, Information
from hydroopt.excitation.motion.basis import Basis, Rows, check
from hydroopt.limits.limits import Limits
from hydroopt.machine.machine import Machine
from hydroopt.spatial.inertia import Array
from hydroopt.support.notebook_card import Card, Shown

NODES, GRID = 12, 48
"""Times in a period of the fastest wave at which the criterion is evaluated, and at which limits are kept."""


FEWEST, MOST = 20, 1e6
"""Samples of a motion."""


WIDEST = 3.0
"""Bound of a coefficient, in halves of its joint's range."""


class State(NamedTuple):
    """States (N, n) of the joints."""

    q: Array
    qd: Array
    qdd: Array


class _Computed(ca.Callback):  # type: ignore[misc]
    """A function of columns of some sizes that NumPy computes of the first one, with its Jacobian by that one, if any.
    """

    def __init__(self, compute: Callable[[Array], ArrayLike], sizes: Sequence[int], width: int,
                 jacobian: _Computed | None = None) -> None:
        ca.Callback.__init__(self)
        self._compute, self._sizes, self._width, self._jacobian = compute, sizes, width, jacobian
        self.construct("computed", {})

    def get_n_in(self) -> int:
        return len(self._sizes)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes[i], 1)

    def get_sparsity_out(self, _: int) -> ca.Sparsity:
        return ca.Sparsity.dense(1, self._width)

    def eval(self, arguments: list[Any]) -> list[Any]:
        return [np.atleast_2d(self._compute(np.asarray(arguments[0]).ravel()))]

    def has_jacobian(self) -> bool:
        return self._jacobian is not None

    def get_jacobian(self, *_: Any) -> ca.Function:
        return self._jacobian


@dataclass(frozen=True, eq=False, repr=False)
class ExcitationProgram(NonlinearProgram):
    """The program of a motion; it must live as long as a solver uses its criterion.

    Attributes:
        criterion: the Python function in `f`.
    """

    criterion: ca.Callback | None = None


class ExcitationProblem(Shown):
    """The nonlinear program of a design: `x` holds the coefficients (m, active) of the joints that move.

    Args:
        information: the criterion, and the machine's parameters that the motion is to determine.
        limits: of the machine; joints that rest have no tracking error.
        basis: its functions of time.
        rate: samples per second of the controller.
        resting: joints that rest, and where [rad, m].
        inputs: the files of logs already measured: path, sha256, samples, role.

    Raises:
        ProblemError: the motion is faster than the valves, a resting joint is unknown, passive or out of its range, all
            rest, or there would be too many samples.

    Example:
        See `excitation_problem`, which makes one.
    """

    def __init__(self, information: Information, limits: Limits, basis: Basis, rate: float,
                 resting: Mapping[str, float] | None = None, inputs: Sequence[Mapping[str, Any]] = ()) -> None:
        check(basis, information.model.machine.bandwidth)
        self.information, self.basis, self.rate = information, basis, rate
        joints = information.model.machine.joints
        self.resting, self.inputs = dict(resting or {}), tuple(inputs)
        self.limits = limits.while_resting(self.resting)
        self.samples = _samples(basis, rate)
        for name, position in self.resting.items():
            if name not in joints:
                raise ProblemError(f"'{name}' is not a moving joint", where="excitation",
                                   remedy=f"use {', '.join(joints)}")
            if information.model.machine.link(name).joint.passive:
                raise ProblemError(f"nothing holds the passive joint '{name}' at rest", where="excitation",
                                   remedy="leave it out: it swings as the others move it")
            lower, upper = information.model.machine.link(name).joint.range
            if not lower <= position <= upper:
                unit = information.model.machine.channel_units[f"{name}.q"]
                raise ProblemError(f"joint '{name}' cannot rest at {position:.4g} {unit}: its range is {lower:.4g} to "
                                   f"{upper:.4g} {unit}", where="excitation", remedy="give a position within its range")
        self.active, self.idle = ([k for k, joint in enumerate(joints) if (joint in self.resting) == rests]
                                  for rests in (False, True))
        if not self.active:
            raise ProblemError("all joints rest", where="excitation", remedy="let one joint move")
        self.resting_position = np.array([self.resting.get(joint, 0.0) for joint in joints])
        waves = basis.fastest * basis.duration
        self.nodes, self.grid = (basis.rows(np.linspace(0, basis.duration, max(int(np.ceil(times * waves)) + 1, 20)))
                                 for times in (NODES, GRID))
        self.samples_per_node = self.samples / len(self.nodes.position)
        ranges = information.model.machine.ranges
        self.size = np.diff(ranges, axis=1)[self.active, 0] / 2
        self.mean = np.where([joint in self.resting for joint in joints], self.resting_position, ranges.mean(axis=1))
        # the coefficients of a function that is one throughout
        self.one = np.linalg.lstsq(self.nodes.position, np.ones(len(self.nodes.position)), rcond=None)[0]

    def __reduce__(self) -> tuple[type[ExcitationProblem], tuple[object, ...]]:
        return ExcitationProblem, (self.information, self.limits, self.basis, self.rate, self.resting, self.inputs)

    def by(self, criterion: str) -> ExcitationProblem:
        """The same design by another criterion.

        Example:
            >>> import hydroopt as ho
            >>> from hydroopt.excitation.motion.basis import Fourier
            >>> problem = ho.excitation_problem(ho.load_machine("patu655_lift"), Fourier(period=6.0, harmonics=2))
            >>> problem.by("E").information.criterion
            'E'
        """
        made = ExcitationProblem.__new__(ExcitationProblem)
        made.__dict__ = self.__dict__ | {"information": self.information.by(criterion)}
        return made

    @property
    def machine(self) -> Machine:
        """The machine that moves."""
        return self.information.model.machine

    @property
    def parameters(self) -> DesignParameters:
        """The base parameters that the motion is to determine."""
        return self.information.parameters

    @property
    def size_of_x(self) -> int:
        """Number of coefficients."""
        return len(self.basis.names) * len(self.active)

    def nlp(self, x0: Array | None = None, back_off: float = 0.0) -> ExcitationProgram:
        """The nonlinear program: coefficients, criterion, and all limits at the times of `grid`.

        The criterion is a Python function with an exact gradient, so that IPOPT needs
        ``{"ipopt.hessian_approximation": "limited-memory"}``; the limits are plain CasADi. Keep the program as long as
        the solver lives.

        Args:
            x0: initial guess (k,); by default rest in the middle of the joints' ranges.
            back_off: part of each limit's range by which bounds are tightened.

        Example:
            >>> import hydroopt as ho
            >>> from hydroopt.excitation.motion.basis import Fourier
            >>> problem = ho.excitation_problem(ho.load_machine("patu655_lift"), Fourier(period=6.0, harmonics=2))
            >>> problem.nlp()["lift sin1"].shape
            (1, 1)
        """
        size = self.size_of_x
        criterion = _Computed(self.value, [size], 1, _Computed(lambda x: self.objective(x)[1], [size, 1], size))
        limits, rows, count = self.limits, self.limits.rows, len(self.grid.position)
        x = ca.MX.sym("x", self.size_of_x)
        c = ca.MX(ca.DM(np.outer(self.one, self.resting_position)))
        c[:, self.active] = ca.reshape(x, len(self.active), len(self.basis.names)).T * ca.repmat(
            ca.DM(self.size).T, len(self.basis.names), 1)
        g = limits.function.map(count)(*((ca.DM(part) @ c).T for part in self.grid)) / ca.repmat(
            ca.DM(limits.scale), 1, count)
        lower, upper = self.bounds(back_off)
        joints, units = self.machine.joints, self.machine.channel_units
        widest = np.full(self.size_of_x, WIDEST)
        return ExcitationProgram(
            x=x, f=criterion(x), g=ca.vec(g), p=ca.MX.sym("p", 0), lbx=-widest, ubx=widest, criterion=criterion,
            x0=self.posture(self.mean) if x0 is None else np.asarray(x0, dtype=float),
            x_names=tuple(f"{joints[k]} {name}" for name in self.basis.names for k in self.active),
            x_units=tuple(f"{size:.6g} {units[f'{joints[k]}.q']}" for _ in self.basis.names
                          for k, size in zip(self.active, self.size, strict=True)),
            g_names=tuple(row.name for row in rows) * count, lbg=np.tile(lower, count), ubg=np.tile(upper, count),
            g_units=tuple(f"{row.scale:.6g} {row.unit}" for row in rows) * count,
            objective=(f"criterion {self.information.criterion} of the information on "
                       f"{len(self.parameters.columns)} base parameters",))

    def cvxpy(self) -> NoReturn:
        """Refuse: the problem is not convex.

        Raises:
            ProblemError: always.
        """
        raise ProblemError("the design of a motion is not convex, so that CVXPY cannot state it",
                           where=f"machine '{self.machine.name}'", remedy="use nlp() with IPOPT")

    def __repr__(self) -> str:
        return (f"ExcitationProblem({self.machine.name}: {self.size_of_x} coefficients, {len(self.parameters.columns)} "
                f"base parameters, criterion {self.information.criterion}, {self.basis.duration:g} s at "
                f"{self.rate:g} Hz)")

    def __str__(self) -> str:
        return f"{self!r}\n{self.nlp()}"

    def card(self) -> Card:
        """What a notebook shows: limits and the basis; the program is in `print`."""
        joints = [self.machine.joints[k] for k in self.active]
        return Card(repr(self), {"joints": ", ".join(joints), "criterion": self.information.criterion,
                                 "duration": f"{self.basis.duration:g} s"})

    @cached_property
    def t(self) -> Array:
        """Times (N,) of the controller's samples [s]."""
        return np.arange(self.samples) / self.rate

    @cached_property
    def fine(self) -> Rows:
        """The functions at the controller's samples."""
        return self.basis.rows(self.t)

    def coefficients(self, x: Array) -> Array:
        """(m, n) of all joints."""
        made = np.outer(self.one, self.resting_position)
        made[:, self.active] = np.reshape(x, (-1, len(self.active))) * self.size
        return made

    def states(self, x: Array, rows: Rows) -> State:
        """Joint states (N, n) at the times of some rows."""
        c = self.coefficients(x)
        found = State(*(part @ c for part in rows))
        found.q[:, self.idle] = self.resting_position[self.idle]
        found.qd[:, self.idle] = found.qdd[:, self.idle] = 0.0
        return found

    def posture(self, q: Array) -> Array:
        """x of resting at a posture (n,)."""
        return np.asarray(np.outer(self.one, q[self.active] / self.size).ravel())

    def hung(self, x: Array) -> Array:
        """x with passive joints that hang still in each posture, as far as the functions of time can follow."""
        hanging = self.limits.hanging
        if not hanging.joints:
            return x
        q = hanging.postures(self.states(x, self.nodes).q)
        made = np.reshape(x, (-1, len(self.active))).copy()
        for joint in set(hanging.joints) & set(self.active):
            k = self.active.index(joint)
            made[:, k] = np.linalg.lstsq(self.nodes.position, q[:, joint] / self.size[k], rcond=None)[0]
        return made.ravel()

    def objective(self, x: Array) -> tuple[float, Array]:
        """Criterion and gradient."""
        value, by_state = self.information.value_and_slope(*self.states(x, self.nodes), self.samples_per_node)
        return value, self._chain(by_state)

    def rank(self, x: Array) -> tuple[float, float]:
        """What orders finished motions: the criterion over all samples, and where that does not decide, the smooth one.

        A condition number is the same for all motions that leave a parameter undetermined.
        """
        return round(self.information.exact_value(*self.states(x, self.fine)), 9), self.value(x)

    def value(self, x: Array) -> float:
        """The criterion alone."""
        return self.information.value(*self.states(x, self.nodes), self.samples_per_node)

    def _chain(self, by_state: Array) -> Array:
        n = len(self.resting_position)
        parts = [by_state[:, k * n:(k + 1) * n][:, self.active] for k in range(3)]
        total = sum(rows.T @ part for rows, part in zip(self.nodes, parts, strict=True))
        return np.asarray((total * self.size).ravel())

    def constraints(self, x: Array) -> Array:
        """Limited quantities (N, m) at the times of `grid`, divided by their scales."""
        return self.limits.values(*self.states(x, self.grid))

    def slopes(self, x: Array) -> Array:
        """Derivatives (N, m, 3·active) of `constraints` by the positions of moving joints, then speeds, accelerations.
        """
        found = self.limits.slopes(*self.states(x, self.grid))
        if self.idle:
            joints = len(self.resting_position)
            found = found[:, :, [order * joints + k for order in range(3) for k in self.active]]
        units = np.tile(self.size, 3) / self.limits.scale[:, None]
        return np.asarray(np.multiply(found, units, order="C"))  # for products time by time

    @cached_property
    def _functions(self) -> Array:
        """The functions and their derivatives (N, 3, k) at the times of `grid`."""
        return np.stack(self.grid, axis=1)

    def jacobian(self, slopes: Array, active: NDArray[np.bool_]) -> Array:
        """Jacobian (k, len(x)) of the constraints in the active set (N, m)."""
        node, row = np.nonzero(active)
        by_order = slopes[node, row].reshape(len(node), 3, len(self.active))
        return np.asarray((np.swapaxes(self._functions[node], 1, 2) @ by_order).reshape(len(node), self.size_of_x))

    def directional_derivative(self, slopes: Array, step: Array) -> Array:
        """Directional derivative (N, m) of all constraints along a step (len(x),)."""
        functions = self._functions.reshape(-1, len(self.basis.names))
        moved = (functions @ np.reshape(step, (-1, len(self.active)))).reshape(len(slopes), -1, 1)
        return np.asarray((slopes @ moved)[:, :, 0])

    def weighted_gradient(self, slopes: Array, multipliers: Array) -> Array:
        """Gradient (len(x),) of the sum of all constraints, weighted by multipliers (N, m)."""
        active = multipliers != 0
        return np.asarray(multipliers[active] @ self.jacobian(slopes, active))

    def excess(self, x: Array, rows: Rows) -> float:
        """The largest excess over a limit, as a part of its scale; at most zero if all are satisfied."""
        values = self.limits.values(*self.states(x, rows))
        # not a number where a value is none
        return float(np.max(self.limits.excess(np.array([np.min(values, axis=0), np.max(values, axis=0)]))))

    @cached_property
    def _moved(self) -> NDArray[np.bool_]:
        """Which limits (m,) the moving joints change."""
        x = self.posture(self.mean) + np.random.default_rng(0).uniform(-0.1, 0.1, self.size_of_x)
        return np.asarray(np.any(self.slopes(x) != 0, axis=(0, 2)))

    def bounds(self, back_off: float) -> tuple[Array, Array]:
        """Lower and upper bounds (m,) of `constraints`, tightened by a part of each range where joints change them."""
        lower, upper = self.limits.lower, self.limits.upper
        tightening = back_off * self._moved * np.where(np.isfinite(upper - lower), upper - lower, 1.0)
        return lower + tightening, upper - tightening


def _samples(basis: Basis, rate: float) -> int:
    if not (0 < rate < np.inf and basis.duration * rate >= FEWEST):
        raise ProblemError(f"at {rate:g} Hz a motion of {basis.duration:g} s has fewer than {FEWEST} samples",
                           where="excitation", remedy=f"give a rate higher than {FEWEST / basis.duration:.2g} Hz")
    if basis.duration * rate > MOST:
        raise ProblemError(f"{basis.duration * rate:.1e} samples are too many to check", where="excitation",
                           remedy="shorten the motion or lower the rate")
    return int(np.ceil(basis.duration * rate - 1e-9)) + 1  # after its end the motion rests
