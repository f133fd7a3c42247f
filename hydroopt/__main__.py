"""The process of the command `hydroopt`, also as `python -m hydroopt`: what holds before anything is imported."""

import os.path
import sys

# `python -m hydroopt` looks for modules in the working directory before all others; ours are not there, unless we are
if __name__ == "__main__" and not sys.flags.safe_path and sys.path[0] != os.path.dirname(os.path.dirname(__file__)):
    del sys.path[0]

import gc
import os
import signal
from types import FrameType

RARE = 50_000, 20, 20
"""Thresholds of Python's garbage collector: at its own a command spends up to a third of its time on the search for
cycles among the operations of a machine's equations."""
INTERRUPTED = b"hydroopt: interrupted; no result was written\n"
PLUGINS = "PYDANTIC_DISABLE_PLUGINS"
"""Environment variable without which pydantic reads the metadata of every installed package, in search of plug-ins
that watch validation: 30 ms, for which a command has no use."""


def main() -> None:
    """Run the command, with standard streams that can always be written, and Ctrl-C at any moment."""
    gc.set_threshold(*RARE)
    os.environ.setdefault(PLUGINS, "1")
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else whoever started it lets Ctrl-C be ignored
        signal.signal(signal.SIGINT, _end)
    from hydroopt.support import interrupt, memory  # noqa: PLC0415

    if memory.limit() < memory.LEAST:
        sys.stderr.write(f"hydroopt: memory: this process may use {memory.limit() / 1e6:.0f} MB; raise the limit "
                         f"(ulimit -v) to {memory.LEAST // 10**6} MB or more.\n")
        sys.exit(2)
    memory.few_threads()
    from hydroopt.cli import main as run  # noqa: PLC0415
    from hydroopt.cli.streams import open_streams  # noqa: PLC0415

    streams = open_streams()
    code = 1
    try:
        interrupt.remember()
        run()
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
    finally:
        interrupt.end_at_once(code)
    code = streams.close(code)
    gc.freeze()  # the process ends: to search what it leaves for cycles takes as long as NumPy to load
    sys.exit(code)


def _end(_: int, __: FrameType | None) -> None:
    """End while the command is being imported, when there is nothing to clean up."""
    os.write(2, INTERRUPTED)
    os._exit(130)


if __name__ == "__main__":
    main()
