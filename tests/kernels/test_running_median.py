"""The compiled running median against SciPy's."""

import numpy as np
import pytest
from scipy.ndimage import median_filter

from hydroopt.kernels import running_median as own


@pytest.mark.usefixtures("vectors")
@pytest.mark.parametrize("count", [1, 30, own.FEW, own.FEW + 3, own.FEW + 13])
def test_medians_and_what_stands_off_them_are_those_of_scipy(count: int) -> None:
    rng = np.random.default_rng(count)
    spiky = rng.standard_normal(count)
    spiky[count // 2 :: 97] -= 9.0
    for x in (spiky, spiky.cumsum().round(), np.zeros(count), np.arange(2.0 * count)[::-2], rng.integers(0, 2, count)):
        wanted = median_filter(x, own.WIDTH, mode="nearest")
        np.testing.assert_array_equal(own.running_median(x), wanted)
        off, worst, many = own.residuals(x, 0.3)
        np.testing.assert_array_equal(off, x - wanted)
        assert worst == np.abs(x - wanted).max()
        assert many == np.count_nonzero(np.abs(x - wanted) >= 0.3 * worst)
