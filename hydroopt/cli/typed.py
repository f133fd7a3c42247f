"""The words of the command that runs."""

from __future__ import annotations

from contextvars import ContextVar

WORDS: ContextVar[tuple[str, ...]] = ContextVar("words", default=())
"""Name and arguments as typed; empty where no command runs."""
