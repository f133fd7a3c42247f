"""What is done about the findings of a log: the actions a user may choose, and carrying them out."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError, ProblemError
from hydroopt.logs import quality as find
from hydroopt.logs.channels import is_force, si_unit
from hydroopt.logs.mapped import by_pieces, extremes, release
from hydroopt.logs.quality import Array, Extremes, Finding, Mask
from hydroopt.logs.table import runs

ACTIONS: dict[str, tuple[str, ...]] = {
    "nan": ("use", "drop", "interpolate", "error"),
    "non-monotonic": ("error", "drop"),
    "duplicate": ("error", "first", "mean"),
    "held": ("keep", "drop", "error"),
    "saturated": ("keep", "drop", "error"),
    "stuck": ("keep", "drop", "error"),
    "spike": ("keep", "drop", "interpolate", "error"),
    "irregular": ("keep", "error"),
    "gap": ("split", "keep", "error"),
}
"""Actions by kind of finding; the first is the default. `use`: a sample without a force serves the other actuators, one
without anything else is dropped."""


AT_ONCE = {"nan": ("interpolate",), "spike": ("interpolate",), "non-monotonic": ("drop",), "duplicate": ("mean",),
           "held": ("drop", "error")}
"""Actions that take all samples of a log at once, however many there are."""
Found = tuple[str, str, NDArray[Any], str]
"""What is found: its kind, the channel, a mask of samples (N,) or their data rows (m,), and what these do, a text that
starts with a plural verb."""
PIECE, BESIDE = 2**17, 2**10
"""Samples of a log that are treated and smoothed together, and those beside them by which they are judged."""


@dataclass(frozen=True)
class Samples:
    """Time t (N,) [s], channels (N,) [SI], data row (N,) of each sample, and what was found; of a piece of a longer
    log `whole` are the extremes of the log's channels.
    """

    t: Array
    channels: dict[str, Array]
    sample: NDArray[np.int64]
    findings: tuple[Finding, ...] = ()
    whole: Mapping[str, Extremes] | None = None

    def having(self, name: str, x: Array) -> "Samples":
        """The same with another channel of that name."""
        return replace(self, channels={**self.channels, name: x})

    def keep(self, mask: Mask) -> "Samples":
        """The samples in `mask` (N,)."""
        kept = np.flatnonzero(mask)
        t, sample, *values = (by_pieces(kept.size, partial(_taken, x, kept), x.dtype)
                              for x in (self.t, self.sample, *self.channels.values()))
        return replace(self, t=t, sample=sample, channels=dict(zip(self.channels, values, strict=True)))


def _finite(x: Array, span: slice) -> Array:
    return np.where(np.isinf(x[span]), np.nan, x[span])


def _taken(x: NDArray[Any], places: NDArray[np.intp], span: slice) -> NDArray[Any]:
    return x[places[span]]


def numbered(cuts: NDArray[np.intp], size: int) -> NDArray[np.int64]:
    """The stretch (N,) that each of so many samples belongs to, where others begin at the `cuts`.

    >>> numbered(np.array([2, 3]), 5).tolist()
    [0, 0, 1, 2, 2]
    """
    return by_pieces(size, lambda span: np.searchsorted(cuts, np.arange(span.start, span.stop), "right"), int)


def choose(treatment: Mapping[str, str] | None) -> dict[str, str]:
    """The action for each kind of finding, defaults filled in.

    Raises:
        ProblemError: unknown kind or action.
    """
    chosen = {kind: actions[0] for kind, actions in ACTIONS.items()}
    for kind, action in (treatment or {}).items():
        if kind not in ACTIONS:
            raise ProblemError(f"'{kind}' is not a kind of finding", where="treatment",
                               remedy=f"use one of {', '.join(ACTIONS)}")
        if action not in ACTIONS[kind]:
            raise ProblemError(f"'{action}' is not a treatment of '{kind}'", where="treatment",
                               remedy=f"use one of {', '.join(ACTIONS[kind])}")
        chosen[kind] = action
    return chosen


def treat(samples: Samples, chosen: Mapping[str, str], limits: Mapping[str, Extremes],
          where: str) -> tuple[Samples, NDArray[np.int64]]:
    """Find and treat, in this order: NaN, time order, repeated stamps, repeated readings, outliers, sampling.

    Returns the samples left and the stretch (N,) each belongs to.

    Raises:
        LogError: a kind whose action is "error" was found, or too little is left.
    """
    at_once = samples.t.size <= PIECE or any(chosen[kind] in actions for kind, actions in AT_ONCE.items())
    samples, found = (_treated if at_once else _by_pieces)(samples, chosen, limits, where)
    behind, sampling = _sampling(samples)
    for kind, channel, places, text in sampling:
        _refuse(samples, (kind, channel, places, text), chosen, where)
        found.append((kind, channel, samples.sample[places], text))
    return replace(samples, findings=tuple(_findings(found, chosen))), numbered(
        behind if chosen["gap"] == "split" else behind[:0], samples.t.size)


def _treated(samples: Samples, chosen: Mapping[str, str], limits: Mapping[str, Extremes],
             where: str) -> tuple[Samples, list[Found]]:
    """What is left of samples, and what was found by rows, gaps and jitter of their times aside."""
    found = list[Found]()
    for check in (_not_a_number, _order, _repeats, *([_held] if chosen["held"] != "keep" else []), _outliers):
        drop = np.zeros(samples.t.size, bool)
        for kind, name, mask, text in check(samples, limits, where):
            action = chosen[kind]
            _refuse(samples, (kind, name, mask, text), chosen, where)
            found.append((kind, name, samples.sample[mask], text))
            if action == "interpolate":
                samples = _bridge(samples, name, mask, where)
            elif action == "use" and is_force(name):
                samples = samples.having(name, np.where(mask, np.nan, samples.channels[name]))
            elif action == "mean":
                group = np.cumsum(~mask) - 1
                count = np.bincount(group)
                samples = replace(samples, channels={
                    each: (np.bincount(group, x) / count)[group] for each, x in samples.channels.items()})
            if action in ("drop", "first", "mean") or (action == "use" and not is_force(name)):
                drop |= mask
        samples = samples.keep(~drop) if drop.any() else samples
        if samples.t.size < 2:
            raise LogError(f"only {samples.t.size} of the samples would be left", where=where,
                           remedy="choose other treatments or record the log again")
    return samples, found


def _by_pieces(samples: Samples, chosen: Mapping[str, str], limits: Mapping[str, Extremes],
               where: str) -> tuple[Samples, list[Found]]:
    """The same of many samples, of which a piece and what lies beside it are judged at a time."""
    count, keep, found = samples.t.size, np.zeros(samples.t.size, bool), list[Found]()
    whole = {name: extremes(x) for name, x in samples.channels.items()}
    for start in range(0, count, PIECE):
        core, around = slice(start, min(start + PIECE, count)), slice(max(start - BESIDE, 0), start + PIECE + BESIDE)
        rows = samples.sample[core]
        piece = Samples(samples.t[around], {name: x[around] for name, x in samples.channels.items()},
                        samples.sample[around], whole=whole)
        piece, some = _treated(piece, chosen, limits, where)
        keep[core] = np.isin(rows, piece.sample)
        found += [(kind, name, at[(at >= rows[0]) & (at <= rows[-1])], text) for kind, name, at, text in some]
        release()
    for name in (name for name, ends in whole.items() if np.any(np.isinf(ends))):
        samples.channels[name] = by_pieces(count, partial(_finite, samples.channels[name]))
    return samples if keep.all() else samples.keep(keep), found


def _findings(found: Iterable[Found], chosen: Mapping[str, str]) -> Iterator[Finding]:
    """What was found of one kind in one channel as one finding, with what was done about it."""
    groups: dict[tuple[str, str], tuple[list[NDArray[Any]], str]] = {}
    for kind, channel, rows, text in found:
        if rows.size:
            groups.setdefault((kind, channel), ([], text))[0].append(rows)
    for (kind, channel), (some, text) in groups.items():
        done = {"keep": "", "drop": "; dropped", "interpolate": "; interpolated", "first": "; first one kept",
                "mean": "; averaged", "split": "; split there",
                "use": "; used for other actuators" if is_force(channel) else "; dropped"}[chosen[kind]]
        yield find.finding(kind, channel, np.concatenate(some), f"{text}{done}")


def _refuse(samples: Samples, found: Found, chosen: Mapping[str, str], where: str) -> None:
    """Raise a LogError where the action about what was found is "error"."""
    kind, channel, mask, text = found
    if chosen[kind] == "error":
        others = " or ".join(f"--treat {kind}={a}" for a in ACTIONS[kind] if a != "error")
        said = find.finding(kind, channel, samples.sample[mask], text)
        raise LogError(f"{said.text} ({said.count} of rows {samples.sample[0]} to {samples.sample[-1]})", where=where,
                       remedy=f"choose {others}, or correct the file")


def _not_a_number(samples: Samples, limits: object, where: str) -> Iterator[Found]:
    for name, x in {"t": samples.t, **samples.channels}.items():
        if (mask := ~np.isfinite(x)).any():
            yield "nan", name, mask, "hold no finite number"


def _bridge(samples: Samples, name: str, mask: Mask, where: str) -> Samples:
    """Linear in time over the masked samples; never beyond the outermost good ones."""
    if name == "t":
        raise LogError(f"t: samples {runs(samples.sample[mask])} have no time, which cannot be interpolated",
                       where=where, remedy="choose --treat nan=drop or correct the file")
    good = np.flatnonzero(~mask & np.isfinite(samples.channels[name]))
    if good.size < 2 or mask[0] or mask[-1]:
        raise LogError(f"{name}: samples at the very start or end cannot be interpolated", where=where,
                       remedy="choose 'drop' instead, or trim the log with 'rows = [first, last]' in a map")
    order = good[np.argsort(samples.t[good], kind="stable")]
    x = samples.channels[name].copy()
    x[mask] = np.interp(samples.t[mask], samples.t[order], x[order])
    return samples.having(name, x)


def _order(samples: Samples, limits: object, where: str) -> Iterator[Found]:
    mask = find.out_of_order(samples.t)
    if mask.any():
        yield "non-monotonic", "t", mask, "are out of the order of time"
    if 2 * np.count_nonzero(mask) > mask.size:
        raise LogError("more than half of the samples are out of the order of time", where=where,
                       remedy="select a good stretch with 'rows = [first, last]' in a map, or correct the times")


def _repeats(samples: Samples, limits: object, where: str) -> Iterator[Found]:
    mask = np.diff(samples.t, prepend=-np.inf) == 0
    if mask.any():
        yield "duplicate", "t", mask, "repeat the time stamp before"


def _held(samples: Samples, limits: object, where: str) -> Iterator[Found]:
    """Positions that the logger repeats between the samples of a slower sensor: all samples but its own are found."""
    every = {name: find.held(x) for name, x in samples.channels.items() if name.rpartition(".")[2] in ("q", "length")}
    slowest = max(every, key=lambda name: every[name], default="")
    if slowest and every[slowest]:
        rows = np.arange(samples.t.size)
        changes = np.flatnonzero(np.diff(samples.channels[slowest])) + 1
        phase = int(np.bincount(changes % every[slowest]).argmax())
        regular = np.mean(changes % every[slowest] == phase) > find.OFTEN
        mask = rows % every[slowest] != phase if regular else ~np.isin(rows, changes)
        yield "held", slowest, mask, "repeat the reading before"


def _outliers(samples: Samples, limits: Mapping[str, Extremes], where: str) -> Iterator[Found]:
    """Saturation, standstill, spikes: each sample counts once. Commands (`.u`) may rest and jump.

    Where a force is missing its channel is judged as if it were a straight line there.
    """
    present = {name: np.isfinite(x) for name, x in samples.channels.items()}
    joined = {name: x if present[name].all() else np.interp(samples.t, samples.t[present[name]], x[present[name]])
              for name, x in samples.channels.items() if present[name].any()}
    sensed = {name: x for name, x in joined.items() if not name.endswith(".u")}
    sensed = {} if find.without_noise(sensed) else sensed
    whole = samples.whole or {}
    clipped = {name: find.saturated(x, limits.get(name), name in sensed, whole.get(name)) & present[name]
               for name, x in joined.items()}
    level = {name: mask & ~clipped[name] & present[name] for name, mask in find.stuck(sensed, samples.whole).items()}
    spiky = {name: find.spikes(x, find.FINEST.get(si_unit(name), 0.0)) & ~clipped[name] & ~level[name] & present[name]
             for name, x in sensed.items()}
    for kind, masks, found in (("saturated", clipped, _at_limit), ("stuck", level, _level), ("spike", spiky, _worst)):
        for name, mask in masks.items():
            if mask.any():
                yield kind, name, mask, found(samples, limits, name, mask)


def _at_limit(samples: Samples, limits: Mapping[str, Extremes], name: str, mask: Mask) -> str:
    x, unit = samples.channels[name][mask], si_unit(name)
    low, high = limits.get(name, (-np.inf, np.inf))
    ends = [f"lie at or {word} {end:.4g} {unit}, the {which} that is stated" for word, which, end, there in (
        ("below", "least", low, x <= low), ("above", "most", high, x >= high)) if np.any(there)]
    if own := np.unique(x[(x > low) & (x < high)]).tolist():
        values = " or ".join(f"{value:.4g} {unit}" for value in own)
        ends.append(f"rest at {values}, the channel's own extreme, as if the sensor's range ended there")
    return " or ".join(ends)


def _level(*_: object) -> str:
    return "rest at one value while other channels move"


def _worst(samples: Samples, limits: object, name: str, mask: Mask) -> str:
    x, good, found = samples.channels[name], ~mask & np.isfinite(samples.channels[name]), np.flatnonzero(mask)
    off = np.nan_to_num(np.abs(x[found] - np.interp(samples.t[found], samples.t[good], x[good])))
    return f"stand off their neighbours (worst at sample {samples.sample[found[np.argmax(off)]]})"


def _sampling(samples: Samples) -> tuple[NDArray[np.intp], list[Found]]:
    """Places of the samples behind gaps, and what is found of the steps of the times, by places."""
    step = find.usual_step(samples.t)
    behind, uneven = find.gaps(samples.t, step), find.following(samples.t, lambda steps: (
        (steps < 0.9 * step) | (steps > 1.1 * step)) & (steps <= find.GAP * step))
    found = list[Found]()
    if behind.size:
        longest = float(np.max(samples.t[behind] - samples.t[behind - 1]))
        found.append(("gap", "t", behind, f"follow a gap (longest {longest:.4g} s, usual step {step:.4g} s)"))
    if uneven.size:
        found.append(("irregular", "t", uneven, f"come off the usual step of {step:.4g} s by more than 10 %"))
    return behind, found
