"""Linear systems as matrices with names, their responses, poles and zeros, and the closed loop of two of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hydroopt.spatial.inertia import Array

if TYPE_CHECKING:
    from hydroopt.control.python_control import control


INFINITE = 1e8
"""Size from which on a zero counts as one at infinity."""


class LinearSystem(NamedTuple):
    """x' = A·x + B·u, y = C·x + D·u; x' is the rate, or the state a period later.

    Attributes:
        A, B, C, D: (n, n), (n, m), (p, n) and (p, m).
        period: of the samples [s]; 0 for continuous time.
        states, inputs, outputs: their names; empty if they have none.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    period: float
    states: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()

    def response(self, z: Array) -> Array:
        """Transfer matrices C·(z − A)⁻¹·B + D (ω, p, m) at points (ω,) of the z plane, or of the s plane.

        The complex Schur form of A is triangular, so that all points share one decomposition (Laub 1981, with a
        triangle in place of Hessenberg's form).
        """
        from scipy.linalg import schur  # noqa: PLC0415 — it takes longer to load than C to be written

        T, U = schur(self.A, output="complex") if len(self.A) else (np.zeros((0, 0)), np.zeros((0, 0)))
        B, C = U.conj().T @ self.B, self.C @ U
        X = np.zeros((len(T), len(z), B.shape[1]), dtype=complex)
        for i in reversed(range(len(T))):
            X[i] = (B[i] + np.tensordot(T[i, i + 1:], X[i + 1:], 1)) / (z - T[i, i])[:, None]
        return np.asarray(np.moveaxis(np.tensordot(C, X, 1), 0, 1) + self.D)

    def steps(self, count: int) -> Array:
        """Outputs (count, p, m) of a system in discrete time, sample by sample, after a unit step of each input."""
        X, found = np.zeros_like(self.B), np.empty((count, *self.D.shape))
        for k in range(count):
            found[k] = self.C @ X + self.D
            X = self.A @ X + self.B
        return found

    @property
    def poles(self) -> Array:
        """Eigenvalues (n,) of A."""
        return np.asarray(np.linalg.eigvals(self.A))

    @property
    def zeros(self) -> Array:
        """Transmission zeros of a system with as many inputs as outputs: where its Rosenbrock matrix is singular."""
        from scipy.linalg import eigvals  # noqa: PLC0415 (as above)

        n, m = self.B.shape
        found = eigvals(np.block([[self.A, self.B], [self.C, self.D]]),
                        np.block([[np.eye(n), np.zeros((n, m))], [np.zeros((m, n + m))]]))
        return np.asarray(found[np.isfinite(found) & (np.abs(found) < INFINITE)])

    def python_control(self, name: str | None = None) -> control.StateSpace:
        """The same as python-control knows it; dots in names become underscores, as it demands.

        Raises:
            ProblemError: python-control is not installed.
        """
        from hydroopt.control.python_control import control  # noqa: PLC0415 — it takes seconds to load

        labels = {key: [signal(each) for each in names] for key, names in
                  (("states", self.states), ("inputs", self.inputs), ("outputs", self.outputs)) if names}
        return control.ss(self.A, self.B, self.C, self.D, *([self.period] if self.period else []), name=name, **labels)


def signal(name: str) -> str:
    """Name of a state, command or output in python-control, which allows no dots."""
    return name.replace(".", "_")


def closed_loop(plant: LinearSystem, feedback: LinearSystem, places: Sequence[int] = (),
                names: Sequence[str] = ()) -> LinearSystem:
    """From references of some of the plant's outputs to these outputs.

    Args:
        plant: without direct feedthrough; its inputs are the outputs of the feedback.
        feedback: of all outputs of the plant, less their references.
        places: of the outputs that have references.
        names: of these outputs; the references are called the same with ``_reference`` behind.
    """
    E = np.eye(len(plant.C))[:, list(places)]
    A = np.block([[plant.A + plant.B @ feedback.D @ plant.C, plant.B @ feedback.C],
                  [feedback.B @ plant.C, feedback.A]])
    B = -np.vstack([plant.B @ feedback.D @ E, feedback.B @ E])
    C = np.hstack([E.T @ plant.C, np.zeros((len(places), len(feedback.A)))])
    return LinearSystem(A, B, C, np.zeros((len(places),) * 2), plant.period, (*plant.states, *feedback.states),
                        tuple(f"{name}_reference" for name in names), tuple(names))
