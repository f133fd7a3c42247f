"""CAT 215B: 200 drawn machines, identified from a log, weigh picked-up loads on a slope while they move."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from hydroopt import Model, load_machine, random_trajectory
from hydroopt.simulation.simulate import Trajectory
from hydroopt.weighing.course import Reading, Weighable, course
from hydroopt.weighing.equations import Equations, equations
from hydroopt.weighing.scale import CarriedLoad, Scale, scale
from hydroopt.weighing.smoothed_log import smoothed_log
from studies.weighing.machines import LINK, PIN, RATE, Session, SimulatedMachine, pick_up
from studies.weighing.quasistatic import QuasistaticScale

MACHINES, MATRICES = 200, 50
FIRST = 9000
"""Seed of the first machine that weighs; rules and thresholds were chosen on seeds below 7000."""
FULL_SCALE = 2500.0
"""Largest load [kg]; 1 % of it is 25 kg."""
TARE, PICKED, WEIGHED = 10.0, 12.0, 5.0
"""Empty motion [s], when the load begins to leave the ground, and how long it is weighed from when it hangs [s]."""
STEEPEST = np.radians(5.0)
DRIFT = 35e3
"""Standard deviation of each pressure's zero since the calibration [Pa], 5 psi."""
NOTICED = 100.0
"""Smallest load whose change must be found [kg]."""


@dataclass(frozen=True)
class Case:
    """How machines move and what is known of the load's centre.

    Attributes:
        name: of the results.
        centre_std: true and stated [m].
        held: joints that stand still.
        speed: part of the full speed.
        steepest: base's slopes are drawn up to this [rad].
    """

    name: str
    centre_std: float
    held: tuple[int, ...] = ()
    speed: float = 1.0
    steepest: float = STEEPEST


CASES = (Case("hung from a pin", 0.05), Case("centre unknown", 0.3),
         Case("hung from a pin, lift and slew", 0.05, held=(2,)), Case("centre unknown, lift and slew", 0.3, held=(2,)))


@dataclass(frozen=True)
class Outcome:
    """What became of one load.

    Attributes:
        error, std: of the mass [kg], `WEIGHED` after the load hangs; status, misfit: there.
        delay: until it is noticed [s], in motion that shows it; alarms: changes where nothing changed.
        wrong, good: how many masses are shown as good, and how many of them are off by more than 1 % of the full scale
            and three deviations.
    """

    error: float
    std: float
    status: Weighable
    delay: float
    alarms: int
    misfit: float
    wrong: int
    good: int


def run() -> dict[str, Any]:
    """Errors, coverage, delays and false alarms of each case."""
    found: dict[str, list[Outcome]] = {}
    with threadpool_limits(limits=1, user_api="blas"):
        for outcomes in machines(range(FIRST, FIRST + MACHINES)):
            for name, outcome in outcomes.items():
                found.setdefault(name, []).append(outcome)
        matrix = quasistatic(range(MATRICES))
    return {f"{name}: {key}": value for name, some in found.items() for key, value in summary(some).items()} | matrix


def quasistatic(seeds: range) -> dict[str, Any]:
    """RMS errors of the quasistatic matrix by speed and slope [% of full scale], where the boom lifts."""
    model, found = Model(load_machine("cat215b")), dict[str, list[float]]()
    for seed in seeds:
        rng = np.random.default_rng([seed, 4])
        machine = SimulatedMachine.drawn(model, seed)
        matrix, mass = QuasistaticScale(machine, FULL_SCALE), rng.uniform(100, FULL_SCALE)
        for speed in (0.2, 1.0):
            for steep in (0.0, STEEPEST):
                motion = slower(random_trajectory(model, duration=20.0, rate=RATE / speed, seed=seed), speed)
                slope = steep * rng.choice([-1, 1], 2)
                session = Session(motion, np.full(len(motion.t), mass), np.zeros(3), (slope[0], slope[1]), DRIFT)
                error = matrix.mass(machine.log(session, seed), 0.0, 20.0 / speed) - mass
                found.setdefault(f"matrix, speed {speed:g}, slope {np.degrees(steep):.0f} deg", []).append(error)
    return {f"{name}: RMS error [% of full scale]": round(100 * rms(np.array(some)[np.isfinite(some)]) / FULL_SCALE, 2)
            for name, some in found.items()}


def slower(motion: Trajectory, speed: float) -> Trajectory:
    """The same path at a part of the speed."""
    return replace(motion, t=motion.t / speed, qd=motion.qd * speed, qdd=motion.qdd * speed**2)


def machines(seeds: range) -> Iterator[Mapping[str, Outcome]]:
    """The outcome of each case, machine by machine."""
    model = Model(load_machine("cat215b"))
    for seed in seeds:
        machine = SimulatedMachine.drawn(model, seed)
        known = scale(model, machine.calibration(seed), carried(CASES[0]))
        yield {case.name: trial(machine, known, case, seed) for case in CASES}


def carried(case: Case) -> CarriedLoad:
    """What is stated of the load."""
    return CarriedLoad(LINK, PIN, (case.centre_std,) * 3, FULL_SCALE)


def trial(machine: SimulatedMachine, known: Scale, case: Case, seed: int) -> Outcome:
    """Weigh one load."""
    rng = np.random.default_rng([seed, 3])
    mass, lasts, slope = rng.uniform(100, FULL_SCALE), rng.uniform(1, 2), rng.uniform(-case.steepest, case.steepest, 2)
    hangs = PICKED + lasts
    motion = driven(machine.model, hangs + WEIGHED + 1.5, seed + 1000, case)
    centre = rng.normal(0.0, case.centre_std, 3)
    session = Session(motion, pick_up(motion.t, mass, PICKED, lasts), centre, (slope[0], slope[1]), DRIFT)
    read, readings = weigh(machine, known, session, case, seed)
    delayed = read.smoothed.kernel.margin * read.smoothed.kernel.step
    last = [each for each in readings if read.t[each.sample] + delayed <= hangs + WEIGHED][-1]
    reached = motion.t[np.argmax(session.mass >= NOTICED)]
    noticed = [each.sample for each in readings if each.load == 1]
    # samples that show nothing of the load do not count
    showing = (np.array([each.noticeable for each in readings]) < NOTICED) & (read.t >= reached)
    stride = read.smoothed.kernel.stride * read.smoothed.kernel.step
    delay = delayed + stride * float(np.sum(showing[: noticed[0]])) if noticed else np.inf
    before = sum(read.t[sample] + delayed < PICKED for sample in noticed[:1])
    masses = np.interp(read.t, motion.t, session.mass)
    # before a change must be noticed, what is shown is that of before
    shown = [each for each in readings if each.status is Weighable.OK
             and not PICKED <= read.t[each.sample] + delayed < reached + 1.5]
    wrong = [abs(each.weighed.mass - masses[each.sample]) > max(0.01 * FULL_SCALE, 3 * each.weighed.mass_std)
             for each in shown]
    return Outcome(last.weighed.mass - mass, last.weighed.mass_std, last.status, delay,
                   max(readings[-1].load - 1, 0) + before, last.weighed.misfit, sum(wrong), len(wrong))


def weigh(machine: SimulatedMachine, known: Scale, session: Session, case: Case,
          seed: int) -> tuple[Equations, list[Reading]]:
    """What the scale shows in a session."""
    log = machine.log(session, seed)
    read = equations(replace(known, load=carried(case)), smoothed_log(machine.model, log))
    return read, list(course(read, tare=TARE, needed=0.02 * FULL_SCALE))


def driven(model: Model, duration: float, seed: int, case: Case) -> Trajectory:
    """A random motion with some joints held after the tare."""
    motion = random_trajectory(model, duration=30.0, rate=RATE, seed=seed)
    size = round(duration * RATE)
    motion = replace(motion, t=motion.t[:size], q=motion.q[:size], qd=motion.qd[:size], qdd=motion.qdd[:size])
    for k in case.held:
        motion.q[:, k], motion.qd[:, k], motion.qdd[:, k] = motion.q[0, k], 0.0, 0.0
    return motion


def summary(some: list[Outcome]) -> dict[str, Any]:
    """Figures of one case, errors in per cent of the full scale."""
    error, std = (np.array([getattr(each, key) for each in some]) for key in ("error", "std"))
    shown = np.array([each.status is Weighable.OK for each in some])
    delay, z = np.array([each.delay for each in some]), np.abs(error / std)
    return {"within 1 %": round(float(np.mean(np.abs(error) < 0.01 * FULL_SCALE)), 3),
            "shown": round(float(np.mean(shown)), 3),
            "RMS error where shown [% of full scale]": round(100 * rms(error[shown]) / FULL_SCALE, 2),
            "within 1 % where shown": round(float(np.mean(np.abs(error[shown]) < 0.01 * FULL_SCALE)), 3),
            "median std [% of full scale]": round(100 * float(np.median(std)) / FULL_SCALE, 2),
            "coverage of 95 % intervals": round(float(np.mean(z < 1.96)), 3),
            "coverage of 95 % intervals where shown": round(float(np.mean(z[shown] < 1.96)), 3),
            "coverage of 68 % intervals": round(float(np.mean(z < 1.0)), 3),
            "largest error in deviations": round(float(np.max(z)), 2),
            "found within 1.5 s": round(float(np.mean(delay <= 1.5)), 3),
            "largest delay [s]": round(float(np.max(delay)), 2),
            "masses shown that are wrong": round(sum(each.wrong for each in some) / sum(each.good for each in some), 4),
            "false alarms": int(sum(each.alarms for each in some))}


def rms(values: np.ndarray) -> float:
    """Root mean square, NaN of nothing."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


if __name__ == "__main__":
    import json
    MACHINES = int(sys.argv[1]) if len(sys.argv) > 1 else MACHINES
    print(json.dumps(run(), indent=1))
