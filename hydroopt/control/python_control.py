"""The library python-control, which an extra installs."""

from typing import TYPE_CHECKING

from hydroopt.extras import needed

if TYPE_CHECKING:
    import control
else:
    control = needed("control", "controllers are designed with python-control", where="closed loop")

__all__ = ["control"]
