"""Named parameters: the only place where names meet positions in a vector."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.machine.parameter_kind import INERTIAL_KINDS, ParameterKind
from hydroopt.spatial.inertia import Array
from hydroopt.support.input_file import similar
from hydroopt.support.notebook_card import Card, CardTable, Shown, figure
from hydroopt.units import in_print

__all__ = ["GROUPS", "ParameterKind", "ParameterSet"]

GROUPS: Mapping[str, Callable[[ParameterKind], bool]] = {
    "friction": lambda kind: kind.is_friction, "offset": lambda kind: kind is ParameterKind.FORCE_OFFSET}
"""Words that stand for all parameters of some kinds, wherever a user names parameters."""


@dataclass(frozen=True, eq=False, repr=False)
class ParameterSet(Shown):
    """Names with kind, unit, nominal value, bounds and prior, all in SI, each array of shape (p,).

    The prior is Gaussian about the nominal values; `information` (p, p) is the inverse of its covariance, with
    zeros where nothing is known. `scale` is a typical size, positive, that makes different units comparable.
    The ten inertial parameters of a body follow one another in the order of Eq. 4.12.
    """

    names: tuple[str, ...]
    kinds: tuple[ParameterKind, ...]
    units: tuple[str, ...]
    nominal: Array
    lower: Array
    upper: Array
    scale: Array
    information: Array

    def __repr__(self) -> str:
        return f"ParameterSet({len(self)} parameters, {int(np.sum(np.diag(self.information) > 0))} with a prior)"

    def card(self) -> Card:
        """What a notebook shows: one row a parameter."""
        return Card(repr(self), tables=[parameter_table(self)])

    def __len__(self) -> int:
        return len(self.names)

    @property
    def prior_std(self) -> Array:
        """Standard deviations (p,) of the priors, NaN where there is none."""
        return np.where(np.diag(self.information) > 0, self.scale, np.nan)

    @cached_property
    def positions(self) -> dict[str, int]:
        """Name to position."""
        return {name: k for k, name in enumerate(self.names)}

    @cached_property
    def bodies(self) -> dict[str, slice]:
        """Owner of each body to the positions of its ten inertial parameters."""
        return {self.owner(name): slice(k, k + len(INERTIAL_KINDS))
                for k, (name, kind) in enumerate(zip(self.names, self.kinds, strict=True))
                if kind is ParameterKind.MASS}

    def kind(self, name: str) -> ParameterKind:
        """Kind of the parameter of this name.

        Raises:
            ProblemError: see `index`.
        """
        return self.kinds[self.index(name)]

    def owner(self, name: str) -> str:
        """Part of the machine that a parameter belongs to: ``boom_cylinder.rod`` of ``boom_cylinder.rod.mc_x``.

        Raises:
            ProblemError: see `index`.
        """
        if self.kind(name) in (ParameterKind.LOCKED_ANGLE, ParameterKind.DRIFT):  # boom.locked.stage
            return name.partition(".")[0]
        return name.rpartition(".")[0]

    def places(self, *kinds: ParameterKind) -> list[int]:
        """Positions of all parameters of these kinds."""
        return [k for k, kind in enumerate(self.kinds) if kind in kinds]

    def matching(self, word: str) -> list[int]:
        """Positions of what a user's word stands for: one parameter, a part, or else a group of kinds (`GROUPS`)."""
        own = [k for k, name in enumerate(self.names) if name == word or name.startswith(f"{word}.")]
        return own or [self.positions[name] for name in self.grouped(*{word} & GROUPS.keys())]

    def grouped(self, *groups: str) -> tuple[str, ...]:
        """Names of the parameters of any of some groups of kinds (`GROUPS`)."""
        return tuple(name for name, kind in zip(self.names, self.kinds, strict=True)
                     if any(GROUPS[group](kind) for group in groups))

    def index(self, name: str) -> int:
        """Position of a name.

        Raises:
            ProblemError: there is no such parameter; the closest names are given.
        """
        try:
            return self.positions[name]
        except KeyError:
            close = similar(name, self.names)
            raise ProblemError("no parameter has this name", where=f"parameter '{name}'",
                               remedy=f"did you mean {' or '.join(close)}") from None

    def select(self, names: Iterable[str]) -> Sequence[int]:
        """Positions of several names."""
        return [self.index(name) for name in names]

    def nearest_bound(self, k: int, value: float) -> str:
        """The bound of the k-th parameter that is nearest to a value, as ``panda_joint2.compliance >= 0 rad/(N*m)``."""
        low = value - self.lower[k] < self.upper[k] - value
        return f"{self.names[k]} {'>=' if low else '<='} {self.lower[k] if low else self.upper[k]:.9g} {self.units[k]}"


def parameter_table(parameters: ParameterSet) -> CardTable:
    """Names with nominal values, standard deviations of the priors and bounds, for a notebook."""
    cells = zip(parameters.names, parameters.nominal, parameters.prior_std, parameters.units, parameters.lower,
                parameters.upper, strict=True)
    rows = [(name, figure(nominal, 6), "" if np.isnan(std) else figure(std, 3), in_print(unit),
             "" if np.isinf(low) else figure(low, 6), "" if np.isinf(high) else figure(high, 6))
            for name, nominal, std, unit, low, high in cells]
    return CardTable(("parameter", "nominal", "prior ±", "unit", "lower bound", "upper bound"), rows)
