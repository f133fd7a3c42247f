"""The functions of a motion against the same motions built of other parts.

Those of the series are sines by numpy with an entry and an exit that SciPy's Hermite interpolation makes of the states
at their ends; those of the spline are evaluated by FITPACK on knots and points written out here.
"""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest
from scipy.interpolate import BPoly, splev

from hydroopt.errors import ProblemError
from hydroopt.excitation.motion.basis import Basis, Fourier, Spline, check

SERIES = (Fourier(6.0, 3, repeats=2, blend=1.5), Fourier(0.7, 1, blend=0.3), Fourier(10.0, 8, repeats=3, blend=0.0))
SPLINES = (Spline(8.0, 6), Spline(0.9, 1), Spline(33.0, 40))
ALL = (*SERIES, *SPLINES)
Array = np.ndarray


def named(basis: Basis) -> str:
    return "-".join(map(str, (type(basis).__name__, *asdict(basis).values())))


def waves(basis: Fourier, t: Array, order: int) -> Array:
    """A constant, sines and cosines of the time since the series began: derivatives (N, m) of some order."""
    omega = 2 * np.pi * np.arange(1, basis.harmonics + 1) / basis.period
    angle = np.multiply.outer(t, omega) + order * np.pi / 2  # every derivative is a quarter of a turn ahead
    constant = np.full((len(t), 1), float(order == 0))
    return np.hstack([constant, omega**order * np.sin(angle), omega**order * np.cos(angle)])


def series(basis: Fourier, t: Array, order: int) -> Array:
    """The series between two polynomials of the seventh degree from and to rest at the mean."""
    first, last = basis.blend, basis.blend + basis.repeats * basis.period
    made = waves(basis, t - first, order)
    if basis.blend:
        edge = [waves(basis, np.zeros(1), k)[0] for k in range(4)]
        mean = np.eye(len(basis.names))[0]
        still = [mean, 0 * mean, 0 * mean, 0 * mean]
        entry = BPoly.from_derivatives([0, first], [still, edge])
        leave = BPoly.from_derivatives([last, last + basis.blend], [edge, still])
        made[t < first] = entry(t[t < first], order)
        made[t > last] = leave(t[t > last], order)
    return made


def spline(basis: Spline, t: Array, order: int) -> Array:
    """B-splines of the fifth degree; the outermost three at each end belong to one coefficient."""
    inner = basis.time / basis.pieces * np.arange(1, basis.pieces)
    knots = np.concatenate([np.zeros(6), inner, np.full(6, basis.time)])
    made = []
    for k in range(len(basis.names)):
        own = np.eye(len(basis.names))[k]
        points = np.concatenate([np.repeat(own[0], 3), own[1:-1], np.repeat(own[-1], 3)])
        made.append(splev(t, (knots, np.append(points, np.zeros(6)), 5), der=order))
    return np.column_stack(made)


def between(basis: Basis) -> Array:
    """Times within a motion, none of them where pieces meet."""
    return np.sort(np.random.default_rng(0).uniform(0, basis.duration, 400))


@pytest.mark.parametrize("basis", ALL, ids=named)
def test_functions_are_those_built_of_other_parts(basis: Basis) -> None:
    t = between(basis)
    for order, found in enumerate(basis.rows(t)):
        expected = (series if isinstance(basis, Fourier) else spline)(basis, t, order)  # type: ignore[arg-type]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * np.max(np.abs(expected)))


@pytest.mark.parametrize("basis", ALL, ids=named)
def test_derivatives_are_those_of_finite_differences(basis: Basis) -> None:
    h, t = 1e-4 / basis.fastest, between(basis)
    t = t[(t > 2 * h) & (t < basis.duration - 2 * h)]
    at = {k: basis.rows(t + k * h) for k in (-2, -1, 1, 2)}
    true = basis.rows(t)
    for lower, upper in ((0, 1), (1, 2)):
        slope = (at[-2][lower] - 8 * at[-1][lower] + 8 * at[1][lower] - at[2][lower]) / (12 * h)
        np.testing.assert_allclose(slope, true[upper], rtol=0, atol=1e-6 * np.max(np.abs(true[upper])))


@pytest.mark.parametrize("basis", ALL, ids=named)
def test_motion_stays_where_it_is_before_its_beginning_and_after_its_end(basis: Basis) -> None:
    ends = basis.rows(np.array([0.0, basis.duration]))
    before, after = basis.rows(np.array([-1e-9, -0.5, -1e6])), basis.rows(basis.duration + np.array([1e-9, 0.5, 1e6]))
    for order, (left, right) in enumerate(zip(before, after, strict=True)):
        size = np.max(np.abs(basis.rows(between(basis))[order]))
        for found, end in ((left, ends[order][0]), (right, ends[order][1])):
            np.testing.assert_allclose(found, np.tile(end, (3, 1)), rtol=0, atol=1e-12 * size)
        if order and not (isinstance(basis, Fourier) and basis.blend == 0):
            assert np.max(np.abs([left, right])) < 1e-12 * size, "it rests"


@pytest.mark.parametrize("basis", SERIES[:2], ids=named)
def test_series_rests_at_its_mean(basis: Fourier) -> None:
    mean = np.eye(len(basis.names))[:1]
    np.testing.assert_allclose(basis.rows(np.array([0.0, basis.duration])).position, np.tile(mean, (2, 1)), atol=1e-12)


@pytest.mark.parametrize("basis", SPLINES, ids=named)
def test_points_of_a_spline_add_up_to_one_and_are_where_it_rests(basis: Spline) -> None:
    np.testing.assert_allclose(basis.rows(between(basis)).position.sum(axis=1), 1, rtol=1e-12)
    ends = basis.rows(np.array([0.0, basis.duration])).position
    np.testing.assert_allclose(ends, np.eye(len(basis.names))[[0, -1]], atol=1e-12)


@pytest.mark.parametrize("basis", ALL, ids=named)
def test_speed_is_continuous_where_pieces_meet(basis: Basis) -> None:
    """So is the acceleration: what two sides of a joint say differs by no more than what happens in between."""
    if isinstance(basis, Spline):
        joints = np.linspace(0, basis.time, basis.pieces + 1)
    else:
        assert isinstance(basis, Fourier)
        joints = basis.blend + basis.period * np.arange(basis.repeats + 1)
    joints, step = joints[(joints > 0) & (joints < basis.duration)], 1e-7 / basis.fastest
    for before, after in zip(basis.rows(joints - step), basis.rows(joints + step), strict=True):
        assert np.max(np.abs(after - before), initial=0) < 1e-4 * max(1, np.max(np.abs(before), initial=0))


@pytest.mark.parametrize("basis", ALL, ids=named)
def test_a_slower_basis_leads_along_the_same_path(basis: Basis) -> None:
    slow, t = basis.at_pace(0.4), between(basis)
    assert slow.duration == pytest.approx(basis.duration / 0.4)
    assert slow.fastest == pytest.approx(0.4 * basis.fastest)
    for order, (own, late) in enumerate(zip(basis.rows(t), slow.rows(t / 0.4), strict=True)):
        np.testing.assert_allclose(late, 0.4**order * own, rtol=0, atol=1e-9 * np.max(np.abs(own)))
    assert basis.rows(t).position.shape[1] == len(basis.names) == len(set(basis.names))


@pytest.mark.parametrize("basis", [
    Fourier(0.0, 3), Fourier(-5.0, 3), Fourier(float("nan"), 3), Fourier(float("inf"), 3), Fourier(5.0, 0),
    Fourier(5.0, 3, repeats=0), Fourier(5.0, 3, blend=-1.0), Fourier(5.0, 3, blend=float("nan")), Fourier(5.0, 500),
    Spline(0.0, 3), Spline(-1.0, 3), Spline(float("nan"), 3), Spline(float("inf"), 3), Spline(5.0, 0), Spline(1e6, 3),
    Spline(1e5, 1000)], ids=named)
def test_what_has_no_duration_or_too_many_functions_is_refused(basis: Basis) -> None:
    with pytest.raises(ProblemError, match="no duration, or no functions"):
        check(basis, None)


@pytest.mark.parametrize(("basis", "fastest"), [(Fourier(5.0, 10), 2.0), (Spline(5.0, 20), 2.0)], ids=["fourier",
                                                                                                       "spline"])
def test_what_is_faster_than_the_machine_follows_is_refused(basis: Basis, fastest: float) -> None:
    assert basis.fastest == pytest.approx(fastest)
    check(basis, None)
    check(basis, fastest)
    with pytest.raises(ProblemError, match=r"reaches 2 Hz.*bandwidth of 1\.99 Hz"):
        check(basis, 1.99)


def test_fastest_wave_of_a_series_is_its_last_harmonic() -> None:
    """By the peak of its spectrum."""
    basis, rate = Fourier(4.0, 6, blend=0.0), 64
    rows = basis.rows(np.arange(rate * 4) / rate).position
    spectrum = np.abs(np.fft.rfft(rows, axis=0))
    assert np.fft.rfftfreq(rate * 4, 1 / rate)[np.argmax(spectrum[:, basis.names.index("sin6")])] == basis.fastest
