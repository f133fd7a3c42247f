"""Versions of hydroopt and of the packages that determine its results."""

from __future__ import annotations

import platform
from importlib import metadata

from hydroopt.extras import DISTRIBUTION

PACKAGES = ("casadi", "clarabel", "cvxpy", "numpy", "scipy")
"""Packages that determine the last bits of a result, besides the settings and the processor."""
WITHOUT_SOLVERS = {"cvxpy": "cvxpy-base"}
"""Distributions that hold the same package without solvers of other projects."""


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
            **{name: _version(name) for name in (*PACKAGES, *packages)}}


def _version(package: str) -> str:
    try:
        return metadata.version(WITHOUT_SOLVERS.get(package, package))
    except metadata.PackageNotFoundError:
        return metadata.version(package)
