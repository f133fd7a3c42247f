"""Logs misread in one way: is the mistake named before the fit, with and without lengths, and is no sound log accused?

Simulated machines differ from their files as these admit, and every log has a motion and noise of its own. The same
mistakes are made in measured logs.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from hydroopt import Log, Model, load_machine, random_trajectory, random_truth, read_log, simulate
from hydroopt.checks.plausibility import examine
from hydroopt.machine.actuators import Drive
from hydroopt.results.diagnostic import of_kind
from studies.patu_actuator.run import DATA as PATU
from studies.patu_actuator.run import HERE as PATU_MAP
from studies.show import table
from studies.ur10e_mamedov import run as ur10e

MACHINES = {"cat215b": 50.0, "patu655_lift": 100.0, "kr300": 250.0, "ur10e": 125.0}
"""Rates [Hz] of the logs."""
SEEDS = range(1000, 1003)
SOUND = range(2000, 2075)
"""Seeds of logs without a mistake."""
SECONDS = 16.0
OUTCOMES = ("named", "named with others", "wrong", "silent")
NAMED = OUTCOMES[:2]
ROOT = Path(__file__).parents[2]


def run() -> dict:
    """Shares of mistakes that are named first, alone or with what looks the same; of sound logs that are accused."""
    outcomes: dict[tuple[str, str], list[str]] = {}
    false_alarms = []
    for name, rate in MACHINES.items():
        model = Model(load_machine(name))
        false_alarms += [bool(examine(model, log_of(model, seed, rate))) for seed in SOUND]
        for seed in SEEDS:
            add(outcomes, name, model, log_of(model, seed, rate))
    for title, machine, log in measured():
        model = Model(load_machine(machine))
        false_alarms.append(bool(of_kind(examine(model, log), "log misread")))
        add(outcomes, title, model, log)
    counts = {key: [found.count(one) for one in OUTCOMES] for key, found in outcomes.items()}
    table("Mistakes", ["log of", "mistake", *OUTCOMES], [[*key, *count] for key, count in counts.items()])
    everything = [(title, one) for (title, _), found in outcomes.items() for one in found]
    results: dict = {"mistakes": len(everything), "sound_logs": len(false_alarms),
                     "false_alarms": round(float(np.mean(false_alarms)), 4)}
    for real in (False, True):
        some = [one for title, one in everything if (title not in MACHINES) == real]
        results |= {f"{'measured' if real else 'simulated'}_{what.replace(' ', '_')}": round(some.count(what)
                    / len(some), 4) for what in OUTCOMES}
    for title in dict.fromkeys(title for title, _ in everything):
        some = [one in NAMED for other, one in everything if other == title]
        results[f"named_{title.replace(' ', '_')}"] = round(float(np.mean(some)), 4)
    return results


def measured() -> Iterator[tuple[str, str, Log]]:
    """Measured logs that are at hand: title, machine, log."""
    yield "KR300 run A", "kr300", read_log(ROOT / "data/kr300/run_A.mat", mapping=ROOT / "data/kr300/map.toml")
    if PATU.exists():
        yield "PATU lift", "patu655_lift", read_log(PATU, mapping=PATU_MAP / "map.toml")
    if ur10e.DATA.exists():
        for log in (ur10e.LEARNT, ur10e.UNSEEN):
            yield f"UR10e {log[0].partition('/')[0]}", "ur10e", ur10e.log(*log)


def add(outcomes: dict[tuple[str, str], list[str]], title: str, model: Model, log: Log) -> None:
    """Make every mistake in a log, and note what is said of it."""
    for kind, spoilt, meant in mistakes(model, log):
        outcomes.setdefault((title, kind), []).append(outcome(model, spoilt, meant))


def log_of(model: Model, seed: int, rate: float) -> Log:
    """A log of a machine drawn from the file's confidences."""
    motion = random_trajectory(model, duration=SECONDS, rate=rate, seed=3 * seed)
    return simulate(model, motion, random_truth(model, 3 * seed + 1), seed=3 * seed + 2)


def outcome(model: Model, spoilt: Log, meant: Log) -> str:
    """What is said of a spoilt log: its mistake alone, with others that look the same, another one, or nothing."""
    found = of_kind(examine(model, spoilt), "log misread")
    if not found:
        return "silent"
    wrong = {name for name in spoilt.channels if not np.array_equal(spoilt.channels[name], meant.channels[name])}
    wrong |= set() if np.array_equal(spoilt.t, meant.t) else {"t"}
    subjects = set().union(*(one.subject for one in found))
    if subjects == wrong:
        return "named"
    return "named with others" if wrong <= subjects and " or " in str(found[0].evidence["reading"]) else "wrong"


def mistakes(model: Model, log: Log) -> Iterator[tuple[str, Log, Log]]:
    """Every mistake that the log's channels allow: its kind, the log with it, and without it."""
    lengths = [name for name in log.channels if name.endswith(".length")]
    yield from _mistakes(model, log)
    if lengths:
        bare = replace(log, channels={name: x for name, x in log.channels.items() if name not in lengths})
        yield from ((f"{kind}, no lengths", spoilt, meant) for kind, spoilt, meant in _mistakes(model, bare))


def _mistakes(model: Model, log: Log) -> Iterator[tuple[str, Log, Log]]:
    def times(names: list[str], factor: float) -> Log:
        return replace(log, channels={**log.channels, **{name: factor * log.channels[name] for name in names}})

    def exchanged(*pairs: tuple[str, str]) -> Log:
        both = [*pairs, *((b, a) for a, b in pairs)]
        return replace(log, channels={**log.channels, **{a: log.channels[b] for a, b in both}})

    machine, here = model.machine, set(log.channels)
    angles = [f"{joint}.q" for joint in machine.joints if f"{joint}.q" in here]
    lengths = [name for name in log.channels if name.endswith(".length")]
    torques = [name for name in log.channels if name.endswith(".tau")]
    chambers = [actuator.chambers for actuator in machine.actuators
                if not isinstance(actuator, Drive) and set(actuator.chambers) <= here]
    pressures = [name for pair in chambers for name in pair]
    for name in angles:
        yield f"sign of {name}", times([name], -1.0), log
    yield "all angles in deg", times(angles, 180 / np.pi), log
    for one, other in pairwise(angles):
        yield f"{one} and {other} exchanged", exchanged((one, other)), log
    yield "time in ms", replace(log, t=log.t * 1e3), log
    yield "time in s, given as ms", replace(log, t=log.t * 1e-3), log
    if pressures:
        for unit, factor in (("bar", 1e-5), ("psi", 1 / 6894.757), ("MPa", 1e-6)):
            yield f"all pressures in {unit}", times(pressures, factor), log
        spoilt = times(pressures, 1e-5)
        turned = {name: np.degrees(spoilt.channels[name]) for name in angles}
        yield ("angles in deg and pressures in bar", replace(spoilt, channels={**spoilt.channels, **turned}), log)
    for one, other in chambers:
        yield f"{one} and {other} exchanged", exchanged((one, other)), log
    for first, second in pairwise(chambers):
        yield f"{first[0]} … with {second[0]} …", exchanged(*zip(first, second, strict=True)), log
    for name in torques:
        yield f"sign of {name}", times([name], -1.0), log
    for one, other in pairwise(torques):
        yield f"{one} and {other} exchanged", exchanged((one, other)), log
    if lengths:
        yield "all lengths in mm", times(lengths, 1e3), log
    for one, other in pairwise(lengths):
        yield f"{one} and {other} exchanged", exchanged((one, other)), log
