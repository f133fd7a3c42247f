"""Dynamics with unknown parameters, records of experiments, and simulation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError, SolverError
from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.spatial.inertia import Array

POINTS = 3
"""Number of collocation points of an interval; the last one is its end."""
WIDEST = 100.0
"""Standard deviation of an unknown first state, in units of its scale."""
ACCURACY = 1e-10
"""Default error tolerance of a simulation's steps."""


@dataclass(frozen=True, eq=False)
class Dynamics:
    """A system with unknown parameters.

    Attributes:
        rates: casadi.Function (x, u, theta) → ẋ (nx,).
        outputs: casadi.Function (x, u, theta) → y (ny,), the measured channels.
        states, inputs, channels: names of x, u and y.
        scale: (nx,) typical size of each state, in which it is solved for.
        held: (nu,) inputs that keep a sample's value until the next one; the others are straight between samples.
    """

    rates: ca.Function
    outputs: ca.Function
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    channels: tuple[str, ...]
    scale: Array
    held: NDArray[np.bool_]

    def __post_init__(self) -> None:
        sizes = {"x": (len(self.states), self.scale.size, self.rates.numel_in(0), self.rates.numel_out(0)),
                 "u": (len(self.inputs), self.held.size, self.rates.numel_in(1), self.outputs.numel_in(1)),
                 "y": (len(self.channels), self.outputs.numel_out(0))}
        for name, found in sizes.items():
            if len(set(found)) > 1:
                raise ProblemError(f"the sizes of {name} differ: {found}", where="dynamics",
                                   remedy="give rates, outputs, names and scales of one system")


@dataclass(frozen=True, eq=False)
class Record:
    """One experiment of N samples.

    Attributes:
        t: (N,) times [s], increasing; intervals may differ.
        u: (N, nu) inputs.
        y: (N, ny) readings, NaN where there is none.
        guess: (N, nx) initial guess of the states.
        initial_sigma: (nx,) standard deviation of the first states about their guess, infinite where they are free;
            by default WIDEST times the dynamics' scale, so that one forgotten within the first interval stays finite.
        steps: collocated intervals between two samples.
    """

    t: Array
    u: Array
    y: Array
    guess: Array
    initial_sigma: Array | None = None
    steps: int = 1
    name: str = "record"

    def __post_init__(self) -> None:
        if not (len(self.t) >= 2 and np.all(np.diff(self.t) > 0)):
            raise ProblemError("times do not increase", where=self.name, remedy="sort the samples, two or more")
        if len(self.y) != len(self.t):
            raise ProblemError(f"there are {len(self.y)} rows of readings at {len(self.t)} samples", where=self.name,
                               remedy="give a row for every sample, NaN where there is no reading")
        for what, values in (("inputs", self.u), ("guessed states", self.guess)):
            bad = np.flatnonzero(~np.all(np.isfinite(values), axis=1))
            if len(values) != len(self.t) or bad.size:
                raise ProblemError(f"{what} are missing at sample {bad[0] if bad.size else len(values)}",
                                   where=self.name, remedy="give a number at every sample")

    @cached_property
    def time(self) -> Array:
        """(K,) times of all points: the first sample, then POINTS to every collocated interval."""
        edges = self.edges
        inner = edges[:-1, None] + np.diff(edges)[:, None] * np.array(ca.collocation_points(POINTS, "radau"))
        return np.concatenate([edges[:1], inner.ravel()])

    @property
    def edges(self) -> Array:
        """(E + 1,) times between which the dynamics are collocated."""
        share = np.arange(self.steps) / self.steps
        return np.append((self.t[:-1, None] + np.diff(self.t)[:, None] * share).ravel(), self.t[-1])

    def between(self, states: Array) -> Array:
        """(K, nx) states at all points, straight between those (N, nx) at the samples."""
        return np.column_stack([np.interp(self.time, self.t, column) for column in states.T])

    def inputs(self, held: NDArray[np.bool_]) -> Array:
        """(K - 1, nu) inputs at all points but the first."""
        interval = np.repeat(np.arange(len(self.t) - 1), self.steps * POINTS)
        share = (self.time[1:] - self.t[interval]) / np.diff(self.t)[interval]
        change = np.where(held, 0.0, np.diff(self.u, axis=0))[interval]
        return np.asarray(self.u[interval] + share[:, None] * change)


@dataclass(frozen=True, eq=False)
class ShootingProblem:
    """The identification of parameters from records; solving does not change it.

    Attributes:
        dynamics: of all records.
        parameters: θ (p,), with bounds and Gaussian prior.
        sigma: (ny,) standard deviation of each channel's readings.
        records: one or more.
    """

    dynamics: Dynamics
    parameters: ParameterSet
    sigma: Array
    records: tuple[Record, ...]
    name: str = "dynamics"

    def __post_init__(self) -> None:
        shapes = {(r.u.shape[1], r.y.shape[1], r.guess.shape[1]) for r in self.records}
        wanted = (len(self.dynamics.inputs), len(self.dynamics.channels), len(self.dynamics.states))
        if shapes != {wanted} or len(self.sigma) != wanted[1] or self.dynamics.rates.numel_in(2) != len(
                self.parameters):
            raise ProblemError(f"records have {shapes or 'no'} inputs, channels and states, where the dynamics have "
                               f"{wanted}; or sigma or parameters do not fit", where=self.name,
                               remedy="give every record and σ the dynamics' inputs, channels and states")
        if not np.all(self.sigma > 0):
            raise ProblemError("a channel has no positive standard deviation", where=self.name,
                               remedy="state the accuracy of its sensor")


def free_run(dynamics: Dynamics, record: Record, first: Array, theta: Array, *,
             accuracy: float = ACCURACY) -> tuple[Array, Array]:
    """States (N, nx) and outputs (N, ny) at a record's samples, from first states (nx,) and its inputs alone.

    `accuracy` is the error of a step, relative and in units of the states' scales.

    Raises:
        SolverError: CVODES failed, as it does where the states diverge.
    """
    nx, nu, count = len(dynamics.states), len(dynamics.inputs), len(record.t) - 1
    state, t = ca.SX.sym("x", nx), ca.SX.sym("t")
    first_input, change, span = ca.SX.sym("u", nu), ca.SX.sym("du", nu), ca.SX.sym("span")
    scale = ca.DM(dynamics.scale)
    rate = dynamics.rates(state * scale, first_input + change * t, ca.DM(theta)) * span / scale
    # every interval is integrated anew: inputs may jump there, which a multistep method takes for its own error
    interval = ca.integrator("interval", "cvodes", {"x": state, "p": ca.vertcat(first_input, change, span), "t": t,
                                                    "ode": rate}, 0.0, 1.0,
                             {"reltol": accuracy, "abstol": accuracy, "max_num_steps": 100000})
    change = np.where(dynamics.held, 0.0, np.diff(record.u, axis=0))
    try:
        end = interval.mapaccum(count)(x0=first / dynamics.scale,
                                       p=np.column_stack([record.u[:-1], change, np.diff(record.t)]).T)["xf"]
    except RuntimeError as error:
        raise SolverError("the simulation did not converge", where=record.name,
                          remedy="start from other parameters and states") from error
    states = np.vstack([first, np.asarray(end).T * dynamics.scale])
    outputs = dynamics.outputs.map(len(record.t))(states.T, record.u.T, ca.repmat(ca.DM(theta), 1, len(record.t)))
    return states, np.asarray(outputs).T
