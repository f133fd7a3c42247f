"""What a test of fit finds: hypotheses that the data show, residuals beyond noise, spikes and oscillations."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hydroopt.estimation.dynamic.misfit.hypotheses import Fault, listed
from hydroopt.estimation.dynamic.misfit.readings import ForceReadings
from hydroopt.estimation.dynamic.misfit.view import UNKNOWN, View
from hydroopt.estimation.inference.hypotheses import RANGE, Found, name
from hydroopt.results.tables import number
from hydroopt.spatial.inertia import Array

LARGE = 1.5
"""Residuals as a multiple of what noise and errors of the motion add, from which on they are worth a note."""
SLOWEST_LINE, CLEAR = 3.0, 1e-6
"""Oscillations are looked for above this frequency [Hz]; probability below which one is no noise."""
FEW = 64
"""Samples of a stretch that a spectrum needs."""


class Line(NamedTuple):
    """An oscillation in a reading's residuals: frequency [Hz], amplitude and its unit."""

    hertz: float
    amplitude: float
    unit: str


@dataclass(frozen=True, eq=False)
class Misfit:
    """What a test of fit found.

    Attributes:
        found: hypotheses that the data show, the likeliest first.
        smallest: by hypothesis, the size [SI] that this log would have shown with a probability of 95 %.
        excess: by reading, RMS of what the hypotheses found leave as a multiple of what noise and errors of the motion
            add, and the frequency [Hz] about which most of it stands.
        noise: ratio of each reading's white noise to what its sensors state; NaN where nothing is stated.
        spikes: share of each reading's samples that are far off their neighbours.
        lines: oscillations by reading, faster than the motion.
    """

    found: tuple[Found[Fault], ...]
    smallest: Mapping[Fault, float]
    excess: Mapping[str, tuple[float, float]]
    noise: Mapping[str, float]
    spikes: Mapping[str, float]
    lines: Mapping[str, Line]

    @property
    def unexplained(self) -> dict[str, tuple[float, float]]:
        """Readings with residuals that nothing explains, the largest first, as of `excess`."""
        return {name: one for name, one in sorted(self.excess.items(), key=lambda item: -item[1][0]) if one[0] > LARGE}

    def widening(self, sums: Array) -> Array:
        """What effects that the model lacks shift sums (m, p) of the parameters by (m,): their intervals contain it."""
        shifts = [sums @ each.shift[: sums.shape[1]] for each in self.found if each.hypothesis.lack]
        return np.asarray(np.sqrt(sum((shift**2 for shift in shifts), start=np.zeros(len(sums)))))

    @property
    def shown(self) -> dict[str, tuple[float, float, str]]:
        """By group of hypotheses: the least and the largest of `smallest` over it, as printed, and the unit."""
        sizes: dict[str, list[tuple[float, str]]] = {}
        for fault, size in self.smallest.items():
            if size < RANGE * fault.scale:
                sizes.setdefault(fault.group, []).append((size * fault.factor, fault.unit))
        return {group: (min(each)[0], max(each)[0], each[0][1]) for group, each in sizes.items()
                if len({unit for _, unit in each}) == 1}

    def as_dict(self) -> dict[str, Any]:
        """The entry of a JSON file; sizes as printed, in the unit of each hypothesis."""
        smallest = [{"fault": fault.name, "words": fault.words, "unit": fault.unit,
                     "would_have_shown": number(size * fault.factor)} for fault, size in self.smallest.items()]
        return {"residuals_over_noise": {name: {"ratio": number(ratio), "hertz": number(hertz)}
                                         for name, (ratio, hertz) in self.excess.items()},
                "noise_ratio": {name: number(ratio) for name, ratio in self.noise.items()},
                "spikes": dict(self.spikes), "causes": [_as_dict(one) for one in self.found], "faults": smallest}


def _as_dict(found: Found[Fault]) -> dict[str, Any]:
    fault = found.hypothesis
    return {"fault": fault.name, "words": fault.words, "unit": fault.unit, "size": number(found.size * fault.factor),
            "std": number(found.std * fault.factor), "ci95": [number(end * fault.factor) for end in found.ci95],
            "evidence": number(found.evidence), "agreement": number(found.agreement),
            "not_separable_from": [other.hypothesis.name for other in found.rivals]}


def examine_fit(data: ForceReadings) -> Misfit:
    """Look for hypotheses that explain the residuals of a problem's data."""
    candidates = list(listed(data.views[0]))
    found = name(data, candidates)
    sound, columns = data.model([]), data.columns(candidates, [])
    after = data.model([(each.hypothesis, each.amount) for each in found])

    def by_name(values: list[np.ndarray]) -> dict[str, float]:
        return dict(zip(data.names, np.mean(values, axis=0).tolist(), strict=True))

    return Misfit(found, dict(zip(candidates, sound.smallest(candidates, columns), strict=True)), data.excess(after),
                  by_name([one.noise / one.stated_noise for one in data.views]),
                  by_name([one.spike_share for one in data.views]),
                  {name: line for one in data.views for name, line in lines(one)})


def lines(view: View) -> Iterator[tuple[str, Line]]:
    """Frequencies that stand out of the residuals' spectrum (Fisher's test) in the longest stretch, faster than the
    motion."""
    units, motion = (*view.model.force_units, *["m"] * len(view.lengths)), view.motion
    longest = int(np.argmax(np.bincount(motion.segment - motion.segment[0]))) + motion.segment[0]
    at = np.flatnonzero((motion.segment == longest) & motion.interior)
    if at.size < FEW:
        return
    hertz = np.fft.rfftfreq(at.size, float(np.median(np.diff(motion.t[at]))))
    fast = hertz > max(SLOWEST_LINE, 2 * float(np.max(motion.bandwidth)))
    for k in np.flatnonzero(view.read).tolist() if np.sum(fast) >= 16 else ():
        taken = view.taken[at, k]
        r = np.where(taken, view.residual[at, k], 0.0)
        power = np.abs(np.fft.rfft(r - r.mean()))[fast] ** 2
        top = int(np.argmax(power))
        excess = power[top] * np.log(2) / max(float(np.median(power)), 1e-300)
        amplitude = float(2 * np.sqrt(power[top]) / max(int(np.sum(taken)), 1))
        # of so many exponentially distributed powers
        if excess > np.log(np.sum(fast) / CLEAR) and amplitude > UNKNOWN * view.of_motion[k]:
            yield view.names[k], Line(float(hertz[fast][top]), amplitude, units[k])
