"""From sampled joint positions to smooth positions, velocities and accelerations, each stretch by itself."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hydroopt.errors import LogError, ProblemError
from hydroopt.logs import spline
from hydroopt.logs.lag import stretches
from hydroopt.logs.spline import Basis, Filter, Grid
from hydroopt.logs.two_weights import bandwidth, two_weights

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SmoothingSpline:
    """Quintic smoothing spline; its weight follows from the stated noise, or from cross-validation.

    `cross_validate` asks for generalised cross-validation even where the noise is stated. Both suppose white noise;
    where it is not white they pass too much, and the motion's `bandwidth` [Hz] bounds that: half of it passes then, and
    all that is slower (see `spline`).

    >>> t = np.arange(200) / 50
    >>> motion = condition(t, np.sin(t), smoothing=SmoothingSpline(bandwidth=5.0), noise=1e-6)
    >>> bool(np.max(np.abs(motion.qd[:, 0] - np.cos(t))) < 0.01)
    True
    """

    cross_validate: bool = False
    bandwidth: float | None = None


@dataclass(frozen=True)
class Fourier:
    """Constant plus `harmonics` sines and cosines of a periodic motion of the given `period` [s].

    >>> t = np.arange(200) / 50
    >>> motion = condition(t, np.sin(np.pi * t / 2), smoothing=Fourier(period=4.0, harmonics=3))
    >>> bool(np.max(np.abs(motion.qdd[:, 0] + (np.pi / 2) ** 2 * motion.q[:, 0])) < 1e-9)
    True
    """

    period: float
    harmonics: int


@dataclass(frozen=True)
class Butterworth:
    """Zero-phase (forward and backward) low-pass of the given `cutoff` [Hz]; needs regular sampling.

    >>> t = np.arange(200) / 50
    >>> motion = condition(t, np.sin(t), smoothing=Butterworth(cutoff=5.0))
    >>> motion.bandwidth.tolist()
    [5.0]
    """

    cutoff: float
    order: int = 4


@dataclass(frozen=True)
class TwoWeights:
    """The thesis's filter (section 4.5): weights on squared speed [s²] and squared acceleration [s⁴], both stated.

    The motion is drawn towards standstill by `speed`, and towards uniform motion by `acceleration`: the part ``1 / (1 +
    speed·ω² + acceleration·ω⁴)`` of an amplitude passes, half of it at the bandwidth. Above it, what passes of noise
    falls with ω⁴ for positions and with ω² for accelerations. The spline passes ``1 / (1 + (ω/ω₀)⁶)``: it distorts
    motion less below its bandwidth, passes less noise above, and chooses its weight by the noise. ``acceleration =
    (2πf)⁻⁴`` alone has the bandwidth f.

    >>> t = np.arange(200) / 50
    >>> motion = condition(t, np.sin(t), smoothing=TwoWeights(speed=0.0, acceleration=(2 * np.pi * 5.0) ** -4))
    >>> motion.bandwidth.round(6).tolist()
    [5.0]
    """

    speed: float
    acceleration: float


Smoothing = SmoothingSpline | Fourier | Butterworth | TwoWeights


STANDSTILL = 1e-6
"""Speed of a joint [rad/s or m/s] below which it stands still: smoothing leaves rounding."""


@dataclass(frozen=True)
class Motion:
    """Conditioned motion of n joints.

    Attributes:
        t: (N,) times [s].
        q: (N, n) positions [rad or m]; qd: velocities [rad/s]; qdd: accelerations [rad/s²].
        segment: (N,) index of the uninterrupted stretch.
        interior: (N,) False near the ends of a stretch, where derivatives lean on one side only.
        bandwidth: (n,) frequency passed by half (-6 dB), lowest of the stretches [Hz].
        passes: (n,) how many times what smoothing left was smoothed.
        notes: what was done, in plain words.
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array
    segment: NDArray[np.int64]
    interior: NDArray[np.bool_]
    bandwidth: Array
    passes: NDArray[np.int64]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Smoother:
    """Knots, filter and bandwidth [Hz] of every joint's spline, the same for all pieces of a log, and how they were
    chosen in words.
    """

    grids: tuple[Grid, ...]
    filters: tuple[Filter, ...]
    bandwidth: Array
    notes: tuple[str, ...]

    @classmethod
    def chosen(cls, t: Array, q: Array, segment: NDArray[np.int64], smoothing: SmoothingSpline, noise: Array | None,
               names: Sequence[str], where: str) -> "Smoother":
        """The one that suits positions (N, n) at times (N,) best; other arguments as of `condition`.

        Raises:
            LogError: a stretch is too short, or times do not increase.
            ProblemError: the bandwidth leaves nothing of the motion.
        """
        spans = [slice(*each) for each in stretches(segment)]
        for span in spans:
            here = f"{where}, samples {span.start + 1} to {span.stop}"
            _refuse_too_short(span.stop - span.start, here)
            _refuse_disorder(t[span], here)
        duration = float(t[-1] - t[0])
        if smoothing.bandwidth is not None and not smoothing.bandwidth * duration >= 1:
            raise ProblemError(
                f"a bandwidth of {smoothing.bandwidth:g} Hz leaves nothing of a motion of {duration:.4g} s",
                where=where, remedy=f"state one above {1 / duration:.2g} Hz or record a longer log")
        moved = sum(float(t[span.stop - 1] - t[span.start]) for span in spans)
        shared = spline.Pieces([t[span] for span in spans], Grid(float(t[0]), moved, t.size - len(spans)))
        grids, filters, corners, notes = [], [], [], []
        for j, name in enumerate(names):
            stated = None if smoothing.cross_validate or noise is None or np.isnan(noise[j]) else float(noise[j])
            bases, chosen = shared.choose([q[span, j] for span in spans], stated, smoothing.bandwidth)
            squares = sum(np.sum((q[span, j] - basis.smoothed(q[span, j], chosen)[0]) ** 2)
                          for basis, span in zip(bases, spans, strict=True))
            grids.append(bases[0].grid)
            filters.append(chosen)
            corners.append(min(basis.bandwidth(chosen) for basis in bases))
            notes.append(_note(name, where, corners[-1], float(np.sqrt(squares / t.size)), stated, smoothing))
        return cls(tuple(grids), tuple(filters), np.array(corners), tuple(notes))

    @property
    def margin(self) -> float:
        """How far [s] beyond a piece its smoothing has to reach, for what lies beyond to be felt no more.

        A sample's influence falls by e within 1/(π·bandwidth) of one smoothing: the slowest of the six roots of
        1 + (ω/ω₀)⁶. Each further smoothing of what is left multiplies it by the time, three e-foldings at that length.
        """
        most = max(one.passes for one in self.filters)
        once = float(np.min(self.bandwidth)) / spline.wider(most)
        return (spline.DECAY + 3 * (most - 1)) / (np.pi * once)

    def motion(self, t: Array, q: Array, segment: NDArray[np.int64], where: str) -> Motion:
        """Smooth positions (N, n) at times t (N,), those of a log or of a piece of it.

        Raises:
            LogError: a stretch is too short.
        """
        out, interior = np.empty((3, *q.shape)), np.zeros(t.size, bool)
        for start, stop in stretches(segment):
            span = slice(start, stop)
            _refuse_too_short(stop - start, where)
            for grid in dict.fromkeys(self.grids):
                basis = Basis(t[span], grid)
                some = [j for j, own in enumerate(self.grids) if own == grid]
                right = basis.design.T @ q[span, some]
                out[:, span, some] = basis.courses(np.column_stack([
                    basis.solve(self.filters[j], column) for j, column in zip(some, right.T, strict=True)]))
            interior[span] = inside(t[span], self.bandwidth)
        return Motion(t, out[0], out[1], out[2], segment, interior, self.bandwidth,
                      np.array([one.passes for one in self.filters]), self.notes)


def condition(
    t: ArrayLike,
    q: ArrayLike,
    segment: ArrayLike | None = None,
    smoothing: Smoothing = SmoothingSpline(),
    noise: ArrayLike | None = None,
    *,
    names: Sequence[str] = (),
    where: str = "log",
) -> Motion:
    """Smooth positions and their first and second derivatives.

    Args:
        t: (N,) increasing times [s].
        q: (N, n) or (N,) measured positions [rad or m].
        segment: (N,) index of the stretch each sample belongs to; None for one stretch.
        smoothing: how.
        noise: (n,) or scalar standard deviation of each joint's sensor, unit of q; None or NaN where unknown, which
            asks for cross-validation.
        names: of the joints, for the notes.
        where: name of the log, for error messages.

    Raises:
        LogError: a stretch is too short, sampling is irregular for Butterworth, or the log is shorter than
            the Fourier period.
        ProblemError: an option is impossible (cutoff or harmonics beyond the Nyquist frequency, a bandwidth
            below one period in the whole log, negative noise).
    """
    times = np.asarray(t, dtype=float)
    positions = np.asarray(q, dtype=float)
    positions = positions.reshape(times.size, -1)
    parts = np.zeros(times.size, int) if segment is None else np.asarray(segment, dtype=int)
    lost = np.flatnonzero(~np.isfinite(times + positions.sum(axis=1)))
    if lost.size:
        raise LogError(f"the position or time at sample {lost[0] + 1} is not finite ({lost.size} in all; a "
                       "cylinder's length gives no angle where its triangle is open)", where=where,
                       remedy="correct it or read the log with --treat nan=drop")
    stds = None if noise is None else np.broadcast_to(np.asarray(noise, dtype=float), positions.shape[1:])
    if stds is not None and np.any(np.isinf(stds) | (stds < 0)):
        raise ProblemError("the stated noise is negative or infinite", where=where,
                           remedy="give each joint's standard deviation in SI units")
    if isinstance(smoothing, TwoWeights):
        _refuse_weights(smoothing, where)
    if isinstance(smoothing, Fourier):
        return _fourier(times, positions, parts, smoothing, where)
    if isinstance(smoothing, SmoothingSpline):
        names = names or [f"joint {j + 1}" for j in range(positions.shape[1])]
        return Smoother.chosen(times, positions, parts, smoothing, stds, names, where).motion(
            times, positions, parts, where)

    out, interior = np.empty((3, *positions.shape)), np.zeros(times.size, bool)
    if isinstance(smoothing, TwoWeights):
        corner = bandwidth(smoothing.speed, smoothing.acceleration)
        note = (f"the filter with two weights, {smoothing.speed:g} s² on squared speed and {smoothing.acceleration:g} "
                f"s⁴ on squared acceleration: {corner:.3g} Hz bandwidth")
    else:
        corner = smoothing.cutoff
        note = f"zero-phase Butterworth filter of order {smoothing.order}, {smoothing.cutoff:g} Hz"
    corners = np.full(positions.shape[1], corner)
    for start, stop in stretches(parts):
        span, here = slice(start, stop), f"{where}, samples {start + 1} to {stop}"
        _refuse_disorder(times[span], here)
        if isinstance(smoothing, TwoWeights):
            _refuse_too_short(stop - start, here)
            out[:, span] = two_weights(times[span], positions[span], smoothing.speed, smoothing.acceleration)
        else:
            out[:, span] = _butterworth(times[span], positions[span], smoothing, here)
        interior[span] = inside(times[span], corners)
    return Motion(times, out[0], out[1], out[2], parts, interior, corners, np.ones(len(corners), int), (note,))


def _refuse_disorder(t: Array, where: str) -> None:
    if np.any(np.diff(t) <= 0):
        raise LogError("times do not increase", where=where, remedy="correct the time stamps")


def inside(t: Array, corners: Array) -> NDArray[np.bool_]:
    """Which samples (N,) of a stretch do not lie near its ends, by the bandwidths [Hz] of its smoothing."""
    reach = min(0.5 / float(np.min(corners)), 0.1 * float(t[-1] - t[0]))
    return np.asarray((t >= t[0] + reach) & (t <= t[-1] - reach))


def _refuse_weights(smoothing: TwoWeights, where: str) -> None:
    weights = (smoothing.speed, smoothing.acceleration)
    if not all(0 <= weight < np.inf for weight in weights) or not any(weights):
        raise ProblemError(f"{smoothing.speed:g} s² and {smoothing.acceleration:g} s⁴ are no weights of a filter",
                           where=where, remedy="give two that are not negative, one of them positive; "
                                               "(2πf)⁻⁴ s⁴ on squared acceleration alone has the bandwidth f")


def _refuse_too_short(samples: int, where: str) -> None:
    """Raise a LogError where a stretch has too few samples for a spline."""
    if samples < spline.MIN_SAMPLES:
        raise LogError(f"a stretch of {samples} samples is too short to differentiate", where=where,
                       remedy="smooth across short gaps (--treat gap=keep), leave it out, or record at least "
                              f"{spline.MIN_SAMPLES} samples without a gap")


def _note(name: str, where: str, corner: float, residual: float, stated: float | None,
          smoothing: SmoothingSpline) -> str:
    """How a joint was smoothed: the bandwidth [Hz], what chose it, and what it took out beside the noise stated."""
    chosen = "cross-validation" if stated is None else f"the stated noise of {stated:.3g}"
    if smoothing.bandwidth and corner > 0.99 * smoothing.bandwidth:
        chosen = "the stated bandwidth of the motion"
    warning = " (which does not agree: check the stated noise)" if stated and not 0.5 < residual / stated < 1.5 else ""
    return (f"{name}, {where}: smoothing spline with {corner:.3g} Hz bandwidth from {chosen}, residual std "
            f"{residual:.3g}{warning}")


def _butterworth(t: Array, q: Array, smoothing: Butterworth, where: str) -> Array:
    steps = np.diff(t)
    shortest = 6 * (smoothing.order + 1)
    if t.size <= shortest:
        raise LogError(f"a stretch of {t.size} samples is too short to filter", where=where,
                       remedy=f"leave it out or record more than {shortest} samples without a gap")
    if np.any(np.abs(steps - np.median(steps)) > 0.1 * np.median(steps)):
        raise LogError("sampling is irregular, which a Butterworth filter cannot take", where=where,
                       remedy="choose the smoothing spline, which uses the time stamps as they are")
    rate = (t.size - 1) / float(t[-1] - t[0])
    if not 0 < smoothing.cutoff < rate / 2 or smoothing.order < 1:
        raise ProblemError(f"a cutoff of {smoothing.cutoff:g} Hz and order {smoothing.order} do not suit "
                           f"sampling at {rate:g} Hz", where=where,
                           remedy=f"choose a cutoff between 0 and {rate / 2:g} Hz and an order of 1 or more")
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415 (as below)
    from scipy.signal import butter, sosfiltfilt  # noqa: PLC0415 (its import takes longer than most identifications)

    sections = butter(smoothing.order, smoothing.cutoff, fs=rate, output="sos")
    smooth = make_interp_spline(t, sosfiltfilt(sections, q, axis=0), k=5)
    return np.stack([smooth(t, order) for order in range(3)])


def _fourier(t: Array, q: Array, segment: NDArray[np.int64], smoothing: Fourier, where: str) -> Motion:
    """One least-squares fit over all stretches: the phase of a periodic motion survives a gap."""
    period, harmonics = smoothing.period, smoothing.harmonics
    if not period > 0 or harmonics < 1:
        raise ProblemError(f"period {period:g} s with {harmonics} harmonics does not define a Fourier series",
                           where=where, remedy="give a positive period and at least one harmonic")
    step = float(np.median(np.diff(t))) if t.size > 1 else np.inf
    if t.size < 2 or t[-1] - t[0] + step < period * (1 - 1e-9):
        raise LogError(f"{t.size} samples over {np.ptp(t):.4g} s do not hold a period of {period:g} s",
                       where=where, remedy="record at least one full period or choose the smoothing spline")
    if harmonics / period >= (1 - 1e-9) * 0.5 / step:
        raise ProblemError(f"harmonic {harmonics} at {harmonics / period:g} Hz exceeds half the sampling "
                           "rate", where=where,
                           remedy=f"choose fewer than {period / (2 * step):.0f} harmonics")
    if t.size <= 2 * harmonics + 1:
        raise LogError(f"{t.size} samples do not determine {harmonics} harmonics", where=where,
                       remedy="choose fewer harmonics or record a longer log")
    omega = 2 * np.pi / period * np.arange(1, harmonics + 1)
    sine, cosine = np.sin(np.outer(t, omega)), np.cos(np.outer(t, omega))
    basis = np.column_stack([np.ones(t.size), sine, cosine])
    coefficients, _, rank, _ = np.linalg.lstsq(basis, q, rcond=None)
    if rank < basis.shape[1]:
        raise LogError(f"the samples do not determine {harmonics} harmonics", where=where,
                       remedy="choose fewer harmonics or a log without long gaps")
    a, b = coefficients[1:harmonics + 1], coefficients[harmonics + 1:]
    w = omega[:, None]
    residual = np.sqrt(np.mean((q - basis @ coefficients) ** 2, axis=0))
    notes = tuple(f"joint {j + 1}, {where}: Fourier series of {harmonics} harmonics of {period:g} s, "
                  f"residual std {r:.3g}" for j, r in enumerate(residual))
    return Motion(t, basis @ coefficients, cosine @ (w * a) - sine @ (w * b),
                  -(sine @ (w**2 * a) + cosine @ (w**2 * b)), segment, np.ones(t.size, bool),
                  np.full(q.shape[1], harmonics / period), np.ones(q.shape[1], dtype=int), notes)
