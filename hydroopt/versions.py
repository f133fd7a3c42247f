"""Versions of hydroopt and of the packages that determine its results."""

from __future__ import annotations

import platform
from importlib import metadata

from hydroopt.extras import DISTRIBUTION

PACKAGES = ("casadi", "clarabel", "cvxpy", "numpy", "scipy")
"""Packages that determine the last bits of a result, besides the settings and the processor."""


def version() -> str:
    """Version of hydroopt.

    >>> version() == versions()["hydroopt"]
    True
    """
    return metadata.version(DISTRIBUTION)


def versions(*packages: str) -> dict[str, str]:
    """Versions of Python, of hydroopt, of packages that determine results, and of others, by name, as far as installed.

    >>> list(versions("control"))
    ['python', 'hydroopt', 'casadi', 'clarabel', 'cvxpy', 'numpy', 'scipy', 'control']
    """
    return {"python": platform.python_version(), "hydroopt": version(),
            **{name: found for name in (*PACKAGES, *packages) if (found := _version(name))}}


def _version(package: str) -> str:
    """Empty where an extra is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ""
