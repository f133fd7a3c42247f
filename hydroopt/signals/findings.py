"""What looks wrong in a log. Each check gives a mask over samples; nothing is changed here."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from hydroopt.signals.table import runs

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_WINDOW = 25  # samples of the running median: spikes up to 12 samples wide stand out


@dataclass(frozen=True)
class Finding:
    """Something a user should know about a log.

    Attributes:
        kind: "nan", "duplicate", "non-monotonic", "irregular", "gap", "stuck", "spike", "saturated", or for
            information "rows" (a map selected them) and "ignored" (foreign columns).
        channel: the channel, "t" for the time; empty for "ignored".
        first: first and `last`: last 1-based data row concerned; count: number of samples concerned.
        text: one sentence.
    """

    kind: str
    channel: str
    first: int
    last: int
    count: int
    text: str


def finding(kind: str, channel: str, mask: Mask, sample: NDArray[np.int64], text: str) -> Finding:
    """The samples in `mask` (N,) as one finding; `text` follows "<channel>: samples ..."."""
    rows = sample[mask]
    noun = "sample" if rows.size == 1 else "samples"
    return Finding(kind, channel, int(rows[0]), int(rows[-1]), int(rows.size),
                   f"{channel}: {noun} {runs(rows)} {text}")


def out_of_order(t: Array) -> Mask:
    """Samples whose time stands off their neighbours' order, repeated stamps not counted.

    Stray stamps are found against a running median. Where the clock itself restarts, all samples that are not
    later than an earlier one are marked.
    """
    if np.all(np.diff(t) >= 0):
        return np.zeros(t.size, bool)
    stray = median_filter(t, _WINDOW, mode="nearest") != t
    if 2 * np.count_nonzero(stray) < t.size and np.all(np.diff(t[~stray]) >= 0):
        return np.asarray(stray)
    return np.asarray(t < np.maximum.accumulate(t))


def repeated(t: Array) -> Mask:
    """Samples that carry the same time stamp as the one before, t (N,) not decreasing."""
    return np.diff(t, prepend=-np.inf) == 0


def gaps(t: Array, times_median: float = 3.0) -> Mask:
    """Samples that follow a step of more than `times_median` median steps."""
    if t.size < 2:
        return np.zeros(t.size, bool)
    step = np.diff(t)
    return np.concatenate([[False], step > times_median * np.median(step)])


def jitter(t: Array) -> Mask:
    """Samples after a step off the median by more than 10 %, gaps not counted."""
    if t.size < 3:
        return np.zeros(t.size, bool)
    step = np.diff(t)
    off = np.abs(step - np.median(step)) > 0.1 * np.median(step)
    return np.concatenate([[False], off]) & ~gaps(t)


def spikes(x: Array) -> Mask:
    """Samples far off the running median, both against the channel's usual residual and against their window.

    The first test (6 robust sigma, from the 95th percentile of the residual) keeps noise quiet, the second (6 local
    sigma, from the median deviation in the window) keeps sharp but real motion quiet.
    """
    mask = np.zeros(x.size, bool)
    if x.size < _WINDOW:
        return mask
    residual = np.abs(x - median_filter(x, _WINDOW, mode="nearest"))
    low, high = np.quantile(x, [0.01, 0.99])
    steps = np.abs(np.diff(x))
    lsb = float(np.min(steps[steps > 0], initial=np.inf))
    usual = max(6 / 1.96 * float(np.quantile(residual, 0.95)), 2e-3 * float(high - low),
                5 * lsb if np.isfinite(lsb) else 0.0)
    half = _WINDOW // 2
    for i in np.flatnonzero(residual > usual):
        window = x[max(0, i - half):i + half + 1]
        middle = float(np.median(window))
        mask[i] = abs(x[i] - middle) > 6 * 1.4826 * float(np.median(np.abs(window - middle)))
    return mask


def saturated(x: Array, limits: tuple[float, float] | None, own_extremes: bool = True) -> Mask:
    """Samples at or beyond `limits`, and runs that hit the channel's own extreme at speed and stay exactly there."""
    mask = np.zeros(x.size, bool) if limits is None else (x <= limits[0]) | (x >= limits[1])
    if not own_extremes or np.ptp(x) == 0:
        return mask
    speed = float(np.sqrt(np.mean(np.diff(x) ** 2)))
    for start, stop in _level_runs(x, 10):
        if x[start] not in (x.min(), x.max()):
            continue
        before, after = max(0, start - 3), min(x.size - 1, stop + 2)
        slopes = [abs(x[start] - x[before]) / (start - before)] if start > before else []
        slopes += [abs(x[after] - x[stop - 1]) / (after - stop + 1)] if after > stop - 1 else []
        if slopes and max(slopes) > 0.5 * speed:
            mask[start:stop] = True
    return mask


def stuck(channels: Mapping[str, Array]) -> dict[str, Mask]:
    """For each channel, runs of one value longer than 25 samples and 1 % of the log while another channel moves.

    "Moves" means: passes through more than 5 % of its own range during the run.
    """
    out = {name: np.zeros(x.size, bool) for name, x in channels.items()}
    for name, x in channels.items():
        for start, stop in _level_runs(x, max(26, x.size // 100 + 1)):
            if any(np.ptp(y[start:stop]) > 0.05 * np.ptp(y) for other, y in channels.items()
                   if other != name and np.ptp(y) > 0):
                out[name][start:stop] = True
    return out


def _level_runs(x: Array, shortest: int) -> list[tuple[int, int]]:
    """Half-open ranges in which x is exactly constant over at least `shortest` samples."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(x) != 0) + 1, [x.size]])
    return [(int(a), int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True) if b - a >= shortest]
