"""The smoothing spline's parts against SciPy's splines, and pieces of a motion against the whole."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from hydroopt.logs import spline
from hydroopt.logs.smoothing import Smoother, SmoothingSpline, condition
from hydroopt.logs.spline import Basis, Grid

T = 3.0 + np.arange(901) / 50
NOISE = 2e-3


def uneven(t: np.ndarray) -> np.ndarray:
    return t + np.random.default_rng(1).uniform(-4e-3, 4e-3, t.size)


@pytest.mark.parametrize("order", range(4))
def test_splines_are_those_of_scipy(order: int) -> None:
    basis = Basis(uneven(T), Grid.of(uneven(T)))
    knots = np.arange(-5.0, basis.intervals + 6.0)
    coefficients = np.random.default_rng(2).standard_normal(basis.intervals + 5)
    expected = BSpline(knots, coefficients, 5).derivative(order)(basis.x) if order else BSpline(knots, coefficients, 5)(
        basis.x)
    np.testing.assert_allclose(basis.derivative(order) @ coefficients, expected, rtol=0, atol=1e-10)


def test_gram_holds_the_sums_of_products_over_the_samples() -> None:
    basis = Basis(uneven(T), Grid.of(uneven(T)))
    product = (basis.design.T @ basis.design).toarray()
    for below, band in enumerate(basis.gram):
        np.testing.assert_allclose(band[: len(product) - below], np.diagonal(product, -below), rtol=0, atol=1e-13)


def test_penalty_is_the_integral_of_the_third_derivative_squared() -> None:
    basis = Basis(T[:41], Grid.of(T[:41]))
    c = np.random.default_rng(3).standard_normal(basis.intervals + 5)
    third = BSpline(np.arange(-5.0, basis.intervals + 6.0), c, 5).derivative(3)
    x = np.linspace(0, basis.intervals, 200 * basis.intervals + 1)
    said = sum((1 + (k > 0)) * np.sum(basis.penalty[k, : len(c) - k] * c[: len(c) - k] * c[k:]) for k in range(6))
    assert said == pytest.approx(np.trapezoid(third(x) ** 2, x), rel=1e-4)


@pytest.mark.parametrize("even", [True, False])
def test_pieces_are_smoothed_as_the_whole(even: bool) -> None:
    t = T if even else uneven(T)
    rng = np.random.default_rng(4)
    q = np.column_stack([np.sin(2 * t), 0.3 * np.cos(3 * t)]) + NOISE * rng.standard_normal((t.size, 2))
    whole = condition(t, q, noise=NOISE)
    chosen = Smoother.chosen(t, q, np.zeros(t.size, int), SmoothingSpline(), np.full(2, NOISE), ["a", "b"], "log")
    np.testing.assert_allclose(chosen.bandwidth, whole.bandwidth, rtol=1e-9)
    margin = int(np.ceil(50 * chosen.margin)) + 1
    assert margin < 400
    for first, last in ((0, 100), (400, 500), (500, 800), (800, 901)):
        window = slice(max(0, first - margin), min(last + margin, t.size))
        core = (np.arange(t.size)[window] >= first) & (np.arange(t.size)[window] < last)
        part = chosen.motion(t[window], q[window], np.zeros(core.size, int), "log")
        for one, other in ((part.q, whole.q), (part.qd, whole.qd), (part.qdd, whole.qdd)):
            np.testing.assert_allclose(one[core], other[first:last], rtol=0, atol=1e-9 * np.max(np.abs(other)))
        np.testing.assert_array_equal(part.interior[core], whole.interior[first:last])


def test_one_weight_for_several_pieces_lies_among_their_own() -> None:
    rng = np.random.default_rng(5)
    pieces = [(t, np.sin(w * t) + NOISE * rng.standard_normal(t.size)) for t, w in ((T[:400], 1.0), (T[450:], 4.0))]
    own = [spline.fit(t, y, NOISE) for t, y in pieces]
    bases, chosen = spline.Pieces([t for t, _ in pieces], Grid.of(T)).choose([y for _, y in pieces], NOISE)

    def weight(basis: spline.Basis, log_weight: float) -> float:
        return 10.0**log_weight * basis.spacing**5

    low, high = (weight(basis, one.log_weight) for basis, one in reversed(own))
    assert low < weight(bases[0], chosen.log_weight) < high


def test_a_stated_bandwidth_passes_by_half_and_what_is_slower_whole() -> None:
    """Sines go through; one smoothing of the same bandwidth would take 4.5 % at 0.6 of it, and 0.4 % at 0.4."""
    t = np.arange(6000) / 100
    middle = slice(1500, 4500)
    for part, passed in ((0.3, 1.0), (0.6, 0.9985), (1.0, 0.5), (2.0, 0.012)):
        y = np.sin(2 * np.pi * part * t)
        basis, chosen = spline.fit(t, y, 1e-9, 1.0)
        assert chosen.passes == spline.SHARP
        assert basis.bandwidth(chosen) == pytest.approx(1.0, rel=1e-9)
        gain = basis.smoothed(y, chosen)[0, middle] @ y[middle] / (y[middle] @ y[middle])
        assert gain == pytest.approx(passed, abs=5e-4)


@pytest.mark.parametrize("sharp", [False, True])
def test_pieces_of_a_motion_of_stated_bandwidth_are_smoothed_like_the_whole(sharp: bool) -> None:
    rng = np.random.default_rng(6)
    q = (np.sin(2 * T) + NOISE * rng.standard_normal(T.size))[:, None]
    smoothing = SmoothingSpline(bandwidth=1.5 if sharp else 20.0)
    whole = condition(T, q, smoothing=smoothing, noise=NOISE)
    chosen = Smoother.chosen(T, q, np.zeros(T.size, int), smoothing, np.full(1, NOISE), ["a"], "log")
    assert whole.passes.tolist() == [spline.SHARP if sharp else 1]
    margin = int(np.ceil(50 * chosen.margin)) + 1
    window = slice(0, 400 + margin)
    core = np.arange(T.size)[window] < 400
    part = chosen.motion(T[window], q[window], np.zeros(core.size, int), "log")
    np.testing.assert_allclose(part.qdd[core], whole.qdd[:400], rtol=0, atol=1e-9 * np.max(np.abs(whole.qdd)))


@pytest.mark.parametrize("shape", [(), (3,)])
def test_courses_are_those_of_each_derivative(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(6)
    t = 7.0 + np.sort(rng.uniform(0.0, 100.0, 5000))
    basis = Basis(t, Grid.of(t))
    coefficients = rng.standard_normal((basis.intervals + 5, *shape))
    found = basis.courses(coefficients)
    for order in range(3):
        reference = basis.derivative(order) @ coefficients / basis.spacing**order
        np.testing.assert_allclose(found[order], reference, rtol=0, atol=1e-12 * np.abs(reference).max())
