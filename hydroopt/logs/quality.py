"""What looks wrong in a log. Each check gives a mask over samples; nothing is changed here."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from hydroopt.logs.channels import is_force
from hydroopt.logs.mapped import MAPPED, release
from hydroopt.logs.table import runs

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
REPEATED, EVEN, OFTEN = 3, 5, 0.9
"""Samples from one change of a repeated channel to the next, at least; those from which on they may differ by one; and
the share of changes that are so even."""
FINEST = {"m": 1e-6, "rad": 1e-6, "Pa": 100.0}
"""Steps that the finest instruments of machines resolve, by unit: magnetostrictive transducers, encoders of 22 bits,
16 bits of 60 bar."""
GAP = 3.0
"""Usual steps from which on a longer one is a gap."""
WINDOW = 25
"""Samples of a running median, so that spikes up to 12 samples wide stand out."""
_USUAL = 1.96 / 6  # 95th percentile of residuals, as a part of the greatest one that is usual


@dataclass(frozen=True)
class Finding:
    """A finding about a log.

    Attributes:
        kind: "nan", "duplicate", "non-monotonic", "irregular", "gap", "stuck", "spike", "saturated", "held"
            (repeated by the logger between the samples of a slower sensor), "dead" (a force
            that never changes while its joint moves), or for information "rows" (a map selected them), "ignored"
            (columns that are not channels), "empty" (columns without a number), "sparse" (columns with numbers in some
            rows), "format" and "clock" (what was taken of a file and of its times that they do not state), "unpaired"
            and "resampled" (samples that the merging of a recording's groups leaves out).
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


def finding(kind: str, channel: str, rows: NDArray[np.int64], text: str) -> Finding:
    """Samples by their data rows (m,) as one finding; `text` starts with a plural verb."""
    noun, (verb, rest) = "samples", text.split(" ", 1)
    if rows.size == 1:
        noun, verb = "sample", "is" if verb == "are" else f"{verb}s"
    return Finding(kind, channel, int(rows[0]), int(rows[-1]), int(rows.size),
                   f"{channel}: {noun} {runs(rows)} {verb} {rest}")


def out_of_order(t: Array) -> Mask:
    """Samples whose time stands off their neighbours' order, repeated stamps not counted.

    Stray stamps are found against a running median. Where the clock itself restarts, all samples that are not
    later than an earlier one are marked.
    """
    if not following(t, lambda steps: ~(steps >= 0)).size:
        return np.zeros(t.size, bool)
    stray = median_filter(t, WINDOW, mode="nearest") != t
    if 2 * np.count_nonzero(stray) < t.size and np.all(np.diff(t[~stray]) >= 0):
        kept = np.where(stray, -np.inf, t)
        before, after = np.maximum.accumulate(kept), np.inf
        for i in range(t.size - 1, -1, -1):
            if not stray[i] or before[i] < t[i] < after:
                stray[i], after = False, t[i]
        return np.asarray(stray, dtype=bool)
    return np.asarray(t < np.maximum.accumulate(t), dtype=bool)


def usual_step(t: Array) -> float:
    """The median step [s], of a long log that of some of its steps, evenly spread; 0 of a single sample."""
    every = t.size // MAPPED + 1
    return float(np.median(t[1::every] - t[:-1:every])) if t.size > 1 else 0.0


def gaps(t: Array, usual: float) -> NDArray[np.intp]:
    """Samples that follow a step of more than three of the `usual` ones."""
    return following(t, lambda steps: steps > GAP * usual)


def following(t: NDArray[Any], judge: Callable[[NDArray[Any]], Mask]) -> NDArray[np.intp]:
    """Places of the samples of t (N,) that follow a step which is judged so; the first one follows none.

    >>> following(np.array([0.0, 1.0, 3.0]), lambda steps: steps > 1).tolist()
    [2]
    """
    found = []
    for start in range(0, t.size, MAPPED // 8):
        found.append(start + 1 + np.flatnonzero(judge(np.diff(t[start:start + MAPPED // 8 + 1]))))
        release()
    return np.concatenate([np.empty(0, np.intp), *found])


def spikes(x: Array, finest: float = 0.0) -> Mask:
    """Samples far off the running median, both against the channel's usual residual and against their window.

    The first test (6 robust sigma, from the 95th percentile of the residual) keeps noise quiet, the second (8
    local sigma, from the median deviation in the window less its slope) keeps sharp but real motion quiet. A
    spike extends by up to 3 samples on each side that stand off by 2 robust sigma. What is smaller than the `finest`
    step of such an instrument is none: without noise, as in simulated logs, the smallest true shock stands out.
    """
    mask = np.zeros(x.size, bool)
    if x.size < WINDOW:
        return mask
    signed = x - median_filter(x, WINDOW, mode="nearest")
    residual = np.abs(signed)
    worst = float(residual.max())
    # by far the most often more than 5 % are so large that the worst is usual: no quantile need be known
    if worst <= finest or np.count_nonzero(residual >= _USUAL * worst) >= x.size - int(0.95 * (x.size - 1)):
        return mask
    low, high = np.quantile(x, [0.01, 0.99])
    steps = np.abs(np.diff(x))
    usual = max(finest, float(np.quantile(residual, 0.95)) / _USUAL, 2e-3 * float(high - low),
                5 * float(np.min(steps[steps > 0])))
    if worst <= usual:
        return mask
    half, far = WINDOW // 2, np.flatnonzero(residual > usual)
    inner = (far >= half) & (far < x.size - half)
    mask[far[inner]] = residual[far[inner]] > 8 * _spread(sliding_window_view(x, WINDOW)[far[inner] - half])
    for i in far[~inner]:
        mask[i] = residual[i] > 8 * _spread(x[None, max(0, i - half):i + half + 1])[0]
    for i in np.flatnonzero(mask):
        for direction in (-1, 1):
            for j in range(i + direction, i + 4 * direction, direction):
                if not 0 <= j < x.size or 3 * residual[j] < usual or signed[j] * signed[i] < 0:
                    break
                mask[j] = True
    return mask


def without_noise(channels: Mapping[str, Array]) -> bool:
    """Whether no channel (N,) that mostly changes contains noise, as in exact simulated logs, where a rest is no fault.

    The differences of noise grow with their order, those of a smooth motion shrink.

    >>> t = np.arange(500) / 50
    >>> noise = 1e-4 * np.random.default_rng(0).standard_normal(500)
    >>> without_noise({"q": np.sin(t), "p": np.maximum(np.sin(3 * t), 0)}), without_noise({"q": np.sin(t) + noise})
    (True, False)
    """
    def size(x: Array, order: int) -> float:
        steps = np.abs(np.diff(x, order))
        return float(np.median(steps[steps > 0])) if np.any(steps) else 0.0

    changing = [x for x in channels.values() if 2 * np.count_nonzero(np.diff(x)) > x.size]
    return bool(changing) and all(size(x, 5) < size(x, 2) for x in changing)


Extremes = tuple[float, float]


def _spread(windows: Array) -> Array:
    """Robust standard deviation (m,) of windows (m, w) about their slope."""
    width = windows.shape[1]
    third = width // 3
    slope = (np.median(windows[:, -third:], axis=1) - np.median(windows[:, :third], axis=1)) / (width - third)
    level = windows - slope[:, None] * np.arange(width)
    return np.asarray(1.4826 * np.median(np.abs(level - np.median(level, axis=1, keepdims=True)), axis=1))


def saturated(x: Array, limits: Extremes | None, own_extremes: bool = True, whole: Extremes | None = None) -> Mask:
    """Samples at or beyond `limits`, and runs that hit the channel's own extreme at speed and stay there.

    `whole` are the channel's extremes where x is but a piece of it.
    """
    mask = np.zeros(x.size, bool) if limits is None else (x <= limits[0]) | (x >= limits[1])
    extremes = (x.min(), x.max()) if whole is None else whole
    if not own_extremes or extremes[0] == extremes[1]:
        return mask
    for start, stop in _level_runs(x, 10):
        if x[start] in extremes and _abrupt(x, start, stop):
            mask[start:stop] = True
    return mask


def stuck(channels: Mapping[str, Array], whole: Mapping[str, Extremes] | None = None) -> dict[str, Mask]:
    """Frozen samples by channel: level for more than 25 samples and 1 % of the log, begun or ended at speed.

    A run counts only while another channel passes through more than 5 % of its range. A joint that comes to
    rest slows down first and is not meant, nor is a velocity of zero; a channel that never changes at all is, and a
    force that changes from sample to sample elsewhere. `whole` are the channels' extremes where these are but a piece
    of the log.
    """
    out = {name: np.zeros(x.size, bool) for name, x in channels.items()}
    extremes = whole or {name: (float(x.min()), float(x.max())) for name, x in channels.items()}
    ranges = {name: extremes[name][1] - extremes[name][0] for name in channels}
    for name, x in channels.items():
        odd = frozen(x) if is_force(name) else []
        for start, stop in _level_runs(x, max(26, x.size // 100 + 1)):
            at_rest = name.endswith(".qd") and x[start] == 0
            if ranges[name] > 0 and (at_rest or not ((start, stop) in odd or _abrupt(x, start, stop))):
                continue
            if any(np.ptp(y[start:stop]) > 0.05 * ranges[other] for other, y in channels.items()
                   if other != name and ranges[other] > 0):
                out[name][start:stop] = True
    return out


def frozen(x: Array, segment: NDArray[np.int64] | None = None) -> list[tuple[int, int]]:
    """Half-open ranges of one stretch in which a channel (N,) rests at one value for more than 25 samples, though it
    changes with nearly each sample elsewhere, as sensors with noise do. A range's end, where it rests again and again,
    is not meant: it is saturated there."""
    cuts = [] if segment is None else (np.flatnonzero(np.diff(segment)) + 1).tolist()
    level = [(a + start, a + stop) for a, b in pairwise([0, *cuts, x.size])
             for start, stop in _level_runs(x[a:b], WINDOW + 1)]
    if not level:
        return []
    free = np.ones(x.size, bool)
    for start, stop in level:
        free[start:stop] = False
    if np.count_nonzero(free) < WINDOW or np.mean(np.diff(x)[free[1:]] == 0) > 0.1:
        return []
    ends = [end for end in (np.nanmin(x), np.nanmax(x))
            if np.any(x[free] == end) or sum(x[start] == end for start, _ in level) > 1]
    return [(start, stop) for start, stop in level if x[start] not in ends]


def held(x: Array) -> int:
    """Every how many samples a channel (N,) changes, at least three, if it rests in between all along; else 0.

    A slow sensor that the logger repeats changes evenly, by many steps at once; slow motion in coarse steps does not.

    >>> wave = np.sin(np.arange(600) / 40.0)
    >>> held(np.repeat(wave[::10], 10)), held(wave), held(np.round(wave, 1))
    (10, 0, 0)
    """
    steps = np.diff(x)
    at = np.flatnonzero(steps)
    if at.size < WINDOW:
        return 0
    gaps, sizes = np.diff(at), np.abs(steps[at])
    every = int(np.median(gaps))
    even = np.mean(np.abs(gaps - every) <= (1 if every > EVEN else 0))
    return every if every >= REPEATED and even >= OFTEN and np.median(sizes) > 2 * np.min(sizes) else 0


def _abrupt(x: Array, start: int, stop: int) -> bool:
    """Whether x enters or leaves the level run at more than half its usual (RMS) speed, over 3 steps."""
    speed = float(np.sqrt(np.mean(np.diff(x) ** 2)))
    before, after = max(0, start - 3), min(x.size - 1, stop + 2)
    entry = abs(x[start] - x[before]) / max(start - before, 1)
    leave = abs(x[after] - x[stop - 1]) / max(after - stop + 1, 1)
    return bool(max(entry, leave) > 0.5 * speed)


def _level_runs(x: Array, shortest: int) -> list[tuple[int, int]]:
    """Half-open ranges in which x is exactly constant over at least `shortest` samples, two or more."""
    step = shortest // 2  # at least two samples that are so far apart lie in such a range
    some = x[::step]
    at = step * np.flatnonzero(some[1:] == some[:-1])
    if not at.size or not np.any(np.all(x[at[:, None] + np.arange(step)] == x[at, None], axis=1)):
        return []
    edges = np.concatenate([[0], np.flatnonzero(np.diff(x) != 0) + 1, [x.size]])
    long = np.flatnonzero(np.diff(edges) >= shortest)
    return list(zip(edges[long].tolist(), edges[long + 1].tolist(), strict=True))
