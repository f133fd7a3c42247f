"""The import of matplotlib, which python-control imports too."""

from __future__ import annotations

import logging
import os
from contextlib import chdir
from importlib import import_module
from pathlib import Path


def import_matplotlib() -> None:
    """Import matplotlib, but not the file ``matplotlibrc`` of the working directory, which it would read before others.

    >>> import_matplotlib()
    """
    log = logging.getLogger("matplotlib")
    level = log.level
    log.setLevel(logging.ERROR)  # it warns where it cannot keep its list of fonts
    try:
        os.chdir(Path.cwd())
    except OSError:  # the way back is closed, and so is the way to any file there
        import_module("matplotlib")
    else:
        with chdir(Path(__file__).parent):
            import_module("matplotlib")
    finally:
        log.setLevel(level)
