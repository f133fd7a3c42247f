"""Standard output and error of the command: what cannot be printed never ends a run."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import Any


class Output(io.FileIO):
    """A standard stream that takes everything, and remembers why it could not pass it on.

    Attributes:
        error: the first one; None if all was printed.
    """

    error: OSError | None = None

    def write(self, data: Any) -> int:
        """Write, or drop what cannot be written: the reader is gone, or the disk is full."""
        if self.error is None:
            try:
                return super().write(data) or 0
            except OSError as error:
                self.error = error
        return memoryview(data).nbytes


class Streams:
    """Standard output and error of this process."""

    def __init__(self) -> None:
        self.out, self.err = Output(1, "w", closefd=False), Output(2, "w", closefd=False)

    def close(self, code: int) -> int:
        """The exit code of a command that would end with `code`: 2 if its output is not where it should be."""
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        error = self.out.error
        if code or error is None or error.errno == errno.EPIPE:  # whoever closes a pipe has read enough
            return code
        print(f"hydroopt: standard output: cannot be written ({error.strerror}); send it elsewhere.", file=sys.stderr,
              flush=True)
        return 2


def open_streams() -> Streams:
    """Make `sys.stdout` and `sys.stderr` streams that take everything, in any encoding, even where they were closed."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:  # a file that is opened later would get this number, and whatever is printed
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    made = Streams()
    for name, raw in (("stdout", made.out), ("stderr", made.err)):
        before = getattr(sys, name)
        setattr(sys, name, io.TextIOWrapper(
            io.BufferedWriter(raw), encoding=before.encoding if before else "utf-8", errors="backslashreplace",
            line_buffering=raw.isatty() or name == "stderr"))
    return made
