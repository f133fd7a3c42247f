"""Nonlinear least squares within bounds: damped Gauss-Newton steps, whatever linear algebra takes them.

A `Place` of the search holds the residuals of all blocks and their derivatives there, and takes steps from it. Unknowns
that only a few rows depend on (the angles of a pose, corrections of readings, coefficients of splines) it eliminates in
its own way, so that `bounded_step` sees the others alone. `DenseRows` is the place without such unknowns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, NamedTuple, Protocol, Self, TypeVar

import numpy as np
from scipy.linalg import qr, svd

from hydroopt.estimation.inference.identifiability import ROUNDING_TOLERANCE
from hydroopt.spatial.inertia import Array

LEAST, LARGEST = 1e-3, 1e3
"""First damping after a step that hardly lowered the squares, see `bounded_step`, and the one from which on rounding,
or a corner of the model, keeps any step from it."""
POOR, GOOD = 0.25, 0.75
"""Parts of a promised fall, below and above which the next step is damped more and less (Marquardt 1963)."""
LIGHTER, HEAVIER = 5.0, 2.0
"""Factors of a damping that falls, and that rises: along curved valleys small rises let steps be long (Transtrum and
Sethna 2012)."""


class Step(NamedTuple):
    """A change (n,) of the unknowns, by how much the squares should fall, and how many directions the rows determine.

    `length` is that of the change, without its damping where no bound holds, in standard deviations.
    """

    change: Array
    promised: float
    rank: int
    length: float


class Place(Protocol):
    """Unknowns with the residuals there."""

    @property
    def cost(self) -> float:
        """Sum of squared residuals, or of what a robust loss makes of them."""

    def step(self, damping: float) -> Step:
        """The step to where the linearised squares are least within the bounds."""

    def after(self, change: Array) -> Self:
        """The place that a change (n,) of the unknowns leads to; eliminated ones follow, nearly."""

    def corrected(self) -> Self:
        """The same place with the eliminated unknowns exactly as they follow; itself where they do."""


P = TypeVar("P", bound=Place)


class Minimum(NamedTuple, Generic[P]):
    """Where the search ended, after how many accepted steps, and the last step that it found.

    `stuck` is True where no step lowered the squares, `converged` where none was left to make.
    """

    place: P
    steps: int
    last: Step
    converged: bool
    stuck: bool


def minimise(start: P, *, tolerance: float, relative: float = 0.0, steps: int = 100) -> Minimum[P]:
    """The place with the least squares that Gauss-Newton steps lead to.

    Args:
        start: initial guess, within its bounds.
        tolerance: length of a step, in standard deviations, that ends the search.
        relative: part of the squares by which a step must promise to lower them; of less, the search ends, too.
        steps: greatest number of steps, the refused ones included.

    >>> rows = lambda x: (np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]), np.array([[-20 * x[0], 10.0], [-1.0, 0.0]]))
    >>> found = minimise(DenseRows(rows, np.array([-1.2, 1.0])), tolerance=1e-9)
    >>> found.converged, found.place.x.round(6).tolist()
    (True, [1.0, 1.0])
    """
    here, damping, accepted = start, 0.0, 0
    for _ in range(steps):
        step = here.step(damping)
        if step.length**2 <= max(tolerance**2, relative * here.cost):
            if (exact := here.corrected()) is here:
                return Minimum(here, accepted, step, converged=True, stuck=False)
            here = exact
            continue
        there = here.after(step.change)
        fall, rounding = here.cost - there.cost, ROUNDING_TOLERANCE * here.cost + tolerance**2
        if not fall >= -rounding and (exact := here.corrected()) is not here:
            here = exact  # its squares were not those of its unknowns
            continue
        if not fall >= POOR * step.promised - rounding:
            damping = HEAVIER * damping or LEAST
        elif fall > GOOD * step.promised:
            damping = damping / LIGHTER if damping > ROUNDING_TOLERANCE else 0.0
        if fall >= -rounding:
            here, accepted = there, accepted + 1
        if damping > LARGEST:
            return Minimum(here, accepted, step, converged=False, stuck=True)
    return Minimum(here, accepted, step, converged=False, stuck=False)


def bounded_step(rows: Array, damping: float = 0.0, lower: Array | None = None, upper: Array | None = None, *,
                 size: Array | None = None, truncation: float = ROUNDING_TOLERANCE) -> Step:
    """The change δ (n,) with the least ``‖J·δ + r‖²`` between bounds, damped (Levenberg-Marquardt).

    Directions that the rows do not determine stay.

    Args:
        rows: (m, n + 1) of [J, r].
        damping: part of the largest squared singular value that is added to all of them.
        lower: (n,) least changes; unknowns whose bounds are equal are held. `upper` (n,) the largest.
        size: (n,) of the columns, by which they are divided; their lengths by default.
        truncation: singular value, relative to the largest, below which a direction counts as not determined.
    """
    n = rows.shape[1] - 1
    lower = np.full(n, -np.inf) if lower is None else np.minimum(lower, 0.0)
    upper = np.full(n, np.inf) if upper is None else np.maximum(upper, 0.0)
    free = np.flatnonzero(upper > lower)
    rows, change = rows[:, [*free, n]], np.zeros(n)
    if len(rows) > 2 * n:
        rows = np.asarray(qr(rows, mode="r", check_finite=False)[0][: len(free) + 1])
    unit: Array = np.linalg.norm(rows[:, :-1], axis=0) if size is None else size[free]
    unit = np.where(unit > 0, unit, 1.0)
    u, s, vt = svd(rows[:, :-1] / unit, full_matrices=False, check_finite=False)
    kept = s > truncation * s.max(initial=0.0)
    u, s, vt = u[:, kept], s[kept], vt[kept]
    along = u.T @ rows[:, -1]
    curved = np.sqrt(s**2 + damping * np.max(s, initial=0.0) ** 2)
    toward = s * along / curved
    own = -(vt.T @ (toward / curved)) / unit
    if held := bool(np.any((own < lower[free]) | (own > upper[free]))):
        from scipy.optimize import lsq_linear  # noqa: PLC0415 — it takes longer to load than most searches

        own = np.clip(lsq_linear((curved[:, None] * vt) * unit, -toward, (lower[free], upper[free]), "bvls").x,
                      lower[free], upper[free])
    change[free] = own
    moved = s * (vt @ (unit * own))
    return Step(change, float(-2 * along @ moved - moved @ moved), len(s),
                float(np.linalg.norm(moved if held else along)))


@dataclass(frozen=True, eq=False)
class DenseRows:
    """A place whose rows depend on all unknowns.

    Attributes:
        rows: x (n,) -> residuals (m,) and their Jacobian (m, n).
        x: (n,) the unknowns.
        size, truncation: of `bounded_step`.
    """

    rows: Callable[[Array], tuple[Array, Array]]
    x: Array
    size: Array | None = None
    truncation: float = ROUNDING_TOLERANCE

    @cached_property
    def linearised(self) -> tuple[Array, Array]:
        """Residuals (m,) and their Jacobian (m, n)."""
        return self.rows(self.x)

    @property
    def cost(self) -> float:
        """Sum of squared residuals."""
        residual = self.linearised[0]
        return float(residual @ residual)

    def step(self, damping: float) -> Step:
        """See `bounded_step`."""
        residual, jacobian = self.linearised
        return bounded_step(np.column_stack([jacobian, residual]), damping, size=self.size, truncation=self.truncation)

    def after(self, change: Array) -> Self:
        """At other unknowns."""
        return replace(self, x=self.x + change)

    def corrected(self) -> Self:
        """Itself, since nothing is eliminated."""
        return self
