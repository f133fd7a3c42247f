"""The library python-control; modules take it from here, since it imports matplotlib."""

from hydroopt.matplotlib_import import import_matplotlib

import_matplotlib()
import control  # noqa: E402

__all__ = ["control"]
