"""Named parameters: the only place where names meet positions in a vector."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property

from hydroopt.errors import ProblemError
from hydroopt.spatial.inertia import Array


@dataclass(frozen=True, eq=False)
class ParameterSet:
    """Names with unit, nominal value, bounds and prior, all in SI, each array of shape (p,).

    The prior is Gaussian about the nominal values; `information` (p, p) is the inverse of its covariance, with
    zeros where nothing is known. `scale` is a typical size, positive, that makes different units comparable.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    nominal: Array
    lower: Array
    upper: Array
    scale: Array
    information: Array

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def positions(self) -> dict[str, int]:
        """Name to position."""
        return {name: k for k, name in enumerate(self.names)}

    def index(self, name: str) -> int:
        """Position of a name.

        Raises:
            ProblemError: there is no such parameter; the closest names are given.
        """
        try:
            return self.positions[name]
        except KeyError:
            close = get_close_matches(name, self.names, n=3) or list(self.names[:3])
            raise ProblemError("no parameter has this name", where=f"parameter '{name}'",
                               remedy=f"did you mean {' or '.join(close)}") from None

    def select(self, names: Iterable[str]) -> Sequence[int]:
        """Positions of several names."""
        return [self.index(name) for name in names]
