"""Motion and parameters fitted together, with errors in angles and in pressures.

The motion of each joint is a quintic spline q(t) = B(t)·c. With parameters ψ it is the most probable one:

    Σ ((q_measured − B·c)/σ_q)² + λ/σ_q²·∫ (B'''·c)² dt + Σ ((f − f(B·c, Ḃ·c, B̈·c, ψ))/σ_f)²  →  min over c and ψ.

Gauss-Newton steps with exact derivatives solve it. A spline's coefficients meet only their neighbours, so that an
orthogonal sweep along time (the square-root information filter of Bierman 1977) eliminates them one by one; what is
left is ``‖R·ψ − r‖²``, the information of angles and forces about the parameters, the uncertainty of the motion
included. Every estimator, prior and constraint applies to it as it does after smoothing.

Numbers of the geometry may be unknown along with ψ (`numbers_beside`): they are the first common unknowns, so that the
same sweep leaves what all readings say of both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import SolverError
from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.folding import split, triangle
from hydroopt.estimation.dynamic.numbers_beside import NumbersBeside, NumbersGiven, Readings
from hydroopt.estimation.inference.whitening import whitened
from hydroopt.logs.joint_angles import angle_noise, measured_angles
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

DEGREE, ORDER = 5, 6
FINER = 2.0
"""Ratio of the bandwidths of fitted and smoothed motion; the forces limit the fitted one."""
KNOTS_PER_PERIOD = 2.0
"""Knots per period of the fastest motion admitted."""
STEPS = 30
TOGETHER = 16
"""Intervals whose rows left for the parameters are folded at a time: few factorisations are faster than many."""
CONVERGED = 1e-4
"""The fit has converged when a step moves the parameters by less than this part of their standard deviations."""


@cache
def _cardinal() -> Array:
    """(6, 6): powers 1, u, …, u⁵ to the six quintic B-splines of evenly spaced knots that are not zero at 0 ≤ u < 1."""
    from scipy.interpolate import BSpline, PPoly  # noqa: PLC0415 (its import takes longer than most identifications)

    spline = BSpline.basis_element(np.arange(ORDER + 1.0))
    pieces = PPoly.from_spline((spline.t, spline.c, DEGREE))
    at = [int(np.searchsorted(pieces.x, DEGREE - j, side="right")) - 1 for j in range(ORDER)]
    return np.column_stack([pieces.c[::-1, k] for k in at])  # the j-th of the six began DEGREE − j knots ago


_GAUSS = np.polynomial.legendre.leggauss(3)


def _splines(u: Array, derivative: int, spacing: float) -> Array:
    """Values (N, 6) of the six splines' derivatives at places u (N,) in their knot interval."""
    polynomials = _cardinal()
    for _ in range(derivative):
        polynomials = polynomials[1:] * np.arange(1, len(polynomials))[:, None]
    return (u[:, None] ** np.arange(len(polynomials))) @ polynomials / spacing**derivative


@dataclass(frozen=True, eq=False)
class SplineStretch:
    """The spline over one uninterrupted stretch: samples `span`, their knot intervals, and coefficients c (k, n).

    `basis` are values and first and second derivatives of the six splines at each sample, `rough` the rows (3, 6) with
    ``Σ (rough·c)² = ∫ q'''²`` over an interval.
    """

    span: slice
    interval: NDArray[np.intp]
    basis: tuple[Array, Array, Array]
    rough: Array
    coefficients: Array

    @classmethod
    def over(cls, t: Array, span: slice, spacing: float, joints: int) -> SplineStretch:
        """With knots about `spacing` [s] apart."""
        times = t[span]
        count = max(1, round(float(times[-1] - times[0]) / spacing))
        spacing = float(times[-1] - times[0]) / count
        place = (times - times[0]) / spacing
        interval = np.minimum(place.astype(np.intp), count - 1)
        basis = [_splines(place - interval, order, spacing) for order in range(3)]
        rough = _splines(0.5 + 0.5 * _GAUSS[0], 3, spacing) * np.sqrt(_GAUSS[1] / 2 * spacing)[:, None]
        return cls(span, interval, (basis[0], basis[1], basis[2]), rough, np.zeros((count + DEGREE, joints)))

    @property
    def motion(self) -> list[Array]:
        """q, qd and qdd (N, n)."""
        around = self.coefficients[self.interval[:, None] + np.arange(ORDER)]
        return [np.einsum("mk,mkj->mj", basis, around) for basis in self.basis]


@dataclass(frozen=True, eq=False)
class Elimination:
    """Eliminated coefficients of a stretch: rows that give each c from the next five and the common unknowns [g, ψ],
    and what is left for these."""

    rows: list[Array]
    last: Array
    triangle: Array

    def back(self, common: Array) -> Array:
        """Steps (k, n) of the coefficients at which common unknowns are most probable."""
        n = len(self.rows[0])
        tail, width = np.append(-common, 1.0), ORDER * n
        step = np.zeros((len(self.rows) + DEGREE, n))
        step[-DEGREE:] = np.linalg.solve(self.last[:, n:width], self.last[:, width:] @ tail).reshape(DEGREE, n)
        for i in range(len(self.rows) - 1, -1, -1):
            row = self.rows[i]
            known = row[:, width:] @ tail - row[:, n:width] @ step[i + 1 : i + ORDER].ravel()
            step[i] = np.linalg.solve(row[:, :n], known)
        return step


@dataclass(frozen=True, eq=False)
class Fitted:
    """An experiment whose motion is being fitted; `stiffness` (n,) is √λ/σ_q, `angles` (N, n) are the readings.

    `beside` are numbers that are unknown along with ψ; None without.
    """

    data: Experiment
    angles: Array
    sigma: Array
    stiffness: Array
    stretches: tuple[SplineStretch, ...]
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
        stretches = tuple(SplineStretch.over(log.t, slice(a, b), spacing, angles.shape[1])
                          for a, b in pairwise(edges))
        start = cls(data, angles, sigma, stiffness, stretches)
        start = start._along([start._sweep(stretch, None, None) for stretch in stretches], np.zeros(0))
        return replace(start, beside=beside, sigma=sigma if beside is None else np.where(beside.unread, np.inf, sigma))

    @property
    def motion(self) -> tuple[Array, Array, Array]:
        """q, qd and qdd (N, n)."""
        q, qd, qdd = (np.concatenate(parts) for parts in zip(*[s.motion for s in self.stretches], strict=True))
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

    def moved(self, sweeps: Sequence[Elimination], common: Array, part: float = 1.0) -> Fitted:
        """After `part` of the step that sweeps lead to with common unknowns [g, ψ]."""
        made = self._along(sweeps, common, part)
        if self.beside is None:
            return made
        value = self.numbers + part * (common[: len(self.numbers)] - self.numbers)
        return replace(made, beside=self.beside.moved(self.motion[0], made.motion[0], value))

    def _along(self, sweeps: Sequence[Elimination], common: Array, part: float = 1.0) -> Fitted:
        return replace(self, stretches=tuple(replace(s, coefficients=s.coefficients + part * sweep.back(common))
                                             for s, sweep in zip(self.stretches, sweeps, strict=True)))

    def sweeps(self, model: Model, psi: Array, covariance: Array, weights: Array | None) -> list[Elimination]:
        """Eliminate the motion from rows linearised at ψ, whose forces err by `covariance` (n, n) over `weights`."""
        data = self.experiment
        rows = ForceRows.linearised(model, data, psi, covariance, weights, self.beside)
        readings = None if self.beside is None else self.beside.readings(data.motion.q)
        return [self._sweep(stretch, rows, readings) for stretch in self.stretches]

    def _sweep(self, stretch: SplineStretch, forces: ForceRows | None, readings: Readings | None) -> Elimination:
        n, p = self.angles.shape[1], 0 if forces is None else forces.by_common.shape[2]
        width, unit = ORDER * n, np.eye(n)

        def rows(values: Array, size: Array, right: Array) -> Array:
            by_c = np.einsum("mk,ab->makb", values, unit * size).reshape(-1, width)
            return np.hstack([by_c, np.zeros((len(by_c), p)), (right * size).reshape(-1, 1)])

        count = len(stretch.coefficients) - DEGREE
        starts = np.searchsorted(stretch.interval, np.arange(count + 1))
        angles = self.angles[stretch.span]
        left: Array = np.zeros((0, width + p + 1))
        remaining: Array = np.zeros((p + 1, p + 1))
        kept, pending = [], []
        for i in range(count):
            here, active = slice(starts[i], starts[i + 1]), stretch.coefficients[i : i + ORDER]
            values = stretch.basis[0][here]
            blocks = [left, rows(values, 1 / self.sigma, angles[here] - values @ active),
                      rows(stretch.rough, self.stiffness, -stretch.rough @ active)]
            inside = slice(stretch.span.start + here.start, stretch.span.start + here.stop)
            if forces is not None:
                blocks.append(forces.of(inside, [basis[here] for basis in stretch.basis]))
            if readings is not None:
                blocks.append(_reading_rows(readings, inside, values, p))
            folded = triangle(*blocks, np.zeros((width, width + p + 1)))  # never fewer rows than coefficients
            kept.append(folded[:n])
            rest = folded[n:width]
            left = np.hstack([rest[:, n:width], np.zeros((len(rest), n)), rest[:, width:]])
            pending.append(folded[width:, width:])
            if len(pending) == TOGETHER or i == count - 1:
                remaining = triangle(remaining, *pending)
                pending = []
        return Elimination(kept, rest, remaining)


@dataclass(frozen=True, eq=False)
class FittedMotion:
    """ψ (p,), the information of all readings about it, ``‖R·ψ − r‖² + rest``, and the motion for any ψ nearby.

    `numbers` are those beside ψ, for any ψ nearby; None without.
    """

    fitted: Sequence[Fitted]
    sweeps: Sequence[list[Elimination]]
    psi: Array
    R: Array
    r: Array
    rest: float
    numbers: NumbersGiven | None = None

    def motion(self, psi: Array) -> list[Fitted]:
        """The motions that are most probable with parameters ψ (p,)."""
        common = _common(self.numbers, psi)
        return [one.moved(some, common) for one, some in zip(self.fitted, self.sweeps, strict=True)]

    def experiments(self, psi: Array) -> tuple[Experiment, ...]:
        """The experiments with these motions."""
        return tuple(one.experiment for one in self.motion(psi))


@dataclass(frozen=True, eq=False)
class ForceRows:
    """Forces of an experiment linearised in motion and common unknowns, (N, …); `taken` (N, n) states which count."""

    by_motion: Array
    by_common: Array
    right: Array
    taken: NDArray[np.bool_]
    covariance: Array

    @classmethod
    def linearised(cls, model: Model, data: Experiment, psi: Array, covariance: Array,
                   weights: Array | None, beside: NumbersBeside | None) -> ForceRows:
        """At the experiment's motion, at ψ and at the numbers beside it: ``by_motion·δ + by_common·[g, ψ] = right``."""
        if beside is None:
            by_motion = np.stack(model.over(model.force_by_motion, *data.inputs(), psi), axis=2)
            (by_common, *_), right = data.equations(psi)
        else:
            by_motion, by_psi, by_numbers, right = beside.forces(data, psi)
            by_common = np.concatenate([by_numbers, by_psi], axis=2)
        root = np.ones_like(right) if weights is None else np.sqrt(weights)
        return cls(by_motion * root[:, :, None, None], by_common * root[:, :, None], right * root, data.known,
                   covariance)

    def of(self, span: slice, basis: list[Array]) -> Array:
        """Rows (·, 6n+p+1) of independent errors of size one, by coefficients, p common unknowns and right side."""
        by_c = sum(np.einsum("mk,mab->makb", values, self.by_motion[span, :, order])
                   for order, values in enumerate(basis))
        m, n = self.right[span].shape
        block = np.concatenate([by_c.reshape(m, n, -1), self.by_common[span], self.right[span][:, :, None]], axis=2)
        return whitened(block, self.taken[span], self.covariance)


def _reading_rows(readings: Readings, span: slice, basis: Array, common: int) -> Array:
    """Rows (·, 6n+p+1) of some samples' readings, by coefficients, p common unknowns and right side."""
    by_q, by_numbers = readings.by_q[span], readings.by_numbers[span]
    samples, m, k = by_numbers.shape
    by_c = np.einsum("mk,mab->makb", basis, by_q).reshape(samples, m, -1)
    block = np.concatenate([by_c, by_numbers, np.zeros((samples, m, common - k)), readings.right[span][:, :, None]],
                           axis=2)
    return np.asarray(block.reshape(samples * m, -1))


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
        sweeps = [one.sweeps(model, psi, covariance, None if weights is None else weights[k])
                  for k, one in enumerate(fitted)]
        whole = _joined([sweep for some in sweeps for sweep in some], fitted[0].beside)
        numbers = None if fitted[0].beside is None else NumbersGiven.of(
            fitted[0].beside.names, whole[: len(fitted[0].numbers)], where)
        R, r, rest = split(whole[len(fitted[0].numbers):, len(fitted[0].numbers):])
        target = most_probable(R, r)
        common = _common(numbers, target)
        length = float(np.linalg.norm(whole[:-1, :-1] @ (common - np.concatenate([fitted[0].numbers, psi]))))
        part = 1.0 if length < last else part / 2  # the step before was too long
        if length < CONVERGED:
            return FittedMotion(fitted, sweeps, target, R, r, rest, numbers)
        psi = psi + part * (target - psi)
        fitted = [one.moved(some, common, part) for one, some in zip(fitted, sweeps, strict=True)]
        last = length
    raise SolverError(f"the fit of motion and parameters did not converge in {STEPS} steps", where=where,
                      remedy="smooth the motion instead, or state the sensors' accuracy and the machine's bandwidth")


def _common(numbers: NumbersGiven | None, psi: Array) -> Array:
    """The common unknowns [g, ψ] that are most probable with ψ (p,)."""
    return psi if numbers is None else np.concatenate([numbers.at(psi), psi])


def _joined(sweeps: Sequence[Elimination], beside: NumbersBeside | None) -> Array:
    """The triangle of all common unknowns [g, ψ] and the right side, with what is known beside the experiments."""
    rows = [sweep.triangle for sweep in sweeps]
    if beside is not None:
        known = np.zeros((len(beside.known), rows[0].shape[1]))
        known[:, : len(beside.names)], known[:, -1] = beside.known[:, :-1], beside.known[:, -1]
        rows.append(known)
    return triangle(*rows)
