"""Actuator forces and their derivatives by motion, parameters and uncertain geometry, in one function."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.fitted_motion import Linear
from hydroopt.kernels.expression_graph import program
from hydroopt.kernels.native import Runner
from hydroopt.machine.geometry import Geometry
from hydroopt.model.kinematics import coordinates
from hydroopt.model.model import Model
from hydroopt.model.regressor import Dynamics
from hydroopt.spatial.inertia import Array


class ForcesByGeometry:
    """Forces (r,) of a model's machine as a function of its motion (n,), ψ (p,) and numbers g (k,) of its geometry.

    Attributes:
        function: (q, qd, qdd[, pressure], psi, g) → the forces (r,), and their derivatives by q, qd, qdd (r, n), by ψ
            (r, p) and by g (r, k); jumps of dry friction count as zero.
    """

    def __init__(self, model: Model, numbers: Sequence[str]) -> None:
        own = coordinates(model.machine)
        symbols = {name: ca.SX.sym(name) for name in numbers}
        dynamics = Dynamics(Geometry(model.machine, symbols), own, model.terms)
        psi, g = ca.SX.sym("psi", len(model.parameters)), ca.vertcat(ca.SX(0, 1), *symbols.values())
        pressure = {"pressure": dynamics.pressure} if model.needs_pressure else {}
        given = {**own._asdict(), **pressure, "psi": psi, "g": g}
        force = dynamics.forces(psi, actuator_inertia=model.actuator_inertia)
        outputs = [force, *(ca.jacobian(force, x) for x in (*own, psi, g))]
        made = ca.Function("forces_by_geometry", [*given.values()], [ca.densify(x) for x in outputs], [*given],
                           ["force", "by_q", "by_qd", "by_qdd", "by_psi", "by_g"])
        self.function = program(made).function()
        self._runner = Runner()

    def over(self, *state: Array) -> list[Array]:
        """The outputs of `function` at N samples of the motion, each (N, r, columns)."""
        return self._runner.over(self.function, *state)

    def at(self, data: Experiment, psi: Array, g: Array) -> Linear:
        """The forces of an experiment, linearised about its motion, ψ (p,) and g (k,)."""
        force, by_q, by_qd, by_qdd, by_psi, by_g = self.over(*data.inputs(), psi, g)
        right = data.force - force[:, :, 0] + by_psi @ psi + by_g @ g
        return Linear([by_q, by_qd, by_qdd], np.concatenate([by_g, by_psi], axis=2), right)
