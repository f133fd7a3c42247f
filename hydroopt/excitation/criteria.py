"""Criteria of experiment design: functions of the information matrix, with exact derivatives.

D: logarithm of the determinant of the covariance, divided by its size; A: logarithm of the mean variance; E: logarithm
of the largest variance of any combination; condition: logarithm of the condition number of the weighted regressor.
D, A and E are Kiefer's family Φₚ of means of the covariance's eigenvalues with p = 0, 1 and ∞, so that D ≤ A ≤ E.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.linalg.lapack import dtrtri

from hydroopt.errors import IdentifiabilityError, ProblemError
from hydroopt.estimation.inference.identifiability import (
    ROUNDING_TOLERANCE,
    Identifiability,
    random_states,
    structural,
)
from hydroopt.kernels.expression_graph import program
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

CRITERIA = ("D", "A", "E", "condition")
SLOW, FLAT = 0.04, 1e-3
"""Speed of the joints [rad/s, m/s] over which the sign of Coulomb friction is smoothed for derivatives, and the part of
it that is left where a pin does not turn with the joints."""
FAINT_INFORMATION = 1e-5
"""Square root of the information added to every scaled parameter: negligible, but it keeps every criterion finite."""
FAINT = 1e-6
"""Information added to every parameter that poses are to determine, in units of its scale or of that of an average
pose: keeps every determinant and variance finite."""
PROMISING = 64
"""Candidates whose eigenvalues are computed."""


class DesignParameters(NamedTuple):
    """The base parameters that a motion is to determine, with their scales and prior information.

    Attributes:
        structure: identifiability by ideal motion; its basis is that of β = grouping @ ψ.
        columns: (r,) of the regressor that belong to the basis.
        scale: (r,) typical sizes of the parameters.
        weight: (n,) inverse standard deviation of the actuators' forces.
        prior: (r, r) information before the motion, in scaled parameters: zero, or priors and earlier logs.
        focus: positions in the basis to which the criterion is restricted; all if empty.
        focus_names: the names of parameters, parts or groups in focus.
        bayesian: whether the machine file's priors are part of `prior`.
        measured: (p, p) information on ψ of logs already measured, part of `prior`; None without logs.
    """

    structure: Identifiability
    columns: Array
    scale: Array
    weight: Array
    prior: Array
    focus: tuple[int, ...] = ()
    focus_names: tuple[str, ...] = ()
    bayesian: bool = False
    measured: Array | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Base parameters in words."""
        return tuple(self.structure.expression(k) for k in range(len(self.columns)))


def presumed_noise(model: Model) -> Array:
    """Standard deviation (n,) of the actuators' forces [N, N·m] that is assumed before anything is measured.

    It follows from the accuracy of the sensors; where the file states none it is a tenth of the RMS force in random
    states.
    """
    states = random_states(model, 400, np.random.default_rng(0))
    K = model.over(model.regressor, *states)[0] * np.hypot(model.parameters.scale, model.parameters.nominal)
    typical = np.sqrt(np.mean(np.sum(K**2, axis=2), axis=0))
    stated = force_noise(model)
    return np.where(np.isfinite(stated), stated, 0.1 * typical)


def design_parameters(model: Model, sigma: Array, *, focus: Sequence[str] = (), bayesian: bool = False,
                      measured: Array | None = None) -> DesignParameters:
    """The base parameters of a machine that a motion is to determine, in the fixed basis of ideal motion.

    Args:
        model: whose parameters.
        sigma: (n,) standard deviation of the actuators' forces [N, N·m].
        focus: names to which the criterion is restricted: a parameter, a part (``stick``), ``payload`` (the body of the
            last link) or ``friction``.
        bayesian: whether the machine file's priors count as information.
        measured: (p, p) information of earlier logs on ψ; a base parameter has that of its column.

    Raises:
        ProblemError: no parameter begins with a name of `focus`.
        IdentifiabilityError: those that do are not identifiable by any motion.
    """
    structure = structural(model)
    if not structure.basis:
        raise IdentifiabilityError("no motion identifies a parameter of this machine", where=model.machine.name,
                                   remedy="state the 'body' of its links and the 'friction' of its drives")
    columns = np.array(structure.basis)
    parameters = model.parameters
    scale = parameters.scale[columns]
    prior: Array = np.zeros((len(columns), len(columns)))
    if bayesian:
        # prior of β = G·ψ; a parameter without a confidence adds next to no information
        stated = np.where(np.diag(parameters.information) > 0, 1.0, 0.0)
        informed = parameters.information + np.diag((1 - stated) / (1e3 * parameters.scale) ** 2)
        prior = np.asarray(np.linalg.inv(structure.grouping @ np.linalg.inv(informed) @ structure.grouping.T))
    if measured is not None:
        prior = prior + measured[np.ix_(columns, columns)]
    return DesignParameters(structure, columns, scale, 1 / sigma, prior * np.outer(scale, scale),
                            _focused(model, structure, focus), tuple(focus), bayesian, measured)


def _focused(model: Model, structure: Identifiability, focus: Sequence[str]) -> tuple[int, ...]:
    places: list[int] = []
    for name in focus:
        last = model.machine.links[-1].name  # it carries the payload
        members = model.parameters.matching(name)
        if name == "payload" and not members:
            members = list(range(len(model.parameters)))[model.parameters.bodies.get(last, slice(0))]
        if not members:
            raise ProblemError(f"no parameter is called '{name}' or begins with it", where="focus",
                               remedy=f"use payload, friction, a part such as {model.machine.links[-1].name} or a "
                                      f"parameter such as {model.parameters.names[0]}")
        touched = np.flatnonzero(np.any(structure.grouping[:, members] != 0, axis=1))
        if not touched.size:
            raise IdentifiabilityError(f"no motion excites '{name}'", where="focus",
                                       remedy="focus on another parameter")
        places += [int(k) for k in touched if int(k) not in places]
    return tuple(places)


def refuse_criterion(criterion: str, focus: Sequence[object]) -> None:
    """Refuse an unknown criterion, or a focus where the criterion takes none.

    Raises:
        ProblemError: which, and what to use.
    """
    if criterion not in CRITERIA:
        raise ProblemError(f"'{criterion}' is not a criterion", where="criterion",
                           remedy=f"use one of {', '.join(CRITERIA)}")
    if criterion == "condition" and focus:
        raise ProblemError("the condition number is that of all parameters and takes no focus", where="criterion",
                           remedy="leave out the focus, or use D, A or E")


def criterion_value(criterion: str, factor: Array, focus: Array) -> tuple[float, Array]:
    """A criterion of the information RᵀR, and its derivative (r, r) by R.

    Where there is next to no information, R is small and the derivative large; by RᵀR it would be the square of that,
    and rounding would reach the gradient of a motion.

    Args:
        criterion: one of `CRITERIA`.
        factor: R (r, r), upper triangular.
        focus: (s, r) combinations whose variances count; the condition number takes all.
    """
    if criterion == "condition":
        left, s, axes = np.linalg.svd(factor)
        if not s[0] > 0:
            return np.inf, np.zeros_like(factor)
        least = max(s[-1], ROUNDING_TOLERANCE * s[0])
        by_first, by_last = np.outer(left[:, 0], axes[0]) / s[0], np.outer(left[:, -1], axes[-1]) / least
        return float(np.log(s[0] / least)), by_first - by_last * s[-1] / least
    root, info = dtrtri(factor)  # covariance = root·rootᵀ
    if info:
        return np.inf, np.zeros_like(factor)
    rows = focus @ root
    if criterion == "D":
        across, spread = np.linalg.qr(rows.T)
        return (float(2 * np.mean(np.log(np.abs(np.diag(spread))))),
                -2 * across @ (across.T @ root.T) / len(focus))
    across, inner, _ = np.linalg.svd(rows.T, full_matrices=False)
    if criterion == "A":
        total = float(np.sum(inner**2))
        return float(np.log(total / len(focus))), -2 * rows.T @ (rows @ root.T) / total
    return float(2 * np.log(inner[0])), -2 * np.outer(across[:, 0], across[:, 0] @ root.T)


def gains(rows: Array, covariance: Array, across: Array) -> Array:
    """By how much (K,) the whitened rows (K, u, f) of each candidate lower the sum of the variances of a task.

    Args:
        rows: what each candidate says about f parameters.
        covariance: (f, f) of these.
        across: (f, s) their covariance with the s combinations of the task.
    """
    core = np.eye(rows.shape[1]) + rows @ covariance @ rows.transpose(0, 2, 1)
    spread = rows @ across
    return np.asarray(np.einsum("kus,kus->k", spread, np.linalg.solve(core, spread)))


def scores(criterion: str, rows: Array, covariance: Array, focus: Array, pose: int = 0) -> Array:
    """Minus a criterion (K,) after each candidate alone is measured, as the logarithm of a size; more is better.

    Args:
        criterion: one of `CRITERIA`, of the covariance of the combinations in focus.
        rows: (K, u, f) whitened rows of each candidate.
        covariance: (f, f) of the parameters before.
        focus: (s, f) combinations.
        pose: a candidate whose value is exact: for E and the condition number it is −∞ for those of the others that
            improve the worst direction little.
    """
    across, before = covariance @ focus.T, focus @ covariance @ focus.T
    if criterion == "A":
        return np.asarray(-np.log(np.trace(before) - gains(rows, covariance, across)))
    core = np.eye(rows.shape[1]) + rows @ covariance @ rows.transpose(0, 2, 1)
    if criterion == "D" and len(focus) == len(covariance):  # by the determinant lemma
        return np.asarray(np.linalg.slogdet(core)[1] - np.linalg.slogdet(before)[1])
    spread = rows @ across
    after = before - spread.transpose(0, 2, 1) @ np.linalg.solve(core, spread)
    if criterion == "D":
        return np.asarray(-np.linalg.slogdet(after)[1])
    # eigenvalues take long: only of those that improve the worst direction most
    worst = np.linalg.eigh(before)[1][:, -1]
    promising = np.append(np.argsort((after @ worst) @ worst)[:PROMISING], pose)
    values = np.maximum(np.linalg.eigvalsh(after[promising]), 1e-300)
    score = np.full(len(rows), -np.inf)
    score[promising] = -np.log(values[:, -1]) + (np.log(values[:, 0]) if criterion == "condition" else 0.0)
    return score


def _smooth_sign(rate: ca.SX, states: Sequence[ca.SX]) -> ca.SX:
    """The sign of a rate of the states q, qd, qdd, smoothed over what slow joints make of it.

    So the speeds of a cylinder and of its pins change sign alike. Smoothed over one speed for all of them, their
    frictions would seem to be told apart near standstill, and a search would improve what no motion tells.
    """
    by_joint = ca.jacobian(rate, states[1])
    return rate / ca.sqrt(rate**2 + SLOW**2 * (ca.sumsqr(by_joint) + FLAT**2))


class Information:
    """Information of motions on the parameters, and the derivative of a criterion with respect to the joints'
    states."""

    def __init__(self, model: Model, parameters: DesignParameters, criterion: str) -> None:
        refuse_criterion(criterion, parameters.focus)
        self.model, self.parameters, self.criterion = model, parameters, criterion
        states, scale = model.coordinates, parameters.weight[:, None] * parameters.scale
        columns = parameters.columns.tolist()
        K = model.dynamics.regressor()[:, columns] * ca.DM(scale)
        exact = program(ca.Function("base_regressor", [*states], [K]))
        self.regressor, self.smooth = exact.function(), exact.function(_smooth_sign)
        K = self.smooth(*states)
        G = ca.SX.sym("G", K.numel())
        product = ca.dot(ca.vec(K), G)
        values, vectors = np.linalg.eigh(parameters.prior)
        self.prior_root: Array = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
        self._faint_root: Array = np.sqrt(np.maximum(values, FAINT_INFORMATION**2))[:, None] * vectors.T
        self.state_gradient = ca.Function(
            "state_gradient", [*states, G], [ca.vertcat(*(ca.gradient(product, x) for x in states))])

    def __reduce__(self) -> tuple[type[Information], tuple[object, ...]]:
        return Information, (self.model, self.parameters, self.criterion)

    def by(self, criterion: str) -> Information:
        """The same information, judged by another criterion."""
        made = Information.__new__(Information)
        made.__dict__ = self.__dict__ | {"criterion": criterion}
        return made

    @property
    def faint_root(self) -> Array:
        """Root (r, r) of what is known before the motion, and a little of what is not."""
        # equal information on all parameters would make standstill the motion with the best condition number
        return self.prior_root if self.criterion == "condition" else self._faint_root

    def factor(self, q: Array, qd: Array, qdd: Array, rate: float) -> Array:
        """R (r, r) with RᵀR the information on the scaled parameters of states (N, n), each weighted as `rate` samples.

        The regressor is ill-conditioned, and forming its square would lose half of the digits.
        """
        K = self.model.over(self.regressor, q, qd, qdd)[0]
        return self._factor(self.prior_root, K, rate)

    @staticmethod
    def _rows(prior_root: Array, K: Array, rate: float) -> Array:
        return np.vstack([prior_root, np.sqrt(rate) * K.reshape(-1, K.shape[2])])

    def _factor(self, prior_root: Array, K: Array, rate: float) -> Array:
        return np.asarray(np.linalg.qr(self._rows(prior_root, K, rate), mode="r"))

    def exact_value(self, q: Array, qd: Array, qdd: Array) -> float:
        """The criterion of samples (N, n), with the sign of friction as it is."""
        return self.of(self._factor(self.faint_root, self.model.over(self.regressor, q, qd, qdd)[0], 1.0))[0]

    def value(self, q: Array, qd: Array, qdd: Array, rate: float) -> float:
        """The criterion, with the sign of friction smoothed, as a design improves it."""
        return self.of(self._factor(self.faint_root, self.model.over(self.smooth, q, qd, qdd)[0], rate))[0]

    def value_and_slope(self, q: Array, qd: Array, qdd: Array, rate: float) -> tuple[float, Array]:
        """The criterion, and its derivative (N, 3n) by the states: q, then qd, then qdd."""
        K = self.model.over(self.smooth, q, qd, qdd)[0]
        orthogonal, factor = np.linalg.qr(self._rows(self.faint_root, K, rate))
        value, by_factor = self.of(factor)
        G = np.sqrt(rate) * (orthogonal[len(factor):] @ by_factor).reshape(K.shape)
        columns = G.transpose(0, 2, 1).reshape(len(q), -1)  # CasADi's order, column by column
        return value, self.model.over(self.state_gradient, q, qd, qdd, columns)[0][:, :, 0]

    def of(self, factor: Array) -> tuple[float, Array]:
        """The criterion of the information RᵀR, and its derivative (r, r) by R."""
        return criterion_value(self.criterion, factor, np.eye(len(factor))[list(self.parameters.focus) or slice(None)])
