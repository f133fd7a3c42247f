"""The likeliest cause of a misfit: which listed fault explains it, repeats in both halves of the data, and how large.

Score tests with the covariance of `error_covariance` and the machine file's priors on all parameters: of a fault with
sensitivity s, u = sᵀV⁻¹r and i = sᵀV⁻¹s give its size u/i and the evidence lnB = ½·LM·τ²/(τ² + 1/i) − ½·ln(1 + τ²·i)
with LM = u²/i and τ its usual size. Everything after the whitening is algebra on one table of inner products.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import special

from hydroopt.estimation.dynamic.misfit.blocks import COURSES, Columns, Data
from hydroopt.estimation.dynamic.misfit.faults import Fault
from hydroopt.estimation.dynamic.misfit.listed_faults import listed
from hydroopt.estimation.dynamic.misfit.spectrum import Fast, Line, faster, lines
from hydroopt.results.tables import number
from hydroopt.spatial.inertia import Array

ALARM = 1e-3
"""Probability of a false alarm of the test of fit, all readings together, and that sound data show any fault of the
list."""
EXPLAINED = 0.02
"""Probability of the residuals that are left, all readings together, below which no cause is named."""
EVIDENCE = np.log(10.0)
"""Evidence lnB that a fault needs."""
TIED, ROUGH = 3.0, 0.05
"""Difference in evidence, and as a part of the largest since effects are computed roughly, below which faults are not
distinguished."""
MOST, LARGEST = 2, 10.0
"""Faults that are looked for, one after the other, and the largest size that one may have, as a multiple of its scale:
beyond, the prior by which its evidence is weighed would itself be refuted."""
AGREE, SEEN = 0.5, 1.64
"""Both halves show a fault: sizes agree within this part of their mean or 2 standard deviations, each beyond `SEEN`."""
REFITS = 8
"""Candidates whose effect is followed beyond its derivative."""


@dataclass(frozen=True)
class Cause:
    """A fault that the data show, with those that they do not tell apart from it.

    Attributes:
        fault: the likeliest; `tied`: others that explain as much.
        size, std: in SI.
        evidence: lnB against no fault.
        repeats: whether both halves of the data show it alike.
    """

    fault: Fault
    size: float
    std: float
    evidence: float
    repeats: bool
    tied: tuple[Cause, ...] = ()

    @property
    def ci95(self) -> tuple[float, float]:
        """95 % interval of the size [SI]."""
        return self.size - 1.96 * self.std, self.size + 1.96 * self.std

    def as_dict(self) -> dict[str, Any]:
        """The entry of a JSON file; sizes as printed, in the fault's unit."""
        factor = self.fault.factor
        return {"fault": self.fault.name, "words": self.fault.words, "unit": self.fault.unit,
                "size": number(self.size * factor), "std": number(self.std * factor),
                "ci95": [number(limit * factor) for limit in self.ci95], "evidence": number(self.evidence),
                "repeats": self.repeats, "not_separable_from": [other.fault.name for other in self.tied]}


@dataclass(frozen=True, eq=False)
class Misfit:
    """What a test of fit found.

    Attributes:
        before, after: probability of each reading's slow residuals if the model were complete; without faults, and with
            `found` taken into account.
        found: faults that the data show.
        smallest: by fault looked for, the size [SI] that this log would have shown with a probability of 95 %.
        noise: ratio of each reading's white noise to what its sensors state; NaN where nothing is stated.
        spikes: share of each reading's samples that are far off their neighbours.
        lines: oscillations by reading, faster than the motion.
        follows: over what each reading's residuals are least like noise, one of `COURSES`.
        excess: RMS of each reading's residuals as a multiple of what noise and errors of the motion add.
        fast: readings whose residuals are mostly faster than what smoothing passes.
    """

    before: Mapping[str, float]
    after: Mapping[str, float]
    found: tuple[Cause, ...]
    smallest: Mapping[Fault, float]
    noise: Mapping[str, float]
    spikes: Mapping[str, float]
    lines: Mapping[str, Line]
    follows: Mapping[str, str]
    excess: Mapping[str, float]
    fast: Mapping[str, Fast]

    @property
    def alarmed(self) -> tuple[str, ...]:
        """Readings whose residuals noise and smoothing do not explain."""
        return tuple(name for name, p in self.before.items() if p < ALARM / len(self.before))

    @property
    def explained(self) -> bool:
        """Whether the faults found leave nothing unexplained."""
        return all(p >= EXPLAINED / len(self.after) for p in self.after.values())

    @property
    def shown(self) -> dict[str, tuple[float, float, str]]:
        """By group of faults: the least and the largest of `smallest` over it, as printed, and the unit."""
        sizes: dict[str, list[tuple[float, str]]] = {}
        for fault, size in self.smallest.items():
            if size < LARGEST * fault.scale:
                sizes.setdefault(fault.group, []).append((size * fault.factor, fault.unit))
        return {group: (min(each)[0], max(each)[0], each[0][1]) for group, each in sizes.items()
                if len({unit for _, unit in each}) == 1}

    @property
    def causes(self) -> tuple[Cause, ...]:
        """The faults that may be named: together they explain the misfit, and each repeats."""
        return self.found if self.explained and all(cause.repeats for cause in self.found) else ()

    def as_dict(self) -> dict[str, Any]:
        """The entry of a JSON file; sizes as printed, in the unit of each fault."""
        causes = [one.as_dict() for one in self.found]
        smallest = [{"fault": fault.name, "words": fault.words, "unit": fault.unit,
                     "would_have_shown": number(size * fault.factor)} for fault, size in self.smallest.items()]
        return {"probability": dict(self.before), "probability_with_causes": dict(self.after),
                "noise_ratio": {name: number(ratio) for name, ratio in self.noise.items()},
                "spikes": dict(self.spikes), "causes": causes, "named": bool(self.causes), "faults": smallest}


class Search:
    """Score tests about a problem's data, with faults added one by one."""

    def __init__(self, data: Data, faults: Sequence[Fault], chosen: Sequence[tuple[Fault, float]] = ()) -> None:
        self.data, self.faults = data, list(faults)
        self._columns = data.columns([np.stack([f.sensitivity(v) for f in faults], axis=2) for v in data.views])
        self._residual = data.residual()
        self._products: dict[tuple[int, int], tuple[Columns, Columns, Array]] = {}
        self._roots: dict[tuple[bytes, float], Array] = {}
        self.chosen = list(chosen)

    def _effects(self, faults: Sequence[tuple[Fault, float]]) -> list[Array] | None:
        if not faults:
            return None
        return [np.sum([fault.effect(view, size) for fault, size in faults], axis=0) for view in self.data.views]

    def projected(self, columns: Sequence[Columns], residual: Columns, blocks: Array, weaker: float = 1.0) -> Array:
        """XᵀV⁻¹X of all columns, the residual last, with all nuisances taken out under their priors."""
        data, every = self.data, [*columns, residual]
        K = data.nuisances
        KK, KX = self._sum(K, K, blocks), np.hstack([self._sum(K, one, blocks) for one in every])
        XX = np.vstack([np.hstack([self._sum(one, other, blocks) for other in every]) for one in every])
        KX[:, -1] += weaker * data.pull
        key = blocks.tobytes(), weaker
        if key not in self._roots:
            values, vectors = np.linalg.eigh(data.scale[:, None] * (KK + weaker * data.prior) * data.scale)
            kept = values > 1e-13 * values[-1]
            self._roots[key] = (vectors[:, kept] / np.sqrt(values[kept])).T * data.scale
        half = self._roots[key] @ KX
        return np.asarray(XX - half.T @ half)

    def _sum(self, one: Columns, other: Columns, blocks: Array) -> Array:
        key, swapped = (id(one), id(other)), (id(other), id(one))
        if swapped in self._products:
            return np.asarray(np.sum(self._products[swapped][2][blocks], axis=0).T)
        if key not in self._products:
            self._products[key] = one, other, one.inner(other)  # holding them keeps their ids their own
        return np.asarray(np.sum(self._products[key][2][blocks], axis=0))

    def present(self) -> tuple[list[Columns], Columns]:
        """Sensitivities of the chosen faults at their sizes, and the residual without their effects."""
        if not self.chosen:
            return [], self._residual
        rows = [np.stack([fault.sensitivity(view, size) for fault, size in self.chosen], axis=2)
                for view in self.data.views]
        return [self.data.columns(rows)], self.data.residual(self._effects(self.chosen))

    def lack_of_fit(self) -> dict[str, float]:
        """Probability of the slow residuals of each reading if nothing but the chosen faults were there."""
        return lack_of_fit(self.by_course())

    def by_course(self) -> dict[str, dict[str, float]]:
        """The same over each of `COURSES`."""
        held, residual = self.present()
        every, made = np.ones(len(self.data.blocks), dtype=bool), {}
        for name, cosines in zip(self.data.views[0].names, self.data.cosines, strict=True):
            table = _without(self.projected([*held, cosines], residual, every, 0.01), len(self.chosen))
            ends = np.cumsum(list(COURSES.values())).tolist()
            made[name] = {over: _of_noise(table[end - count : end, end - count : end], table[end - count : end, -1])
                          for end, (over, count) in zip(ends, COURSES.items(), strict=True)}
        return made

    def step(self) -> tuple[Cause, ...]:
        """The faults that explain most of what is left, the likeliest first; none where nothing is shown."""
        held, residual = self.present()
        every = np.ones(len(self.data.blocks), dtype=bool)
        table = _without(self.projected([*held, self._columns], residual, every), len(self.chosen))
        before = {fault for fault, _ in self.chosen}
        rivals = []
        for k, fault in enumerate(self.faults):
            information, score = table[k, k], table[k, -1]
            if information * fault.scale**2 <= 1e-12 or fault in before or (fault.positive and score < 0):
                continue
            rivals.append(_weighed(fault, score / information, score**2 / information, information))
        rivals.sort(key=lambda cause: -cause.evidence)
        if not rivals:
            return ()
        best = rivals[0].evidence
        near = [c for c in rivals if c.evidence > best - max(8.0, 0.35 * best)]
        near = [self._followed(c) if c.fault.motion and k < REFITS else c for k, c in enumerate(near)]
        near.sort(key=lambda cause: -cause.evidence)
        shown = [c for c in near if c.evidence > EVIDENCE and not (c.fault.positive and c.size < 0)
                 and abs(c.size) < LARGEST * c.fault.scale
                 and len(self.faults) * 2 * special.ndtr(-abs(c.size) / c.std) < ALARM]
        return tuple(c for c in shown if c.evidence > shown[0].evidence - max(TIED, ROUGH * shown[0].evidence))

    def _followed(self, cause: Cause) -> Cause:
        """The same fault with its size found beyond the derivative of its effect."""
        every, size = np.ones(len(self.data.blocks), dtype=bool), cause.size
        held, residual = self.present()
        start = _without(self.projected(held, residual, every), len(self.chosen))[-1, -1]
        for _ in range(2):
            trial = [*self.chosen, (cause.fault, size)]
            rows = [cause.fault.sensitivity(view, size)[:, :, None] for view in self.data.views]
            left = self.data.residual(self._effects(trial))
            table = _without(self.projected([*held, self.data.columns(rows)], left, every), len(self.chosen))
            step = float(np.clip(table[0, 1] / table[0, 0], -2 * abs(cause.size), 2 * abs(cause.size)))
            gain = start - (table[1, 1] - table[0, 1] ** 2 / table[0, 0])
            size += step
        information, prior = float(table[0, 0]), cause.fault.scale**2
        far = size**2 / (prior + 1 / information)  # of the likeliest size under the prior, Laplace's method
        evidence = 0.5 * (max(float(gain), 0.0) - far - np.log1p(prior * information))
        return replace(cause, size=size, std=information**-0.5, evidence=float(evidence))

    def add(self, cause: Cause) -> None:
        """Take a fault into account from now on."""
        self.chosen.append((cause.fault, cause.size))

    def settled(self) -> Search:
        """The same search about the parameters that follow with the chosen faults, whose sizes are found again."""
        data, every = self.data, np.ones(len(self.data.blocks), dtype=bool)
        held, residual = self.present()
        columns, p = [data.nuisances, *held], len(data.from_nominal)
        S = np.vstack([np.hstack([self._sum(one, other, every) for other in columns]) for one in columns])
        right = np.vstack([self._sum(one, residual, every) for one in columns])[:, 0]
        S[: len(data.prior), : len(data.prior)] += data.prior
        right[: len(data.prior)] += data.pull
        scale = np.append(data.scale, [fault.scale for fault, _ in self.chosen])
        shift = scale * (np.linalg.pinv(scale[:, None] * S * scale, rcond=1e-13, hermitian=True) @ (scale * right))
        sizes = shift[len(data.prior):]
        chosen = [(fault, size + float(more)) for (fault, size), more in zip(self.chosen, sizes, strict=True)]
        return Search(data.about(shift[:p], chosen), self.faults, chosen)

    def judged(self, causes: Sequence[tuple[Cause, ...]]) -> tuple[Cause, ...]:
        """The chosen faults with their sizes together, and whether each repeats in both halves."""
        held, residual = self.present()
        if not held:
            return ()
        halves = self.data.halves
        every = np.ones_like(halves, dtype=bool)
        (size, std), *parts = (self._joint(held, residual, use) for use in (every, halves == 0, halves == 1))
        made = []
        for k, tied in enumerate(causes):
            base = self.chosen[k][1]
            first, second = ((part[0][k] + base, part[1][k]) for part in parts)
            repeats = _repeats(first, second)
            made.append(Cause(tied[0].fault, float(base + size[k]), float(std[k]), tied[0].evidence, repeats,
                              tied[1:]))
        return tuple(made)

    def _joint(self, held: list[Columns], residual: Columns, blocks: Array) -> tuple[Array, Array]:
        if not np.any(blocks):
            return np.full(len(self.chosen), np.nan), np.full(len(self.chosen), np.inf)
        table = self.projected(held, residual, blocks)
        covariance = np.linalg.pinv(table[:-1, :-1], hermitian=True)
        return covariance @ table[:-1, -1], np.sqrt(np.maximum(np.diag(covariance), 0.0))

    def smallest(self) -> dict[Fault, float]:
        """Size of each fault that would have been shown with a probability of 95 %, if it were the only one."""
        held, residual = self.present()
        every = np.ones(len(self.data.blocks), dtype=bool)
        table = _without(self.projected([*held, self._columns], residual, every), len(self.chosen))
        needed = float(np.sqrt(2 * np.log(len(self.faults) / ALARM))) + 1.645
        return {fault: needed / float(np.sqrt(table[k, k])) if table[k, k] > 0 else np.inf
                for k, fault in enumerate(self.faults)}


def lack_of_fit(by_course: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Probability of each reading's residuals by those over each course."""
    return {name: min(1.0, len(COURSES) * min(p.values())) for name, p in by_course.items()}


def _of_noise(information: Array, score: Array) -> float:
    """Probability of a score (k,) of columns without effect, with its information (k, k)."""
    values, vectors = np.linalg.eigh(information)
    kept = values > 1e-4 * max(values[-1], 1e-300)
    statistic = float(np.sum((vectors[:, kept].T @ score) ** 2 / values[kept]))
    return float(special.chdtrc(np.sum(kept), statistic)) if kept.any() else 1.0


def _weighed(fault: Fault, size: float, statistic: float, information: float) -> Cause:
    prior = fault.scale**2
    evidence = 0.5 * statistic * prior / (prior + 1 / information) - 0.5 * float(np.log1p(prior * information))
    return Cause(fault, size, 1 / float(np.sqrt(information)), evidence, False)


def _without(table: Array, count: int) -> Array:
    """The table with its first columns projected out."""
    if not count:
        return table
    inner = np.linalg.pinv(table[:count, :count], hermitian=True)
    return np.asarray(table[count:, count:] - table[count:, :count] @ inner @ table[:count, count:])


def _repeats(first: tuple[float, float], second: tuple[float, float]) -> bool:
    """Whether two halves show the same size, each given with its standard deviation."""
    (a, std_a), (b, std_b) = first, second
    if not (np.isfinite(std_a) and np.isfinite(std_b)) or a * b <= 0:
        return False
    close = abs(a - b) <= AGREE * abs(a + b) / 2 + 2 * np.hypot(std_a, std_b)
    return bool(close and min(abs(a) / std_a, abs(b) / std_b) > SEEN)


def examine_fit(data: Data) -> Misfit:
    """Test the residuals of a problem's data, and look for faults that explain them."""
    view = data.views[0]
    search = Search(data, list(listed(view)))
    by_course = search.by_course()
    before = lack_of_fit(by_course)
    follows = {name: min(p, key=lambda over: p[over]) for name, p in by_course.items()}
    smallest = search.smallest()
    steps: list[tuple[Cause, ...]] = []
    while len(steps) < MOST and (shown := search.step()):
        search.add(shown[0])
        steps.append(shown)
        search = search.settled()
    found, after = search.judged(steps), search.lack_of_fit() if steps else before
    while len(steps) > 1 and not all(cause.repeats for cause in found):  # one may be part of another
        least = min((k for k, cause in enumerate(found) if not cause.repeats),
                    key=lambda k: abs(found[k].size) / found[k].std)
        del steps[least], search.chosen[least]
        search = search.settled()
        found, after = search.judged(steps), search.lack_of_fit()
    ratio = np.mean([one.noise / one.stated_noise for one in data.views], axis=0)
    spikes = np.mean([one.spike_share for one in data.views], axis=0)
    excess = np.mean([one.excess for one in data.views], axis=0)

    def by_name(values: Array) -> dict[str, float]:
        return dict(zip(view.names, values.tolist(), strict=True))

    return Misfit(before, after, found, smallest, by_name(ratio), by_name(spikes),
                  {name: line for one in data.views for name, line in lines(one)}, follows, by_name(excess),
                  {name: fast for one in data.views for name, fast in faster(one)})
