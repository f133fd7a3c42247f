"""How far a long computation is, as it is reported to whoever started it."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Is called before each step of a computation."""

    def __call__(self, text: str, part: float | None = None, /) -> None:
        """Take note of what begins, and of the part of all work, 0 to 1, that is done before it, if that is known."""


def silent(text: str, part: float | None = None, /) -> None:
    """Report nothing."""
