"""Motion and parameters fitted together, with errors in angles and in pressures.

The motion of each joint is a quintic spline q(t) = B(t)·c. With parameters ψ it is the most probable one:

    Σ ((q_measured − B·c)/σ_q)² + λ/σ_q²·∫ (B'''·c)² dt + Σ ((f − f(B·c, Ḃ·c, B̈·c, ψ))/σ_f)²  →  min over c and ψ.

Gauss-Newton steps with exact derivatives solve it. A spline's coefficients meet only their neighbours, so that banded
normal equations with a border give them as functions of the common unknowns; with these, all rows together are
``‖R·ψ − r‖²``, the information of angles and forces about the parameters, the uncertainty of the motion included. Every
estimator, prior and constraint applies to it as it does after smoothing.

Numbers g beside ψ, such as those of the geometry, may be unknown, too (`NumbersBeside`). What all rows leave is then a
triangle for [g, ψ]: its first rows give g where ψ is known, with the covariance that is left then (`NumbersGiven`); the
others are the information about ψ alone, in which g may be whatever is most probable.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import IdentifiabilityError, SolverError
from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.folding import split, triangle
from hydroopt.estimation.inference.identifiability import ROUNDING_TOLERANCE
from hydroopt.estimation.inference.whitening import whitening
from hydroopt.estimation.motion.banded import Bordered, Rows
from hydroopt.estimation.motion.paths import Spline, Support, motion
from hydroopt.logs.joint_angles import angle_noise, measured_angles
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

FINER = 2.0
"""Ratio of the bandwidths of fitted and smoothed motion; the forces limit the fitted one."""
KNOTS_PER_PERIOD = 2.0
"""Knots per period of the fastest motion admitted."""
STEPS = 30
CONVERGED = 1e-4
"""The fit has converged when a step moves the parameters by less than this part of their standard deviations."""


class Linear(NamedTuple):
    """Readings of N samples, linearised: ``Σ_k by_motion[k]·δq⁽ᵏ⁾ + by_common·[g, ψ] = right``.

    By positions, speeds and accelerations (·, N, m, n), as far as they depend on them; by the first common unknowns
    (N, m, c); and (N, m).
    """

    by_motion: Sequence[Array]
    by_common: Array
    right: Array


class NumbersBeside(Protocol):
    """Numbers g (k,) beside ψ, at some values, and the readings of one experiment that depend on them."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the numbers."""

    @property
    def value(self) -> Array:
        """(k,) the numbers [SI]."""

    @property
    def known(self) -> Array:
        """Rows (·, k+1) of [g, right side] with what is known beside the experiments, errors of size one."""

    @property
    def unread(self) -> NDArray[np.bool_]:
        """(n,) True for joints of the machine whose position no channel reads itself."""

    def readings(self, q: Array) -> Linear:
        """The readings about a motion (N, n) and the present numbers, with independent errors of size one."""

    def forces(self, data: Experiment, psi: Array) -> Linear:
        """The forces of an experiment about its motion, ψ (p,) and the present numbers."""

    def moved(self, before: Array, after: Array, value: Array) -> Self:
        """With other numbers (k,), when the motion (N, n) has moved along."""


@dataclass(frozen=True, eq=False)
class NumbersGiven:
    """Numbers g (k,) for given ψ: ``root·g + by_psi·ψ = right`` with independent errors of size one."""

    names: tuple[str, ...]
    root: Array
    by_psi: Array
    right: Array

    @classmethod
    def of(cls, names: tuple[str, ...], rows: Array, where: str) -> NumbersGiven:
        """From the first rows (k, k+p+1) of a triangle.

        Raises:
            IdentifiabilityError: they do not determine all numbers.
        """
        k = len(names)
        weak = np.abs(np.diag(rows)) <= ROUNDING_TOLERANCE * np.max(np.abs(rows[:, :k]), axis=0, initial=0.0)
        if np.any(weak):
            raise IdentifiabilityError(f"nothing determines {', '.join(np.array(names)[weak])}", where=where,
                                       remedy="state how far it may be off, or fix it")
        return cls(names, rows[:, :k], rows[:, k:-1], rows[:, -1])

    def at(self, psi: Array) -> Array:
        """The most probable numbers (k,) or (N, k) for parameters ψ (p,) or (N, p)."""
        left = self.right - psi @ self.by_psi.T
        return np.asarray(np.linalg.solve(self.root, left.T).T)

    @property
    def slope(self) -> Array:
        """(k, p) how the most probable numbers change with ψ."""
        return np.asarray(-np.linalg.solve(self.root, self.by_psi))

    @property
    def covariance(self) -> Array:
        """(k, k) of the numbers where ψ is known."""
        inverse = np.linalg.inv(self.root)
        return np.asarray(inverse @ inverse.T)


@dataclass(frozen=True, eq=False)
class Stretch:
    """The spline over one uninterrupted stretch: samples `span`, and which coefficients give the motion there."""

    span: slice
    path: Spline
    support: Support

    @classmethod
    def over(cls, t: Array, span: slice, spacing: float, joints: int) -> Stretch:
        """With knots about `spacing` [s] apart, at rest at zero."""
        path = Spline.over(t[span], round(float(t[span][-1] - t[span][0]) / spacing), joints)
        return cls(span, path, path.support(t[span]))

    def rows(self, read: Linear, common: int) -> Rows:
        """What was read along it, of all samples' readings, with so many common unknowns."""
        own = read.by_common[self.span]
        by_common = np.concatenate([own, np.zeros((*own.shape[:2], common - own.shape[2]))], axis=2)
        return Rows(read.right[self.span], self.support.along([each[self.span] for each in read.by_motion]), by_common,
                    self.support.first * self.path.coefficients.shape[1])


class Elimination(NamedTuple):
    """Normal equations of a stretch, which give its coefficients for any common unknowns [g, ψ], and the QR factor of
    what all of its rows leave for these."""

    equations: Bordered
    triangle: Array


@dataclass(frozen=True, eq=False)
class Fitted:
    """An experiment whose motion is being fitted; `stiffness` (n,) is √λ/σ_q, `angles` (N, n) are the readings.

    `beside` are numbers that are unknown along with ψ; None without.
    """

    data: Experiment
    angles: Array
    sigma: Array
    stiffness: Array
    stretches: tuple[Stretch, ...]
    beside: NumbersBeside | None = None

    @classmethod
    def from_smoothed(cls, model: Model, data: Experiment, beside: NumbersBeside | None = None) -> Fitted:
        """From the smoothed motion of an experiment."""
        log, motion = data.log, data.motion
        angles = measured_angles(model, log)
        stated = angle_noise(model, log)
        sigma = np.where(stated > 0, stated, np.std(angles - motion.q, axis=0))
        sigma = np.maximum(sigma, 1e-9 * np.maximum(np.std(angles, axis=0), 1e-3))
        rate = (len(log.t) - 1) / float(log.t[-1] - log.t[0])
        fastest = np.minimum(FINER * motion.bandwidth, rate / 4)
        if model.machine.bandwidth is not None:
            fastest = np.minimum(fastest, np.maximum(model.machine.bandwidth, motion.bandwidth))
        stiffness = np.sqrt(rate) / (2 * np.pi * fastest) ** 3 / sigma
        edges = np.flatnonzero(np.diff(motion.segment, prepend=motion.segment[0] - 1, append=motion.segment[-1] + 1))
        spacing = 1 / (KNOTS_PER_PERIOD * float(np.max(fastest)))
        stretches = tuple(Stretch.over(log.t, slice(a, b), spacing, angles.shape[1])
                          for a, b in pairwise(edges))
        start = cls(data, angles, sigma, stiffness, stretches)
        start = start._along(start._eliminated([start._angles(0 * angles)]), np.zeros(0))
        return replace(start, beside=beside, sigma=sigma if beside is None else np.where(beside.unread, np.inf, sigma))

    @property
    def motion(self) -> tuple[Array, Array, Array]:
        """q, qd and qdd (N, n)."""
        q, qd, qdd = (np.concatenate(parts) for parts in zip(*(
            motion(stretch.path, stretch.support)[:3] for stretch in self.stretches), strict=True))
        return q, qd, qdd

    @property
    def experiment(self) -> Experiment:
        """The experiment with the fitted motion, of which the ends of stretches take part, too."""
        q, qd, qdd = self.motion
        off = np.std(q - self.angles, axis=0) / self.sigma
        note = ("motion fitted together with the parameters; residuals of the angles, in standard deviations of "
                f"their sensors: {', '.join(f'{x:.2f}' for x in off)}")
        motion = replace(self.data.motion, q=q, qd=qd, qdd=qdd, interior=np.ones(len(q), dtype=bool),
                         notes=(*self.data.motion.notes, note))
        return replace(self.data, motion=motion)

    @property
    def numbers(self) -> Array:
        """(k,) the numbers beside ψ; empty without."""
        return np.zeros(0) if self.beside is None else self.beside.value

    def moved(self, eliminated: Sequence[Elimination], common: Array, part: float = 1.0) -> Fitted:
        """After `part` of the step that is most probable with common unknowns [g, ψ]."""
        made = self._along(eliminated, common, part)
        if self.beside is None:
            return made
        value = self.numbers + part * (common[: len(self.numbers)] - self.numbers)
        return replace(made, beside=self.beside.moved(self.motion[0], made.motion[0], value))

    def _along(self, eliminated: Sequence[Elimination], common: Array, part: float = 1.0) -> Fitted:
        shape = (-1, self.angles.shape[1])
        return replace(self, stretches=tuple(
            replace(stretch, path=stretch.path.moved(part * one.equations.inner(common).reshape(shape)))
            for stretch, one in zip(self.stretches, eliminated, strict=True)))

    def _angles(self, q: Array) -> Linear:
        """The readings of the angles about a motion (N, n)."""
        by_q = np.tile(np.diag(1 / self.sigma), (len(q), 1, 1))
        return Linear([by_q], np.zeros((*q.shape, 0)), (self.angles - q) / self.sigma)

    def eliminated(self, model: Model, psi: Array, covariance: Array, weights: Array | None) -> list[Elimination]:
        """Eliminate the motion from rows linearised at ψ, whose forces err by `covariance` (n, n) over `weights`."""
        data = self.experiment
        if self.beside is None:
            (K, *_), force = data.equations(psi)
            forces = Linear(model.over(model.force_by_motion, *data.inputs(), psi), K, force)
        else:
            forces = self.beside.forces(data, psi)
        white = whitening(data.known, covariance)
        if weights is not None:
            white = white * np.sqrt(weights)[:, None, :]
        right = white @ np.where(data.known, forces.right, 0.0)[:, :, None]
        read = [self._angles(data.motion.q),
                Linear([white @ by for by in forces.by_motion], white @ forces.by_common, right[:, :, 0])]
        return self._eliminated(read if self.beside is None else [*read, self.beside.readings(data.motion.q)])

    def _eliminated(self, read: Sequence[Linear]) -> list[Elimination]:
        found, common = [], max(each.by_common.shape[2] for each in read)
        for stretch in self.stretches:
            path = stretch.path
            blocks = [path.jerk(self.stiffness, common), *(stretch.rows(each, common) for each in read)]
            equations = Bordered.of(blocks, path.coefficients.size, path.width * path.coefficients.shape[1], common)
            found.append(Elimination(equations, triangle(*map(equations.projected, blocks))))
        return found


@dataclass(frozen=True, eq=False)
class FittedMotion:
    """ψ (p,), the information of all readings about it, ``‖R·ψ − r‖² + rest``, and the motion for any ψ nearby.

    `numbers` are those beside ψ, for any ψ nearby; None without.
    """

    fitted: Sequence[Fitted]
    eliminated: Sequence[list[Elimination]]
    psi: Array
    R: Array
    r: Array
    rest: float
    numbers: NumbersGiven | None = None

    def motion(self, psi: Array) -> list[Fitted]:
        """The motions that are most probable with parameters ψ (p,)."""
        common = _common(self.numbers, psi)
        return [one.moved(some, common) for one, some in zip(self.fitted, self.eliminated, strict=True)]

    def experiments(self, psi: Array) -> tuple[Experiment, ...]:
        """The experiments with these motions."""
        return tuple(one.experiment for one in self.motion(psi))


def initial_guess(model: Model, experiments: Sequence[Experiment],
                  beside: Sequence[NumbersBeside] = ()) -> list[Fitted]:
    """Experiments with the motion that their angles alone make most probable."""
    return [Fitted.from_smoothed(model, data, beside[k] if beside else None) for k, data in enumerate(experiments)]


def fit(model: Model, fitted: Sequence[Fitted], covariance: Array, weights: Sequence[Array] | None,
        psi: Array, most_probable: Callable[[Array, Array], Array], where: str) -> FittedMotion:
    """Fit motion and parameters together.

    Args:
        model: whose parameters.
        fitted: experiments, with the initial guess of the motion.
        psi: (p,) initial guess of the parameters.
        covariance: (n, n) of the forces' errors in one sample.
        weights: (N, n) for each experiment, by which squared residuals of forces are multiplied.
        most_probable: from (R, r) to ψ, with whatever priors and constraints there are.
        where: for error messages.

    Raises:
        IdentifiabilityError: nothing determines a number beside ψ.
        SolverError: the steps did not converge.
    """
    part, last = 1.0, np.inf
    for _ in range(STEPS):
        eliminated = [one.eliminated(model, psi, covariance, None if weights is None else weights[k])
                      for k, one in enumerate(fitted)]
        whole = _joined([each for some in eliminated for each in some], fitted[0].beside)
        numbers = None if fitted[0].beside is None else NumbersGiven.of(
            fitted[0].beside.names, whole[: len(fitted[0].numbers)], where)
        R, r, rest = split(whole[len(fitted[0].numbers):, len(fitted[0].numbers):])
        target = most_probable(R, r)
        common = _common(numbers, target)
        length = float(np.linalg.norm(whole[:-1, :-1] @ (common - np.concatenate([fitted[0].numbers, psi]))))
        part = 1.0 if length < last else part / 2  # the step before was too long
        if length < CONVERGED:
            return FittedMotion(fitted, eliminated, target, R, r, rest, numbers)
        psi = psi + part * (target - psi)
        fitted = [one.moved(some, common, part) for one, some in zip(fitted, eliminated, strict=True)]
        last = length
    raise SolverError(f"the fit of motion and parameters did not converge in {STEPS} steps", where=where,
                      remedy="smooth the motion instead, or state the sensors' accuracy and the machine's bandwidth")


def _common(numbers: NumbersGiven | None, psi: Array) -> Array:
    """The common unknowns [g, ψ] that are most probable with ψ (p,)."""
    return psi if numbers is None else np.concatenate([numbers.at(psi), psi])


def _joined(eliminated: Sequence[Elimination], beside: NumbersBeside | None) -> Array:
    """The triangle of all common unknowns [g, ψ] and the right side, with what is known beside the experiments."""
    rows = [each.triangle for each in eliminated]
    if beside is not None:
        known = np.zeros((len(beside.known), rows[0].shape[1]))
        known[:, : len(beside.names)], known[:, -1] = beside.known[:, :-1], beside.known[:, -1]
        rows.append(known)
    return triangle(*rows)
