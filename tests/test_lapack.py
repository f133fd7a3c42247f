"""LAPACK without the rest of SciPy, against `scipy.linalg`; and that identification needs nothing else of it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

from hydroopt import lapack
from hydroopt.lapack import (
    banded_cholesky,
    banded_solved,
    cholesky_solved,
    pivoted_triangle,
    singular_values,
    triangle_solved,
)

RNG = np.random.default_rng(0)
BAND = RNG.standard_normal((5, 40)) + np.array([[20.0], [0], [0], [0], [0]])


@pytest.mark.parametrize("shape", [(40,), (40, 7)])
def test_bands(shape: tuple[int, ...]) -> None:
    right = RNG.standard_normal(shape)
    expected = scipy.linalg.solveh_banded(BAND, right, lower=True)
    np.testing.assert_allclose(cholesky_solved(banded_cholesky(BAND), right), expected, rtol=1e-12)


@pytest.mark.parametrize(("below", "above"), [(1, 1), (1, 0), (2, 1)])
def test_diagonals_below_and_above(below: int, above: int) -> None:
    band, right = RNG.standard_normal((below + above + 1, 40)), RNG.standard_normal((40, 3))
    band[above] += 9.0
    before = band.copy()
    expected = scipy.linalg.solve_banded((below, above), band, right)
    np.testing.assert_allclose(banded_solved(below, above, band, right), expected, rtol=1e-12)
    np.testing.assert_array_equal(band, before)


def test_what_has_no_solution_is_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        banded_cholesky(-BAND)
    with pytest.raises(np.linalg.LinAlgError, match="singular"):
        banded_solved(1, 1, np.zeros((3, 4)), np.ones((4, 1)))
    with pytest.raises(np.linalg.LinAlgError, match="singular"):
        triangle_solved(np.zeros((2, 2)), np.ones((2, 1)))
    with pytest.raises(ValueError, match="infs or NaNs"):
        banded_cholesky(np.full((2, 3), np.nan))


@pytest.mark.parametrize("shape", [(30, 8), (8, 30)])
def test_factors(shape: tuple[int, int]) -> None:
    matrix = RNG.standard_normal(shape)
    matrix[:, 3] = matrix[:, 1]
    R, order = pivoted_triangle(matrix)
    expected, same = scipy.linalg.qr(matrix, mode="r", pivoting=True)
    np.testing.assert_allclose(R, expected[: min(shape)], atol=1e-12)
    np.testing.assert_array_equal(order, same)
    for full in (True, False):
        U, s, Vt = singular_values(matrix, full=full)
        wanted = scipy.linalg.svd(matrix, full_matrices=full, lapack_driver="gesvd")
        assert [each.shape for each in (U, s, Vt)] == [each.shape for each in wanted]
        np.testing.assert_allclose(s, wanted[1], atol=1e-12)
        k = len(s)
        np.testing.assert_allclose((U[:, :k] * s) @ Vt[:k], matrix, atol=1e-12)


def test_the_public_routines_do_where_the_compiled_module_does_not_load_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lapack, "_alone", lambda _: None)
    public = lapack._routines()
    assert public is scipy.linalg.lapack
    factor, info = public.dpbtrf(BAND, lower=1)
    assert info == 0
    np.testing.assert_array_equal(factor, banded_cholesky(BAND))
    with lapack.given_alone():  # scipy.linalg is loaded, and nothing needs to be given
        assert "scipy.linalg" in sys.modules


def test_an_identification_loads_no_package_of_scipy(tmp_path: Path) -> None:
    """In a process of its own, with a log from a file; and `scipy.linalg` is whole when it is loaded afterwards."""
    code = """if True:
        import sys
        import hydroopt as ho
        log = ho.read_log(sys.argv[1])
        estimate = ho.solve(ho.identification_problem(ho.load_machine("patu655_lift"), [log]), seed=1)
        estimate.diagnostics
        loaded = {name.partition(".")[2].partition(".")[0] for name in sys.modules if name.startswith("scipy.")}
        print(sorted(loaded & {"fft", "integrate", "interpolate", "linalg", "ndimage", "optimize", "sparse", "special",
                               "stats"}))
        import scipy.linalg
        from scipy.linalg import cython_blas
        print(scipy.linalg.cython_blas is cython_blas, scipy.linalg.solve([[2.0]], [1.0]))
        """
    subprocess.run([sys.executable, "-m", "hydroopt", "simulate", "patu655_lift", "-o", str(tmp_path),
                    "--duration", "20", "--quiet"], check=True)
    ran = subprocess.run([sys.executable, "-c", code, str(tmp_path / "log.csv")], capture_output=True, text=True,
                         check=True)
    assert ran.stdout.split("\n")[:2] == ["[]", "True [0.5]"]
