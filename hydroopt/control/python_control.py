"""The library python-control; modules take it from here, since it imports matplotlib."""

from typing import TYPE_CHECKING

from hydroopt.extras import needed
from hydroopt.matplotlib_import import import_matplotlib

if TYPE_CHECKING:
    import control
else:
    import_matplotlib()
    control = needed("control", "controllers are designed with python-control", where="closed loop")

__all__ = ["control"]
