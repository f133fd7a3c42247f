"""What is stated of a machine's parameters: bounds, priors, conditions and constraints, as all solvers take them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, Self

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.inference import conditions as physics
from hydroopt.estimation.inference import statements
from hydroopt.estimation.inference.conditions import Condition, ScaledBody
from hydroopt.estimation.inference.constraints import Constraint, Expression
from hydroopt.estimation.inference.prior_conflict import Statement
from hydroopt.estimation.inference.priors import Prior, linear_prior, prior_squares, stated_priors
from hydroopt.model.model import Model
from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.spatial.inertia import Array

Distance = Literal["gaussian", "log-det"]


@dataclass(frozen=True, eq=False)
class StatedProblem:
    """Parameters ψ of a model with all that is stated of them; residuals come to solvers as ``‖R·ψ − r‖²``.

    Attributes:
        model: what predicts the forces; its parameters carry nominal values, bounds and the file's confidences.
        constraints, priors, physics: what was added by name.
        fixed: parameters held at a value.
        consistent: whether every body must be physically possible (positive definite pseudo-inertia).
        data_alone: whether statements of the machine file about bodies and bounds are left out.
        distance: of a body from its nominal one: ``gaussian`` takes the file's confidences of its ten numbers, and
            ``log-det`` the entropic divergence of pseudo-inertias, which knows no frame, weighted by the confidence of
            the mass (`hydroopt.estimation.inference.conditions.scaled_bodies`).
    """

    model: Model
    constraints: tuple[Constraint, ...] = field(default=(), kw_only=True)
    priors: tuple[Prior, ...] = field(default=(), kw_only=True)
    physics: tuple[Condition, ...] = field(default=(), kw_only=True)
    fixed: Mapping[str, float] = field(default_factory=dict, kw_only=True)
    consistent: bool = field(default=True, kw_only=True)
    data_alone: bool = field(default=False, kw_only=True)
    distance: Distance = field(default="gaussian", kw_only=True)

    @property
    def where(self) -> str:
        """Subject for error messages."""
        return f"identification of {self.model.machine.name}"

    @property
    def parameters(self) -> ParameterSet:
        """The unknowns ψ."""
        return self.model.parameters

    def subject_to(self, name: str, relation: str | Expression) -> Self:
        """With a named constraint: a linear one as text, ``"boom.m + stick.m == 2518 kg"``, or a function.

        The function, e.g. ``lambda p: p["boom.m"] + p["stick.m"] == 2518``, is called with parameters [SI] in CasADi;
        one that is not linear is called again by the convex methods, which are the default, in cvxpy.

        Raises:
            ProblemError: the name exists already, or the text is no linear relation between parameters.
            UnitError: its units do not fit together.
        """
        if isinstance(relation, str):
            return self._with(statements.read_constraint(self.parameters, name, relation))
        constraint = Constraint(name, relation)
        if linear := statements.linear_relation(self.parameters, constraint):
            return self._with(linear)
        self._refuse_taken(name)
        return replace(self, constraints=(*self.constraints, constraint))

    def with_prior(self, name: str, expression: str | Expression, *, value: float | None = None,
                   sigma: float | None = None) -> Self:
        """With a linear expression or function, such as ``"boom.m + stick.m"``, known to be ``value ± sigma``, in SI.

        Without these a text states all with units: ``"boom.m + stick.m = 2518 +- 25 kg"``. It joins the file's priors.

        Raises:
            ProblemError: the expression is not linear in the parameters, sigma is not positive, or the name is taken.
            UnitError: units of the text do not fit together.
        """
        self._refuse_taken(name)
        if value is None or sigma is None:
            prior = statements.read_prior(self.parameters, name, str(expression))
        else:
            total = statements.sum_of(self.parameters, name, expression)
            prior = linear_prior(self.parameters, name, total, value, sigma)
        return replace(self, priors=(*self.priors, prior))

    def with_total_mass(self, name: str, bodies: Sequence[str], value: float,
                        sigma: float | None = None) -> Self:
        """With the mass [kg] of several bodies together: exactly, or as a prior ``value ± sigma``.

        Raises:
            ProblemError: an unknown body, none or one twice, a value or sigma that is not positive, or the name is
                taken.
        """
        if not 0 < value < np.inf:
            raise ProblemError(f"{value:g} kg is not a mass", where=f"'{name}'", remedy="give a positive number")
        row = physics.total_mass(self.parameters, name, bodies)
        if sigma is not None:
            return self.with_prior(name, lambda p: sum(p[f"{body}.m"] for body in bodies), value=value, sigma=sigma)
        return self._with(physics.equal(name, self.parameters, row, value))

    def identical(self, name: str, owners: Sequence[str]) -> Self:
        """With identical parts: bodies of equal inertial parameters, or actuators of equal friction.

        Raises:
            ProblemError: an unknown owner, fewer than two, bodies mixed with actuators, or the name is taken.
        """
        return self._with(physics.likeness(self.parameters, name, owners))

    def symmetric(self, owner: str, plane: str) -> Self:
        """With a body whose mass is symmetric about a plane of its frame: ``xy``, ``xz`` or ``yz``.

        Raises:
            ProblemError: an unknown body or plane, or the file or an earlier call states it already.
        """
        return self._with(physics.symmetry(self.parameters, owner, plane))

    def _with(self, condition: Condition) -> Self:
        self._refuse_taken(condition.name)
        return replace(self, physics=(*self.physics, condition))

    def with_distance(self, distance: Distance) -> Self:
        """With another distance of bodies from their nominal ones: ``gaussian`` or ``log-det``.

        With the relative confidence σ of a body's mass, the log-det one is least at the nominal body; as a density over
        the ten numbers, from which intervals come, it is that of a Wishart distribution, with the mean
        (1 + 10·σ²)·nominal and a spread of the mass of about 2·σ: state σ well below 30 %.

        Raises:
            ProblemError: there is no such distance, or a nominal body could not exist and has no log-det distance.
        """
        if distance not in ("gaussian", "log-det"):
            raise ProblemError(f"'{distance}' is not a distance", where="distance", remedy="use gaussian or log-det")
        changed = replace(self, distance=distance)
        assert changed.bodies is not None  # raises where there is no such distance
        return changed

    def _refuse_taken(self, name: str) -> None:
        if name in {*self.constraint_names, *(p.name for p in (*self.stated_priors, *self.priors))}:
            raise ProblemError("two constraints or priors have the same name", where=f"'{name}'",
                               remedy="give each its own name")

    def fix(self, name: str, value: float | None = None) -> Self:
        """With a parameter held at a value (SI), or at its nominal one.

        Raises:
            ProblemError: there is no such parameter.
        """
        k = self.parameters.index(name)
        if value is not None and not np.isfinite(value):
            raise ProblemError(f"it cannot be fixed at {value}", where=f"parameter '{name}'",
                               remedy="give a finite value")
        return replace(self, fixed={**self.fixed, name: float(self.parameters.nominal[k] if value is None else value)})

    def by_data_alone(self) -> Self:
        """Without statements and bounds of the machine file about its bodies and friction, for method ``wls``."""
        return replace(self, data_alone=True)

    @property
    def stated_constraints(self) -> tuple[str, ...]:
        """What the machine file or the user demands of ψ, apart from confidences and physically consistent bodies."""
        machine = self.model.machine
        bounded = [] if self.data_alone else [
            f"the bounds of {name}" for name in self.parameters.names if name in machine.numbers
            and (note := machine.notes.get(machine.numbers[name].path)) and (note.lower, note.upper) != (None, None)]
        return (*self.constraint_names, *(prior.name for prior in (*self.stated_priors, *self.priors)),
                *(f"{name} fixed" for name in self.fixed), *bounded)

    @property
    def constraint_names(self) -> tuple[str, ...]:
        """Names of what the machine file states and of what was added."""
        return tuple(dict.fromkeys([c.name for c in self.conditions] + [c.name for c in self.constraints]))

    @cached_property
    def bodies(self) -> tuple[ScaledBody, ...]:
        """All bodies, scaled to about one, with the weight of their log-det distance if that is the one."""
        return physics.scaled_bodies(self.parameters, distances=self.distance == "log-det")

    @cached_property
    def conditions(self) -> tuple[Condition, ...]:
        """What the machine file states of its bodies, and what was added of this kind."""
        model = self.model
        stated = () if self.data_alone else physics.stated(model.machine, self.parameters,
                                                           actuator_inertia=model.actuator_inertia)
        return (*stated, *self.physics)

    def statements(self, *, consistent: bool) -> tuple[Condition, ...]:
        """Physically consistent bodies on request, and `conditions`."""
        p = len(self.parameters)
        return (*(physics.consistency(body, p) for body in self.bodies if consistent or self.distance == "log-det"),
                *self.conditions)

    def requirements(self, *, consistent: bool) -> tuple[Condition, ...]:
        """All conditions on ψ but the user's own functions: bounds and `statements`."""
        return (*physics.bounds(self.parameters, self.fixed, self.bodies if consistent else ()),
                *self.statements(consistent=consistent))

    @cached_property
    def stated_priors(self) -> tuple[Prior, ...]:
        """Total masses that the machine file states with a confidence."""
        return () if self.data_alone else stated_priors(self.model.machine, self.parameters)

    @cached_property
    def own_statements(self) -> tuple[Statement, ...]:
        """The linear constraints, priors and fixed values that were added, apart from those of the machine file."""
        size = {one.name: float(np.max(np.abs(one.rows))) for one in self.physics}
        priors = [Statement(one.name, one.row / (factor := float(np.max(np.abs(one.row)))), one.value / factor,
                            one.sigma / factor) for one in self.priors]
        fixed = [Statement(name, np.eye(len(self.parameters))[self.parameters.index(name)], value)
                 for name, value in self.fixed.items()]
        return (*(Statement(one.name, row / size[one.name], value / size[one.name], at_least=one.kind == "nonnegative")
                  for one in self.physics for row, value in zip(one.rows, one.right, strict=True)), *priors, *fixed)

    @property
    def without_statements(self) -> Self:
        """The problem without anything that was added, apart from faults that are estimated."""
        return replace(self, constraints=(), priors=(), physics=(), fixed={})

    @cached_property
    def _gaussian(self) -> tuple[Array, Array]:
        """Information (p, p) and mean (p,) of the machine file's confidences.

        A log-det distance is none of a square; the Gaussian of its mean and covariance stands in for it.
        """
        information, mean = self.parameters.information.copy(), self.parameters.nominal.copy()
        for body in self.bodies if self.distance == "log-det" else ():
            mean[body.columns] *= body.spread
            information[body.columns, body.columns] = body.information
        return information, mean

    @cached_property
    def prior_rows(self) -> tuple[Array, Array]:
        """Rows and right-hand side of ``‖A·ψ − b‖²``, the negative logarithm of all priors times two."""
        return prior_squares(*self._gaussian, (*self.stated_priors, *self.priors))

    @cached_property
    def file_prior_rows(self) -> tuple[Array, Array]:
        """The same of the machine file's priors alone."""
        return prior_squares(*self._gaussian, self.stated_priors)

    @cached_property
    def square_rows(self) -> tuple[Array, Array]:
        """Rows and right-hand side of the quadratic priors only, without the log-det distance of bodies."""
        information = self.parameters.information.copy()
        for body in self.bodies if self.distance == "log-det" else ():
            information[body.columns, body.columns] = 0.0
        return prior_squares(information, self.parameters.nominal, (*self.stated_priors, *self.priors))

    def prior_misfit(self, psi: Array) -> float:
        """The negative logarithm of all priors times two, at ψ (p,)."""
        rows, right = self.square_rows
        distances = sum(body.distance(psi[body.columns]) for body in self.bodies if body.weight)
        return float(np.sum((rows @ psi - right) ** 2)) + distances


def names_of(problem: StatedProblem, *, consistent: bool) -> tuple[str, ...]:
    """Names of all conditions and constraints, each once."""
    conditions = problem.requirements(consistent=consistent)
    return tuple(dict.fromkeys([c.name for c in conditions] + [c.name for c in problem.constraints]))
