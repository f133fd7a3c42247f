"""Uncertain parameters of the dynamics, and what quantities that are linear in them are at most."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.machine.environment import CHASSIS
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

TINY = 1e-12
"""Square, of a length [m²] or a standard deviation [N², (N·m)², rad²], that keeps its root and quotients differentiable
where it vanishes."""


class UncertainParameters(NamedTuple):
    """A Gaussian of ψ: its mean (p,), and a root (p, k) of its covariance ``root·rootᵀ``.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> model = Model(load_machine("patu655_lift"))
    >>> stated = UncertainParameters.stated(model)
    >>> stated.mean.shape == (len(model.parameters),), np.all(np.isfinite(stated.root))
    (True, np.True_)
    """

    mean: Array
    root: Array

    @classmethod
    def stated(cls, model: Model) -> UncertainParameters:
        """By the machine file: its numbers and confidences; what has none counts as exact."""
        information = model.parameters.information
        known = np.flatnonzero(np.diag(information) > 0)
        root = np.zeros((len(information), len(known)))
        if known.size:
            root[known] = np.linalg.cholesky(np.linalg.inv(information[np.ix_(known, known)]))
        return cls(model.parameters.nominal, root)

    @classmethod
    def chassis(cls, machine: Machine) -> UncertainParameters:
        """Mass and first moment (4,) [kg, kg·m] of the chassis on the footprint, to first order in what is uncertain.

        >>> from hydroopt.machine.machine_file import load_machine
        >>> UncertainParameters.chassis(load_machine("cat215b")).mean.tolist()
        [6500.0, 0.0, 0.0, -7800.0]
        """
        assert machine.footprint is not None
        mass, com = machine.footprint.mass, np.array(machine.footprint.com)
        off = [machine.notes.get(path, Note()).spread(*numbers) or 0.0
               for path, numbers in zip(CHASSIS, ((mass,), machine.footprint.com), strict=True)]
        root = np.diag([off[0], *3 * [mass * off[1]]])
        root[1:, 0] = off[0] * com
        return cls(np.array([mass, *mass * com]), root)

    def of(self, value: ca.SX, psi: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Mean and standard deviation of expressions (m,) that are linear in ψ about the mean."""
        slope = ca.substitute(ca.jacobian(value, psi), psi, ca.DM(self.mean))
        spread = slope @ ca.sparsify(ca.DM(np.where(np.abs(self.root) > 0, self.root, 0.0)))
        variance = ca.sum2(spread * spread) if spread.size2() else ca.SX(value.size1(), 1)
        return ca.substitute(value, psi, ca.DM(self.mean)), ca.sqrt(variance + TINY)
