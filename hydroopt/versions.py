"""Versions of hydroopt and of the packages that determine its results."""

from __future__ import annotations

import platform
from importlib import metadata

DISTRIBUTION = "hydroopt-calibration"
"""Name of the distribution that holds the package `hydroopt`; on the package index `hydroopt` is another project."""
PACKAGES = ("casadi", "clarabel", "cvxpy", "numpy", "scipy")
"""Packages that determine the last bits of a result, besides the settings and the processor."""


def version() -> str:
    """Version of hydroopt.

    >>> version() == versions()["hydroopt"]
    True
    """
    return metadata.version(DISTRIBUTION)


def versions(*packages: str) -> dict[str, str]:
    """Versions of Python, of hydroopt, of the packages that determine results, and of further packages, by name.

    >>> list(versions("control"))
    ['python', 'hydroopt', 'casadi', 'clarabel', 'cvxpy', 'numpy', 'scipy', 'control']
    """
    return {"python": platform.python_version(), "hydroopt": version(),
            **{name: metadata.version(name) for name in (*PACKAGES, *packages)}}
