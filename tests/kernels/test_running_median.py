"""The network of comparisons against sorting, and the compiled running median against SciPy's."""

import numpy as np
import pytest
from scipy.ndimage import median_filter

from hydroopt.kernels import running_median as own
from hydroopt.kernels import shared_library


@pytest.mark.parametrize("size", [1, 2, 3, 5, 7, 8, 12])
def test_the_network_sorts_all_zeros_and_ones(size: int) -> None:
    for number in range(2**size):
        values = [number >> k & 1 for k in range(size)]
        for low, high in own._network(size):
            values[low], values[high] = sorted((values[low], values[high]))
        assert values == sorted(values)


@pytest.mark.parametrize("width", [1, 3, 25])
@pytest.mark.parametrize("count", [own.FEW, own.FEW + 3])
def test_medians_are_those_of_scipy(width: int, count: int) -> None:
    rng = np.random.default_rng(count + width)
    for x in (rng.standard_normal(count), rng.standard_normal(count).cumsum().round(), np.zeros(count)):
        np.testing.assert_array_equal(own.running_median(x, width), median_filter(x, width, mode="nearest"))


def test_without_a_compiler_scipy_computes_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared_library, "compiler", lambda: None)
    own._library.cache_clear()
    x = np.random.default_rng(0).standard_normal(own.FEW)
    np.testing.assert_array_equal(own.running_median(x, 5), median_filter(x, 5, mode="nearest"))
    own._library.cache_clear()


@pytest.mark.parametrize("count", [1, 30, own.FEW, own.FEW + 5])
def test_residuals_are_those_of_the_median(count: int) -> None:
    rng = np.random.default_rng(count)
    spiky = rng.standard_normal(count)
    spiky[count // 2 :: 97] -= 9.0
    for x in (spiky, np.zeros(count), np.arange(2.0 * count)[::2]):
        off, worst, many = own.residuals(x, 25, 0.3)
        wanted = x - median_filter(x, 25, mode="nearest")
        np.testing.assert_array_equal(off, wanted)
        assert worst == np.abs(wanted).max()
        assert many == np.count_nonzero(np.abs(wanted) >= 0.3 * worst)
