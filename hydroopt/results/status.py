"""Whether an answer can be trusted."""

from enum import StrEnum


class Status(StrEnum):
    """Whether an answer can be trusted: `OK`, `SUSPECT` (converged, but something contradicts it), or `FAILED`.

    >>> Status("suspect") is Status.SUSPECT
    True
    """

    OK = "ok"
    SUSPECT = "suspect"
    FAILED = "failed"
