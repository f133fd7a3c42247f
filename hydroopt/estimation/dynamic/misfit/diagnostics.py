"""What a test of fit found, as typed diagnostics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from hydroopt.estimation.dynamic.misfit.freed import Freed
from hydroopt.estimation.dynamic.misfit.hypotheses import Fault
from hydroopt.estimation.dynamic.misfit.naming import Misfit
from hydroopt.estimation.inference.hypotheses import MATERIAL
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.results.diagnostic import Diagnostic, Meaning, listed
from hydroopt.results.tables import number
from hydroopt.spatial.inertia import Array

SPIKES, STEPS = 0.003, 0.1
"""Share of spikes among a reading's samples that is worth a diagnostic, and that of any reading from which on they are
none: residuals are large for whole stretches then, as after steps of valves, and to interpolate would take the motion
away."""


def diagnose(found: Misfit, sums: Array, width: Array,
             uncertain: Mapping[str, Sequence[str]] = MappingProxyType({})) -> Iterator[Diagnostic]:
    """Causes, which contradict where they are material; readings that nothing explains; spikes and lines.

    Args:
        found: the test.
        sums, width: (m, p) sums of the parameters that are stated, and half widths (m,) of their 95 % intervals.
        uncertain: parts whose geometry the machine file leaves uncertain, by the channel to whose offset it is alike.
    """
    for cause in found.found:
        fault = cause.hypothesis
        words, amount = fault.said(cause.size)
        rivals = [other.hypothesis for other in cause.rivals]
        tied = [other.hypothesis.sentence(other.amount) for other in cause.rivals]
        known = np.isfinite(width) & (width > 0)
        moved = cause.moves(np.pad(sums[known], ((0, 0), (0, len(cause.shift) - sums.shape[1]))), width[known])
        material = not fault.lack and (moved > MATERIAL or not np.any(known))
        yield Diagnostic.of("likeliest cause of the misfit", fault.subject, {
            "cause": words, "fault": fault.name, "amount": amount * fault.factor,
            "remedy": fault.remedy + _alike(uncertain, [fault, *rivals]),
            "size": cause.size * fault.factor, "std": cause.std * fault.factor, "unit": fault.unit,
            "evidence": cause.evidence, "moves": number(moved), "tied": [other.name for other in rivals],
            "others": f"; not distinguished from: {listed(list(dict.fromkeys(tied)), 3)}" if tied else "",
            "moved": "Intervals contain what it moves" if fault.lack else
                     "It moves parameters by more than is stated of them" if material else
                     "Parameters stay within what is stated of them"},
            "The likeliest cause of the misfit: {cause}, by {amount:.3g} ± {std:.2g} {unit}{others}. {moved}.",
            "{remedy}", Meaning.CONTRADICTION if material else Meaning.NOTE)
    if left := found.unexplained:
        first, *others = left
        yield Diagnostic.of("lack of fit", tuple(left), {
            "worst": first, "ratio": left[first][0], "hertz": left[first][1],
            "others": f"; those of {listed(others)}, too" if others else ""},
            "The residuals of {worst} are {ratio:.3g} times as large as noise and smoothing explain, mostly at about "
            "{hertz:.2g} Hz{others}: the model lacks something that no hypothesis names. Intervals and bounds contain "
            "it.", "See the figure of the residuals.")
    spiked = {name: share for name, share in found.spikes.items() if share > SPIKES}
    # a cause moves the steps of friction, which then look like spikes
    if not found.found and 0 < max(spiked.values(), default=0.0) < STEPS:
        yield Diagnostic.of("spikes", tuple(spiked), {"share": max(spiked.values())}, (
            "Up to {share:.2g %} of the readings of {subject} are far off their neighbours."),
            "Use --treat spike=interpolate or --loss huber.")
    for name, line in found.lines.items():
        yield Diagnostic.of("line in the spectrum", (name,), {
            "hz": line.hertz, "amplitude": line.amplitude, "unit": line.unit},
            "The residuals of {subject} oscillate at {hz:.3g} Hz with an amplitude of {amplitude:.3g} {unit}.",
            "Look for pulsation of the pump or a vibration of the machine.")


def _alike(uncertain: Mapping[str, Sequence[str]], faults: Sequence[Fault]) -> str:
    """That wrong pins and zeros of joints look like offsets of angles, where the machine file does not know them."""
    parts = [part for fault in faults if fault.group == "offset" for part in uncertain.get(fault.subject[0], ())]
    if not parts:
        return ""
    return (f" Wrong pins and zeros look alike, and the machine file leaves those of {listed(parts)} uncertain: "
            "calibrate them from poses first, or by --with-geometry from cylinders' lengths in the log.")


def uncertain_geometry(machine: Machine) -> dict[str, list[str]]:
    """Links and cylinders of whose zeros, lengths and pins the machine file states a confidence, by the channel of the
    joint that they turn, where they look like an offset."""
    stated = {number.name.partition(".")[0] for number in machine.geometry_numbers
              if not number.name.endswith(".dead_length") and machine.notes.get(number.path, Note()).sigma}
    return {f"{joint}.q": [part for part in (joint, *(each.name for each in machine.cylinders
                                                      if joint in machine.moved_by(each))) if part in stated]
            for joint in machine.joints}


def detectable(found: Misfit) -> Iterator[Diagnostic]:
    """The smallest faults that would have shown, group by group: silence about smaller ones means nothing."""
    said = [f"{group} {_two(low)} {unit}" if high < 1.2 * low else f"{group} {_two(low)} to {_two(high)} {unit}"
            for group, (low, high, unit) in found.shown.items()]
    if said:
        yield Diagnostic.of("smallest faults that would show", (), {"sizes": ", ".join(said)}, (
            "Faults of these sizes would have shown with a probability of 95 %: {sizes}."), meaning=Meaning.PROPERTY)


def freed_faults(freed: Freed) -> Iterator[Diagnostic]:
    """The sizes of freed faults."""
    for k, fault in enumerate(freed.faults):
        words, amount = fault.said(float(freed.size[k]))
        yield Diagnostic.of("freed fault", fault.subject, {
            "cause": words, "amount": amount * fault.factor, "group": fault.group,
            "size": float(freed.size[k] * fault.factor),
            "std": number(float(freed.covariance[k, k]) ** 0.5 * fault.factor), "unit": fault.unit},
            "Freed: {cause}, by {amount:.3g} ± {std:.2g} {unit}.")


def _two(size: float) -> str:
    """A size to two digits, without an exponent."""
    return f"{float(f'{size:.2g}'):.15g}"
