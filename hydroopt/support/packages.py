"""Packages beside hydroopt: what installs those that only some jobs need, and versions of those that are there."""

from __future__ import annotations

import platform
from contextlib import suppress
from importlib import import_module, metadata
from typing import Any

from hydroopt.errors import HydrooptError, ProblemError

DISTRIBUTION = "hydroopt-calibration"
"""Name of the distribution that holds the package `hydroopt`; on the package index `hydroopt` is another project."""
EXTRAS = {"dask": "cluster", "distributed": "cluster",
          "pyarrow": "parquet",
          "mujoco": "mjcf", "h5py": "hdf5", "asammdf": "mdf", "mcap": "ros", "rosbags": "ros", "nptdms": "tdms",
          "python_calamine": "xlsx"}
"""The extra of the distribution that installs a module; tests hold it against pyproject.toml."""
PACKAGES = ("casadi", "clarabel", "cvxpy", "numpy", "scipy")
"""Packages that determine the last bits of a result, besides the settings and the processor."""


def needed(module: str, purpose: str, *, where: str, error: type[HydrooptError] = ProblemError) -> Any:
    """A module of a library that an extra installs.

    Args:
        module: such as ``pyarrow.parquet``.
        purpose: what needs it, with a verb: "Parquet files are read with pyarrow".
        where: what is being done or read.
        error: the kind of error.

    Raises:
        HydrooptError: of this kind, the library is not installed; it names the command that installs it.

    >>> needed("json", "texts are read with json", where="text").loads("1")
    1
    """
    library = module.partition(".")[0]
    try:
        return import_module(module)
    except ModuleNotFoundError as missing:
        if missing.name != library:  # it is there, but damaged
            raise
        raise error(f"{purpose}, which is not installed", where=where, remedy=install(library)) from None


def install(library: str) -> str:
    """The command that installs a library.

    >>> install("mcap")
    "run pip install 'hydroopt-calibration[ros]'"
    """
    return f"run pip install '{DISTRIBUTION}[{EXTRAS[library]}]'"


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
    found = {"python": platform.python_version(), "hydroopt": version()}
    for name in (*PACKAGES, *packages):
        with suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found
