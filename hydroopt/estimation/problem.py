"""An identification problem that a user can read and extend; solving it never changes it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import casadi as ca
import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.experiment import Experiment, experiment, force_noise
from hydroopt.inertia import Array
from hydroopt.machine import Machine
from hydroopt.model.build import Model
from hydroopt.parameters import ParameterSet
from hydroopt.signals.conditioning import Smoothing
from hydroopt.signals.log import Log

Loss = Literal["squares", "huber", "student_t"]


class Named(Mapping[str, Any]):
    """Parameters by name, as the solver at hand writes them: ``p["boom.m"]`` in CasADi or cvxpy."""

    def __init__(self, parameters: ParameterSet, symbols: Callable[[int], Any]) -> None:
        self._parameters, self._symbols = parameters, symbols

    def __getitem__(self, name: str) -> Any:
        return self._symbols(self._parameters.index(name))

    def __iter__(self) -> Iterator[str]:
        return iter(self._parameters.names)

    def __len__(self) -> int:
        return len(self._parameters)


Expression = Callable[[Named], Any]


def as_casadi(constraint: Constraint, named: Named) -> tuple[ca.SX, bool]:
    """Left minus right side of a constraint in CasADi, and whether the two must be equal (else left ≤ right).

    Raises:
        ProblemError: it is not a relation.
    """
    relation = constraint.relation(named)
    if not isinstance(relation, ca.SX) or relation.n_dep() != 2 or relation.op() not in (ca.OP_EQ, ca.OP_LE, ca.OP_LT):
        raise no_relation(constraint)
    return relation.dep(0) - relation.dep(1), relation.op() == ca.OP_EQ


def no_relation(constraint: Constraint) -> ProblemError:
    """The error of a constraint that returns something else than a relation."""
    return ProblemError("it does not return a relation", where=f"constraint '{constraint.name}'",
                        remedy="return left == right, left <= right or left >= right")


@dataclass(frozen=True)
class Constraint:
    """A relation between parameters that must hold: `relation` returns ``left == right``, ``<=`` or ``>=``."""

    name: str
    relation: Expression


@dataclass(frozen=True)
class Prior:
    """A linear expression of parameters known to be ``value ± sigma`` (SI, one standard deviation)."""

    name: str
    row: Array
    value: float
    sigma: float


@dataclass(frozen=True, eq=False)
class Problem:
    """Weighted residuals f − K·ψ of some experiments, priors and constraints on ψ.

    Attributes:
        model: what predicts the forces; its parameters carry nominal values, bounds and the file's confidences.
        experiments: training data.
        validation: data that the estimate has not seen and is judged by.
        force_std: (n,) standard deviation of each actuator's force reading; NaN where unknown. It is re-estimated
            from the residuals when `reweight` is set.
        constraints, priors: what was added by name.
        fixed: parameters held at a value.
        consistent: whether every body must be physically possible (positive definite pseudo-inertia).
        loss: of the residuals; the robust ones are solved by iterative reweighting.
    """

    model: Model
    experiments: tuple[Experiment, ...]
    validation: tuple[Experiment, ...] = ()
    force_std: Array = field(default_factory=lambda: np.empty(0))
    reweight: bool = True
    constraints: tuple[Constraint, ...] = ()
    priors: tuple[Prior, ...] = ()
    fixed: Mapping[str, float] = field(default_factory=dict)
    consistent: bool = True
    loss: Loss = "squares"

    @property
    def parameters(self) -> ParameterSet:
        """The unknowns ψ."""
        return self.model.parameters

    def subject_to(self, name: str, relation: Expression) -> Problem:
        """With a named constraint, e.g. ``lambda p: p["boom.m"] + p["stick.m"] == 2518``.

        The relation is called with parameters in cvxpy for the convex methods and in CasADi for ``nlp``.

        Raises:
            ProblemError: the name is taken.
        """
        if name in {c.name for c in self.constraints}:
            raise ProblemError("two constraints have the same name", where=f"constraint '{name}'",
                               remedy="give each a name of its own")
        return replace(self, constraints=(*self.constraints, Constraint(name, relation)))

    def with_prior(self, name: str, expression: str | Expression, *, value: float, sigma: float) -> Problem:
        """With a linear expression (or one parameter's name) known to be ``value ± sigma``, in SI.

        It adds to what the machine file already says.

        Raises:
            ProblemError: the expression is not linear in the parameters, or sigma is not positive.
        """
        if not sigma > 0:
            raise ProblemError(f"sigma is {sigma}", where=f"prior '{name}'",
                               remedy="give a positive one, or a constraint")
        symbols = ca.SX.sym("p", len(self.parameters))
        named = Named(self.parameters, lambda k: symbols[k])
        result = ca.SX(named[expression] if isinstance(expression, str) else expression(named))
        row = ca.jacobian(result, symbols)
        if result.shape != (1, 1) or ca.depends_on(row, symbols):
            raise ProblemError("the expression is not one linear sum of parameters", where=f"prior '{name}'",
                               remedy="use a constraint with method 'nlp' for anything else")
        at_zero = ca.Function("prior", [symbols], [row, result])(ca.DM.zeros(symbols.shape))
        prior = Prior(name, np.asarray(ca.DM(at_zero[0])).ravel(), value - float(at_zero[1]), sigma)
        return replace(self, priors=(*self.priors, prior))

    def fix(self, name: str, value: float | None = None) -> Problem:
        """With a parameter held at a value (SI), or at its nominal one.

        Raises:
            ProblemError: there is no such parameter.
        """
        k = self.parameters.index(name)
        return replace(self, fixed={**self.fixed, name: float(self.parameters.nominal[k] if value is None else value)})

    def with_loss(self, loss: Loss) -> Problem:
        """With another loss: ``squares``, ``huber`` or ``student_t``."""
        if loss not in ("squares", "huber", "student_t"):
            raise ProblemError(f"'{loss}' is no loss", where="loss", remedy="use squares, huber or student_t")
        return replace(self, loss=loss)

    @cached_property
    def prior_rows(self) -> tuple[Array, Array]:
        """Rows and right-hand side of ``‖A·ψ − b‖²``, the negative logarithm of all priors times two."""
        parameters = self.parameters
        values, vectors = np.linalg.eigh(parameters.information / _outer_information(parameters))
        known = values > 1e-12
        root = (np.sqrt(values[known])[:, None] * vectors[:, known].T) * np.sqrt(_size(parameters))
        rows = np.vstack([root, *[prior.row / prior.sigma for prior in self.priors]])
        right = np.concatenate([root @ parameters.nominal, [prior.value / prior.sigma for prior in self.priors]])
        return rows, right

    def __str__(self) -> str:
        lines = [f"identification of {self.model.machine.name}: {len(self.parameters)} parameters, "
                 f"{sum(int(e.inside.sum()) for e in self.experiments)} samples, loss {self.loss}"]
        lines += [f"  residual {a.name}: weight 1/{s:.4g} {'N' if 'cylinder' in type(a).__name__.lower() else 'N*m'}"
                  for a, s in zip(self.model.machine.actuators, self.force_std, strict=True)]
        lines += [f"  prior {p.name}: {p.value:.6g} ± {p.sigma:.3g}" for p in self.priors]
        lines += [f"  constraint {c.name}" for c in self.constraints]
        lines += [f"  fixed {name} = {value:.6g}" for name, value in self.fixed.items()]
        return "\n".join([*lines, "  physical consistency of every body" if self.consistent else ""]).rstrip()


def _size(parameters: ParameterSet) -> Array:
    diagonal = np.diag(parameters.information)
    return np.where(diagonal > 0, diagonal, 1.0)


def _outer_information(parameters: ParameterSet) -> Array:
    root = np.sqrt(_size(parameters))
    return np.outer(root, root)


def identification_problem(machine: Machine, logs: Sequence[Log], validation: Sequence[Log] = (), *,
                           smoothing: Smoothing | None = None, actuator_inertia: bool = True) -> Problem:
    """The dynamic identification problem of a machine and its logs.

    Args:
        machine: nominal description, with its confidences.
        logs: training data.
        validation: logs to judge the estimate by.
        smoothing: how angles are differentiated; a smoothing spline by default.
        actuator_inertia: whether barrels and rods belong to the model.

    Raises:
        LogError: a channel is missing or a log is too short.
        ProblemError: there is no log.
    """
    if not logs:
        raise ProblemError("there is no log to learn from", where="identification", remedy="give at least one")
    model = Model(machine, actuator_inertia=actuator_inertia)
    train, held_out = ([experiment(model, log, smoothing) for log in some] for some in (logs, validation))
    return Problem(model, tuple(train), tuple(held_out), force_noise(model))
