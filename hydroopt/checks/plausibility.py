"""Whether a log can be of a machine: the likeliest mistake in its units, signs, channels or clock, before any fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from hydroopt.checks.agreement import MARGIN, SAMPLES, Agreement, Evaluated, agreement, stated_rate
from hydroopt.checks.alternatives import Alternative, alternatives
from hydroopt.checks.sensors import beyond_relief, held_sensors, scattering, stuck_sensors
from hydroopt.errors import HydrooptError, LogError
from hydroopt.logs.calibrator_angles import calibrator_channels
from hydroopt.logs.channels import is_force
from hydroopt.logs.joint_angles import angle_channels
from hydroopt.logs.log import Log
from hydroopt.model.model import Model
from hydroopt.results.diagnostic import Diagnostic, Meaning, of_kind

LOG_MISREAD = "log misread"
"""Kind of the diagnostic of a log that another reading brings into agreement with the machine file."""
BETTER, LOWER = 0.5, 100.0
"""The best alternative reading must have at most this part of the score, or of an actuator's squares, and be lower by
so much."""
MISSED = 0.25
"""By how much of the forces another reading may miss the nominal ones more than the log as read."""
REFUTED = 0.8
"""Nominal error of an actuator, as a part of its measured forces, from which on a reading does not agree well."""
IMPOSSIBLE = 4.0
"""Nominal error of an actuator, as a multiple of its measured forces, that no machine file has in a sound log."""
FEW, CLEARLY = 2.0, 0.75
"""Reversals of a joint, on average, below which a log is short; and the part of an actuator's nominal error that
another reading must leave there at most, if forces alone speak for it."""
MODEST = 150.0
"""Factor between units of pressures up to which nominal forces, too, must speak for it."""
TIED = 10.0
"""Alternatives whose scores differ by less are named together."""
MISTAKES = 3
"""How many mistakes of one log are looked for, one after the other."""
BEYOND = 0.02
"""Share of samples beyond a joint's limits that is worth a diagnostic."""
FAR = 4.0
"""Standard deviations of geometry and sensor by which a length must differ from the geometry on average."""
OTHER_RATE = 1.5
"""Ratio of the sampling rate to the stated one that is worth a diagnostic."""


def examine(model: Model, log: Log) -> tuple[Diagnostic, ...]:
    """What contradicts the machine file in a log as it is read, with the reading that would agree, if there is one.

    Nothing is corrected. A mistake is named only if the log read otherwise agrees far better: with less than half of
    the score and at least 100 lower, where the score is minus two log likelihoods of forces under the machine file's
    priors, and terms for force levels, lengths against angles, joint ranges and the sampling rate. Readings that agree
    equally well are named together, and none where a sensor is stuck, which no other reading mends. A log recorded with
    the calibrator attached is not judged: its forces are not those of the machine alone.

    Args:
        model: the machine.
        log: of which a sample is examined, if it is long.

    >>> from dataclasses import replace
    >>> from hydroopt.machine.machine_file import load_machine
    >>> from hydroopt.simulation.simulate import random_trajectory, simulate
    >>> model = Model(load_machine("cat215b"))
    >>> log = simulate(model, random_trajectory(model, duration=10.0, rate=25.0, seed=1), seed=1)
    >>> examine(model, log)
    ()
    >>> flipped = replace(log, channels={**log.channels, "boom.q": -log.channels["boom.q"]})
    >>> [(found.kind, found.subject) for found in examine(model, flipped)]
    [('log misread', ('boom.q',))]
    """
    if calibrator_channels(model.machine, log):
        return ()
    held = log.sampled(angle_channels(model, log))
    where = log.path or log.name
    repeated = held_sensors(model.machine, held, where) if held is log else ()
    stuck = (*stuck_sensors(model.machine, held, where), *repeated)
    mistakes, corrected = ([], held) if stuck else _mistakes(model, held)
    contradicted = (misread(channels, {"log": where, **evidence}) for channels, evidence in mistakes)
    return *stuck, *contradicted, *_contradictions(model, corrected, where)


def misread(channels: Sequence[str], evidence: Mapping[str, object]) -> Diagnostic:
    """A log with a mistake that refutes it; the evidence holds ``log``, ``reading``, ``agrees``, ``read_so``,
    ``as_read``."""
    return Diagnostic.of(LOG_MISREAD, channels, evidence, (
        "Read with {reading}, {log} {agrees} with the machine file: {read_so}. As it is read, it contradicts the "
        "machine file: {as_read}."),
        "Correct unit, sign or column of {subject} in the file or its map; nothing was changed here.",
        Meaning.REFUTATION)


def misread_error(model: Model, log: Log) -> LogError | None:
    """The likeliest mistake in a log's units, signs, channels or clock as an error; None where none is found."""
    try:
        found = of_kind(examine(model, log), LOG_MISREAD)
    except HydrooptError:
        return None
    return LogError(contradiction(found[0]), where=log.path or log.name, remedy=remedy_of(found[0])) if found else None


def contradiction(misread: Diagnostic) -> str:
    """A log's likeliest mistake as what an error says."""
    return f"the machine file agrees with {misread.evidence['reading']}, not with the log as it is read"


def remedy_of(misread: Diagnostic) -> str:
    """Its remedy as the end of an error's sentence."""
    return misread.remedy[0].lower() + misread.remedy[1:].rstrip(".")


def _mistakes(model: Model, log: Log) -> tuple[list[tuple[tuple[str, ...], dict[str, object]]], Log]:
    """Channels and evidence of each mistake, and the log with all of them corrected."""
    found: list[tuple[tuple[str, ...], dict[str, object]]] = []
    evaluated: Evaluated = {}
    now = agreement(model, log, evaluated)
    for _ in range(MISTAKES):
        if now is not None and now.score <= LOWER:
            break
        scored = _scored(model, log, now, evaluated)
        if not scored:
            break
        least, (best, agreed) = scored[0][0], scored[0][1:]
        tied = [other for score, other, _ in scored if abs(score - least) < TIED]
        channels = tuple(dict.fromkeys(name for one in tied for name in one.channels))
        well = agreed.score <= LOWER or agreed.worst < REFUTED
        found.append((channels, {
            "reading": " or ".join(one.words for one in tied), "read_so": agreed.words(now or agreed),
            "agrees": "agrees" if well else "agrees better, though not well,",
            "as_read": now.words(agreed) if now else "no posture fits",
            "score_as_read": now.score if now else None, "score_read_so": least}))
        log, now = best.of(log), agreed
    return found, log


def _scored(model: Model, log: Log, now: Agreement | None,
            evaluated: Evaluated) -> list[tuple[float, Alternative, Agreement]]:
    """Alternatives that agree far better than the log as read, the best first."""
    loud = {name for each in scattering(model.machine, log, log.name) if each.evidence["reading"]
            for name in each.subject}  # a unit that explains a column's scatter needs no other mistake beside it
    tried = (one for one in alternatives(model, log) if not loud or set(one.channels) <= loud)
    results = [(made.score, one, made) for one in tried
               if (made := agreement(model, one.of(log), evaluated)) is not None
               and (now is None or (_far_better(made, now) and not _far_better(now, made)
                                    and (now.reversals >= FEW or _seen(made, now)) and _worse_in_nothing(made, now)
                                    and (not _modest(one) or _forces_agree(made, now))))]
    return sorted(results, key=lambda each: (each[2].refuted > IMPOSSIBLE, each[0]))


def _far_better(made: Agreement, now: Agreement) -> bool:
    """Whether another reading agrees far better in all, or with one actuator if what is left is the model's error.

    Nominal forces far above those measured refute a reading where the machine file's priors do not explain it.
    """
    if (made.refuted > IMPOSSIBLE) != (now.refuted > IMPOSSIBLE):
        return now.refuted > IMPOSSIBLE
    if made.score <= min(BETTER * now.score, now.score - LOWER):
        return True
    error = np.maximum(made.squares / SAMPLES, 1.0)
    others = (made.score - np.sum(made.squares)) - (now.score - np.sum(now.squares))
    return bool(np.sum((made.squares - now.squares) / error) + others <= -LOWER and made.score < now.score
                and np.any(made.squares <= BETTER * now.squares))


def _seen(made: Agreement, now: Agreement) -> bool:
    """Whether nominal forces of some actuator agree clearly better, or lengths, ranges, levels or rates do.

    Where the model misses as much either way, such as friction that it lacks in a short log, squares of residuals
    decide by chance.
    """
    beside = now.levels + now.lengths + now.ranges + now.rate - made.levels - made.lengths - made.ranges - made.rate
    return _clearer(made, now) or beside >= LOWER


def _clearer(made: Agreement, now: Agreement) -> bool:
    """Whether nominal forces of some actuator agree clearly better."""
    return any(made.missed[name] < CLEARLY * missed for name, missed in now.missed.items())


def _modest(one: Alternative) -> bool:
    """Whether another reading makes pressures so many times larger or smaller that a fault of the model may look so."""
    return one.factor is not None and is_force(one.channels[0]) and 1 / MODEST <= one.factor <= MODEST


def _forces_agree(made: Agreement, now: Agreement) -> bool:
    """Whether nominal forces of some actuator agree clearly better, and those of none clearly worse."""
    return _clearer(made, now) and all(made.missed[name] <= missed + MISSED for name, missed in now.missed.items())


def _worse_in_nothing(made: Agreement, now: Agreement) -> bool:
    """Whether another reading contradicts neither joint limits nor nominal forces more than the log as read.

    A wrong reading can have the better score where the priors are wide: the sum of all terms alone is no evidence.
    """
    return made.outside <= max(now.outside, BEYOND) and made.worst <= now.worst + MISSED


def _contradictions(model: Model, log: Log, where: str) -> Iterator[Diagnostic]:
    """What no other reading explains: joint limits, lengths and rates that are not as stated."""
    machine = model.machine
    for joint in machine.joints:
        if f"{joint}.q" not in log.channels:
            continue
        q, (low, high) = log.channels[f"{joint}.q"], machine.link(joint).joint.range
        slack = MARGIN * (high - low)
        share = float(np.mean((q < low - slack) | (q > high + slack)))
        if share > BEYOND:
            yield Diagnostic.of("beyond joint limits", (f"{joint}.q",), {
                "log": where, "share": share, "low": float(np.min(q)), "high": float(np.max(q)), "lower": low,
                "upper": high, "unit": machine.channel_units[f"{joint}.q"]},
                "In {log}, {share:.0f %} of {subject} lie beyond the joint's limits: {low:.3g} to {high:.3g} {unit} "
                "against {lower:.3g} to {upper:.3g} {unit}.",
                "Correct the sensor's zero, its unit, or the limits in the machine file.", Meaning.CONTRADICTION)
    yield from _lengths(model, log, where)
    yield from scattering(machine, log, where)
    yield from beyond_relief(machine, log, where)
    low, high = stated_rate(machine.sensors, set(log.channels))
    hertz = 1 / float(np.median(np.diff(log.t)))
    if not low / 20 <= hertz <= OTHER_RATE * high:  # a log may keep only some of its sensors' samples
        yield Diagnostic.of("other sampling rate", (), {"log": where, "rate": hertz, "stated": high}, (
            "{log} is sampled at {rate:.3g} Hz, where the machine file states {stated:.3g} Hz."),
            "Correct the unit of time in the file or its map, or the rate of the sensors.", Meaning.CONTRADICTION)


def _lengths(model: Model, log: Log, where: str) -> Iterator[Diagnostic]:
    machine = model.machine
    if not all(f"{joint}.q" in log.channels for joint in machine.joints):
        return
    few = np.unique(np.linspace(0, log.size - 1, 90).astype(int))
    q = np.column_stack([log.channels[f"{joint}.q"][few] for joint in machine.joints])
    expected = model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)[0][:, :, 0]
    for k, cylinder in enumerate(machine.cylinders):
        name = f"{cylinder.name}.length"
        if name not in log.channels:
            continue
        pins = [machine.notes.get(f"{cylinder.name}.{end}.pin") for end in ("barrel", "rod")]
        stated = [note.sigma for note in pins if note is not None and note.sigma is not None and not note.relative]
        sensor = machine.sensor(name)
        sigma = np.sqrt(max(sum(2 * s**2 for s in stated), (0.01 * cylinder.stroke) ** 2)
                        + (sensor.std if sensor else 0.0) ** 2)
        gap = float(np.mean(log.channels[name][few] - expected[:, k]))
        if abs(gap) > FAR * sigma:
            yield Diagnostic.of("length contradicts angle", (name,), {
                "log": where, "gap_mm": 1e3 * gap, "sigma_mm": 1e3 * float(sigma)},
                "In {log}, {subject} differs by {gap_mm:.0f} mm from what the joint angle and the pins give, where "
                "{sigma_mm:.0f} mm are one standard deviation.",
                "Correct the transducer's zero, the angle's zero, or pins and dead length in the machine file.",
                Meaning.CONTRADICTION)
