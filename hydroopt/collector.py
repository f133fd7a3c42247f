"""Python's garbage collector beside jobs that make many small objects, as the operations of a machine's equations are.

At Python's own thresholds, 700, 10 and 10, such a job spends up to a third of its time on searching them for cycles.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

RARE = 50_000, 20, 20
"""Thresholds at which it is a few hundredths."""


@contextmanager
def rarely_collected() -> Iterator[None]:
    """Collect garbage at the thresholds `RARE`, if at all, and as before afterwards.

    >>> before = gc.get_threshold()
    >>> with rarely_collected():
    ...     gc.get_threshold() == RARE
    True
    >>> gc.get_threshold() == before
    True
    """
    before = gc.get_threshold()
    if before[0]:
        gc.set_threshold(*RARE)
    try:
        yield
    finally:
        gc.set_threshold(*before)
