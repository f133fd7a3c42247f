"""LAPACK's routines for bands and triangles, as SciPy compiles them, without loading the rest of SciPy.

`scipy.linalg` loads NumPy's test tools, f2py and adapters for all array libraries, which takes as long as a whole
identification. Its compiled module alone takes 4 ms; where that cannot be loaded alone, `scipy.linalg.lapack` is.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import numpy as np
from numpy.linalg import LinAlgError
from numpy.typing import NDArray

Array = NDArray[np.float64]


@cache
def _alone(name: str) -> Any:
    """A compiled module of `scipy.linalg` without that package; None where SciPy keeps its files elsewhere, or its
    libraries are found by its own start alone."""
    found = find_spec("scipy")
    folder = Path("" if found is None or found.origin is None else found.origin).parent / "linalg"
    for file in (folder / f"{name}{suffix}" for suffix in EXTENSION_SUFFIXES):
        spec = spec_from_file_location(name, file) if file.is_file() else None
        if spec is not None and spec.loader is not None:
            try:
                module = module_from_spec(spec)
                spec.loader.exec_module(module)
            except ImportError:
                return None
            return module
    return None


def _routines() -> Any:
    alone = None if "scipy.linalg" in sys.modules else _alone("_flapack")
    if alone is not None:
        return alone
    from scipy.linalg import lapack  # noqa: PLC0415 — loaded where it cannot be avoided

    return lapack


@contextmanager
def given_alone() -> Iterator[None]:
    """Let others that ask `scipy.linalg` for the addresses of LAPACK's routines, as Clarabel does, have them without
    loading that package."""
    names = [] if "scipy.linalg" in sys.modules else ["cython_blas", "cython_lapack"]
    modules = {f"scipy.linalg.{name}": module for name in names if (module := _alone(name)) is not None}
    sys.modules.update(modules)
    try:
        yield
    finally:
        for name, module in modules.items():
            if sys.modules.get(name) is module:
                del sys.modules[name]


routines = _routines()
"""LAPACK's routines by name, with the arguments of `scipy.linalg.lapack`."""


def banded_cholesky(band: Array) -> Array:
    """L of L·Lᵀ, both in lower band storage (w, n): row k holds what stands k below the diagonal.

    Raises:
        LinAlgError: the matrix is not positive definite.

    >>> banded_cholesky(np.array([[4.0, 5.0], [2.0, 0.0]]))[0].tolist()
    [2.0, 2.0]
    """
    factor, info = routines.dpbtrf(np.asarray_chkfinite(band), lower=1)
    if info:
        raise LinAlgError(f"the leading minor of order {info} is not positive definite")
    return np.asarray(factor)


def cholesky_solved(factor: Array, right: Array) -> Array:
    """x (n, …) of L·Lᵀ·x = right (n, …), L (w, n) of `banded_cholesky`."""
    columns = np.asarray_chkfinite(right, dtype=float).reshape(factor.shape[1], -1)
    solved, _ = routines.dpbtrs(factor, columns, lower=1)
    return np.asarray(solved).reshape(right.shape)


def banded_forward(factor: Array, right: Array) -> Array:
    """x (n, k) of L·x = right (n, k), L (w, n) of `banded_cholesky`.

    >>> banded_forward(np.array([[2.0, 2.0], [1.0, 0.0]]), np.array([[4.0], [6.0]])).ravel().tolist()
    [2.0, 2.0]
    """
    solved, info = routines.dtbtrs(factor, np.asarray_chkfinite(right, dtype=float), uplo="L")
    if info:
        raise LinAlgError("the factor is singular")
    return np.asarray(solved)


def banded_solved(below: int, above: int, band: Array, right: Array) -> Array:
    """x (n, k) of a matrix with so many diagonals below and above the main one, whose k-th above stands in row
    ``above − k`` of `band`, with its columns.

    Raises:
        LinAlgError: the matrix is singular.

    >>> banded_solved(1, 0, np.array([[2.0, 4.0], [1.0, 0.0]]), np.array([[2.0], [5.0]])).ravel().tolist()
    [1.0, 1.0]
    """
    right = np.asarray_chkfinite(right)
    if (below, above) == (1, 1):
        *_, solved, info = routines.dgtsv(band[2, :-1], band[1], band[0, 1:], right)
    else:
        stored = np.zeros((2 * below + above + 1, band.shape[1]))
        stored[below:] = band
        *_, solved, info = routines.dgbsv(below, above, stored, right)
    if info:
        raise LinAlgError("the matrix is singular")
    return np.asarray(solved)


def pivoted_triangle(matrix: Array) -> tuple[Array, NDArray[np.intp]]:
    """R (min(m, n), n) of a QR of (m, n) with columns in the order (n,) that takes the largest of what is left first.
    """
    factored, order, _, _, info = routines.dgeqp3(np.asarray_chkfinite(matrix))
    assert info == 0
    return np.triu(factored[: min(matrix.shape)]), np.asarray(order, dtype=np.intp) - 1


def triangle_solved(triangle: Array, right: Array) -> Array:
    """x (n, k) of R·x = right (n, k), R (n, n) upper triangular.

    Raises:
        LinAlgError: R is singular.
    """
    solved, info = routines.dtrtrs(triangle, right)
    if info:
        raise LinAlgError("the triangle is singular")
    return np.asarray(solved)


def singular_values(matrix: Array, *, full: bool = True) -> tuple[Array, Array, Array]:
    """U, s and Vᵀ by implicit QR (gesvd), more accurate for small singular values than dividing and conquering, which
    `numpy.linalg.svd` does.

    Raises:
        LinAlgError: the iterations do not converge.
    """
    left, sizes, right, info = routines.dgesvd(np.asarray_chkfinite(matrix), full_matrices=int(full))
    if info:
        raise LinAlgError("the singular values did not converge")
    return np.asarray(left), np.asarray(sizes), np.asarray(right)


def inverse_of_positive(matrix: Array) -> Array:
    """The inverse of a positive definite matrix (n, n), by its Cholesky factor.

    Raises:
        LinAlgError: the matrix is not positive definite.

    >>> inverse_of_positive(np.array([[4.0, 0.0], [0.0, 16.0]])).tolist()
    [[0.25, 0.0], [0.0, 0.0625]]
    """
    factor, info = routines.dpotrf(np.asarray_chkfinite(matrix), lower=0, clean=1)
    if info:
        raise LinAlgError(f"the leading minor of order {info} is not positive definite")
    made = np.asarray(routines.dpotri(factor, lower=0, overwrite_c=1)[0])
    made += made.T  # below the diagonal there was nothing
    made[np.diag_indices(len(made))] /= 2
    return made


def tridiagonal_solved(diagonal: Array, beside: Array, right: Array) -> Array:
    """x (n,) of a positive definite matrix with this diagonal (n,) and the numbers (n − 1,) on either side of it.

    Raises:
        LinAlgError: the matrix is not positive definite.

    >>> tridiagonal_solved(np.array([2.0, 2.0]), np.array([1.0]), np.array([4.0, 5.0])).tolist()
    [1.0, 2.0]
    """
    *_, solved, info = routines.dptsv(diagonal, beside if len(beside) else np.zeros(1), np.asarray_chkfinite(right))
    if info:
        raise LinAlgError(f"the leading minor of order {info} is not positive definite")
    return np.asarray(solved)
