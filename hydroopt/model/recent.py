"""What was made of a machine before, for machines that are read again and again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

KEPT = 4
"""How many are kept."""
Made = TypeVar("Made")


class Recent(Generic[Made]):
    """The last few that were made, each for what equals what it was asked for.

    >>> kept = Recent[list[int]]()
    >>> kept.of("a", list) is kept.of("a", list), kept.of("a", list) is kept.of("b", list)
    (True, False)
    """

    def __init__(self) -> None:
        self._kept: list[tuple[Any, Made]] = []

    def of(self, asked: Any, make: Callable[[], Made]) -> Made:
        """What was made for the same before, or is made now."""
        found = next((one for one in list(self._kept) if one[0] == asked), None) or (asked, make())
        self._kept[:] = [found, *(other for other in self._kept if other is not found)][:KEPT]
        return found[1]
