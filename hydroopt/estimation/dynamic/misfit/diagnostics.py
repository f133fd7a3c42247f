"""What a test of fit found, as typed diagnostics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

from hydroopt.estimation.dynamic.misfit.faults import Fault
from hydroopt.estimation.dynamic.misfit.freed import Freed
from hydroopt.estimation.dynamic.misfit.naming import Misfit
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.results.diagnostic import Diagnostic, Meaning, listed, probability
from hydroopt.results.tables import number

LARGE = 2.0
"""Residuals as a multiple of what noise and errors of the motion add, from which on those that are faster than
smoothing passes are worth a diagnostic, though the slow ones may be by chance."""
SPIKES, STEPS = 0.003, 0.1
"""Share of spikes among a reading's samples that is worth a diagnostic, and that of any reading from which on they are
none: residuals are large for whole stretches then, as after steps of valves, and to interpolate would take the motion
away."""


def diagnose(found: Misfit, uncertain: Mapping[str, Sequence[str]] = MappingProxyType({})) -> Iterator[Diagnostic]:
    """Causes that may be named, or else readings that nothing listed explains; spikes and lines.

    Args:
        found: the test.
        uncertain: parts whose geometry the machine file leaves uncertain, by the channel to whose offset it is alike.
    """
    for cause in found.causes:
        fault = cause.fault
        words, amount = fault.said(cause.size)
        tied = [other.fault.said(other.size)[0] for other in cause.tied if other.fault.words != fault.words]
        yield Diagnostic.of("likeliest cause of the misfit", fault.subject, {
            "cause": words, "fault": fault.name, "amount": amount * fault.factor,
            "remedy": _remedy(fault) + _alike(uncertain, [fault, *(other.fault for other in cause.tied)]),
            "size": cause.size * fault.factor, "std": cause.std * fault.factor, "unit": fault.unit,
            "evidence": cause.evidence, "tied": [other.fault.name for other in cause.tied],
            "others": f"; these data do not tell it from: {listed(tied, 3)}" if tied else ""},
            "The likeliest cause of the misfit: {cause}, by {amount:.3g} ± {std:.2g} {unit}{others}. Both halves of "
            "the data show it alike, and it leaves no misfit.",
            "{remedy}", Meaning.CONTRADICTION)
    if not found.causes:
        yield from _unexplained(found)
    spiked = {name: share for name, share in found.spikes.items() if share > SPIKES}
    # a cause moves the steps of friction, which then look like spikes
    if not found.causes and 0 < max(spiked.values(), default=0.0) < STEPS:
        yield Diagnostic.of("spikes", tuple(spiked), {"share": max(spiked.values())}, (
            "Up to {share:.2g %} of the readings of {subject} are far off their neighbours."),
            "Use --treat spike=interpolate or --loss huber.")
    for name, line in found.lines.items():
        yield Diagnostic.of("line in the spectrum", (name,), {
            "hz": line.hertz, "amplitude": line.amplitude, "unit": line.unit},
            "The residuals of {subject} oscillate at {hz:.3g} Hz with an amplitude of {amplitude:.3g} {unit}.",
            "Look for pulsation of the pump or a vibration of the machine.")


def _unexplained(found: Misfit) -> Iterator[Diagnostic]:
    """Readings whose residuals nothing explains, the least likely first: those faster than smoothing passes apart."""
    fast = [name for name in found.fast if name in found.alarmed or found.excess[name] > LARGE]
    for name in sorted(fast, key=lambda name: -found.excess[name]):
        yield Diagnostic.of("residuals faster than smoothing passes", (name,), {
            "ratio": found.excess[name], **found.fast[name]._asdict()},
            "{part:.0f %} of the residuals of {subject}, {ratio:.3g} times as large as noise explains, are faster "
            "than the {bandwidth:.2g} Hz that smoothing passes, most at {hertz:.2g} Hz: motion that smoothing takes "
            "away, as after steps of valves, or a fast effect that the model lacks.",
            "Drive smoother, without steps of the valves; or let faster motion pass (--bandwidth, or bandwidth in the "
            "machine file) where angles are exact enough.", Meaning.CONTRADICTION)
    slow = sorted(set(found.alarmed) - set(fast), key=lambda name: (found.before[name], -found.excess[name]))
    if slow:
        first, *others = slow
        yield Diagnostic.of("lack of fit", tuple(slow), {
            "worst": first, "course": _COURSES[found.follows[first]], "ratio": found.excess[first],
            "probability": found.before[first], "said": probability(found.before[first]),
            "others": f"; those of {listed(others)}, too" if others else ""},
            "The residuals of {worst} {course}, {ratio:.3g} times as large as noise and smoothing explain "
            "({said}){others}. The model lacks something that is not in the list of faults, or several faults at once.",
            "Intervals hold only as far as the model does: see the figure of the residuals.", Meaning.CONTRADICTION)


_COURSES = {"time": "wander over the log, as where a sensor's errors have a memory",
            "position": "depend on the position of its joint", "speed": "depend on its speed"}
"""What residuals do that are not like noise over one of the courses."""


def _remedy(fault: Fault) -> str:
    if not fault.free:
        return "Correct these bodies in the machine file, or state a larger sigma of their numbers."
    word = fault.group if fault.subject == ("forces",) else fault.name
    return f"Correct it in the log or the machine file, or estimate it along: --free '{word}'."


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


def detectable(found: Misfit) -> Diagnostic | None:
    """The smallest faults that would have shown, group by group: silence about smaller ones means nothing."""
    said = [f"{group} {_two(low)} {unit}" if high < 1.2 * low else f"{group} {_two(low)} to {_two(high)} {unit}"
            for group, (low, high, unit) in found.shown.items()]
    return Diagnostic.of("smallest faults that would show", (), {"sizes": ", ".join(said)}, (
        "Faults of these sizes would have shown with a probability of 95 %: {sizes}.")) if said else None


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
