"""CAT 215B: 200 drawn machines, identified from a log, weigh picked-up loads on a slope while they move."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from hydroopt import Model, load_machine, random_trajectory
from hydroopt.simulation.simulate import Trajectory
from hydroopt.weighing.calibrated_scale import scale
from hydroopt.weighing.course import Reading, Weighable, course
from hydroopt.weighing.equations import Equations, equations
from hydroopt.weighing.scale import CarriedLoad, Scale
from hydroopt.weighing.smoothed_log import smoothed_log
from studies.weighing.machines import (
    CAT,
    OTHERS,
    RATE,
    WHITE,
    Carrier,
    Noise,
    Session,
    SimulatedMachine,
    SwingsTooFarError,
    pick_up,
)
from studies.weighing.quasistatic import QuasistaticScale

MACHINES, MATRICES, FEWER = 200, 50, 60
FIRST, FURTHER = 55000, 67000
"""Seeds of the first machine that weighs, and of the first under other noise or of another kind; none of them served to
choose rules or thresholds."""
SMALLEST = 0.04
"""Smallest load, and smallest change that must be found, as a part of the full scale: 100 kg of 2500."""
TARE, PICKED, WEIGHED = 10.0, 12.0, 5.0
"""Empty motion [s], when the load begins to leave the ground, and how long it is weighed from when it hangs [s]."""
STEEPEST = np.radians(5.0)
DRIFT = 35e3
"""Standard deviation of each pressure's zero since the calibration [Pa], 5 psi."""


@dataclass(frozen=True)
class Case:
    """How machines move and what is known of the load's centre.

    Attributes:
        name: of the results.
        centre_std: true and stated [m].
        held: joints that stand still.
        speed: part of the full speed.
        noise: of the pressures, at the calibration as well.
    """

    name: str
    centre_std: float
    held: tuple[int, ...] = ()
    noise: Noise = WHITE


CASES = (Case("hung from a pin", 0.05), Case("centre unknown", 0.3),
         Case("hung from a pin, lift and slew", 0.05, held=(2,)), Case("centre unknown, lift and slew", 0.3, held=(2,)))
DISTURBED = (Case("pulsation of 5 bar", 0.05, noise=Noise(pulsation=5e5)),
             Case("errors with a memory of 0.3 s", 0.05, noise=Noise(memory=0.3)),
             Case("zeros that wander by 5 psi a minute", 0.05, noise=Noise(wander=35e3)))
IN_A_BUCKET = Case("load in the bucket, known to 10 cm", 0.1)


@dataclass(frozen=True)
class Outcome:
    """What became of one load.

    Attributes:
        error, std: of the mass, as parts of the full scale, `WEIGHED` after the load hangs; status, misfit: there.
        delay: until it is noticed [s], in motion that shows it; alarms: changes where nothing changed.
        wrong, good: how many masses are shown as good, and how many of them are off by more than 1 % of the full scale
            and three deviations.
        alone: error that the centre alone makes where the load's link is held, see `by_the_centre`; NaN elsewhere.
    """

    error: float
    std: float
    alone: float
    status: Weighable
    delay: float
    alarms: int
    misfit: float
    wrong: int
    good: int


def run() -> dict[str, Any]:
    """Errors, coverage, delays and false alarms of each case."""
    with threadpool_limits(limits=1, user_api="blas"):
        found = outcomes(CAT, CASES, range(FIRST, FIRST + MACHINES)) | robustness(range(FURTHER, FURTHER + FEWER))
        matrix = quasistatic(range(MATRICES))
    return {f"{name}: {key}": value for name, some in found.items() for key, value in summary(some).items()} | matrix


def robustness(seeds: range) -> dict[str, list[Outcome]]:
    """Outcomes under noise that is not white, and of other machines, by name."""
    found = {name: some for case in DISTURBED for name, some in outcomes(CAT, (case,), seeds).items()}
    return found | {each.machine: some for each in OTHERS for some in outcomes(each, (IN_A_BUCKET,), seeds).values()}


def quasistatic(seeds: range) -> dict[str, Any]:
    """RMS errors of the quasistatic matrix by speed and slope [% of full scale], where the boom lifts."""
    model, found = Model(load_machine("cat215b")), dict[str, list[float]]()
    for seed in seeds:
        rng = np.random.default_rng([seed, 4])
        machine = SimulatedMachine.drawn(CAT, model, seed)
        matrix, mass = QuasistaticScale(machine, CAT.full_scale), rng.uniform(SMALLEST, 1) * CAT.full_scale
        for speed in (0.2, 1.0):
            for steep in (0.0, STEEPEST):
                motion = slower(random_trajectory(model, duration=20.0, rate=RATE / speed, seed=seed), speed)
                slope = steep * rng.choice([-1, 1], 2)
                session = Session(motion, np.full(len(motion.t), mass), np.zeros(3), (slope[0], slope[1]), DRIFT)
                error = matrix.mass(machine.log(session, seed), 0.0, 20.0 / speed) - mass
                found.setdefault(f"matrix, speed {speed:g}, slope {np.degrees(steep):.0f} deg", []).append(error)
    return {f"{name}: RMS error [% of full scale]": round(100 * rms(np.array(some)[np.isfinite(some)]) / CAT.full_scale,
                                                          2)
            for name, some in found.items()}


def slower(motion: Trajectory, speed: float) -> Trajectory:
    """The same path at a part of the speed."""
    return replace(motion, t=motion.t / speed, qd=motion.qd * speed, qdd=motion.qdd * speed**2)


def outcomes(carrier: Carrier, cases: Sequence[Case], seeds: range) -> dict[str, list[Outcome]]:
    """What becomes of a load on each drawn machine, by case; the first one's noise is that of the calibration.

    Machines on which it swings beyond the range of its joint are left out.
    """
    model, found = Model(load_machine(carrier.machine)), dict[str, list[Outcome]]()
    for seed in seeds:
        machine = SimulatedMachine.drawn(carrier, model, seed)
        with suppress(SwingsTooFarError):
            known = scale(model, machine.calibration(seed, cases[0].noise), carried(carrier, cases[0]))
            for case in cases:
                found.setdefault(case.name, []).append(trial(machine, known, case, seed))
    return found


def carried(carrier: Carrier, case: Case) -> CarriedLoad:
    """What is stated of the load."""
    return CarriedLoad(carrier.link, carrier.centre, (case.centre_std,) * 3, carrier.full_scale)


def trial(machine: SimulatedMachine, known: Scale, case: Case, seed: int) -> Outcome:
    """Weigh one load."""
    rng, full_scale = np.random.default_rng([seed, 3]), machine.carrier.full_scale
    mass, lasts, slope = rng.uniform(SMALLEST, 1) * full_scale, rng.uniform(1, 2), rng.uniform(-STEEPEST, STEEPEST, 2)
    slope *= machine.carrier is CAT  # others stand level, which their scales do not know
    hangs = PICKED + lasts
    motion = driven(machine.model, hangs + WEIGHED + 1.5, seed + 1000, case)
    centre = rng.normal(0.0, case.centre_std, 3)
    session = Session(motion, pick_up(motion.t, mass, PICKED, lasts), centre, (slope[0], slope[1]), DRIFT,
                      case.noise)
    read, readings = weigh(machine, known, session, case, seed)
    delayed = read.smoothed.kernel.margin * read.smoothed.kernel.step
    last = [each for each in readings if read.t[each.sample] + delayed <= hangs + WEIGHED][-1]
    reached = motion.t[np.argmax(session.mass >= SMALLEST * full_scale)]
    noticed = [each.sample for each in readings if each.load == 1]
    # samples that show nothing of the load do not count
    showing = (np.array([each.noticeable for each in readings]) < SMALLEST * full_scale) & (read.t >= reached)
    stride = read.smoothed.kernel.stride * read.smoothed.kernel.step
    delay = delayed + stride * float(np.sum(showing[: noticed[0]])) if noticed else np.inf
    before = sum(read.t[sample] + delayed < PICKED for sample in noticed[:1])
    masses = np.interp(read.t, motion.t, session.mass)
    # before a change must be noticed, what is shown is that of before
    shown = [each for each in readings if each.status is Weighable.OK
             and not PICKED <= read.t[each.sample] + delayed < reached + 1.5]
    wrong = [abs(each.weighed.mass - masses[each.sample]) > max(0.01 * full_scale, 3 * each.weighed.mass_std)
             for each in shown]
    return Outcome((last.weighed.mass - mass) / full_scale, last.weighed.mass_std / full_scale,
                   mass / full_scale * by_the_centre(machine, motion.q[0], centre) if case.held else np.nan,
                   last.status, delay, max(readings[-1].load - 1, 0) + before, last.weighed.misfit, sum(wrong),
                   len(wrong))


def by_the_centre(machine: SimulatedMachine, q: np.ndarray, centre: np.ndarray) -> float:
    """Error of a mass, as a part of it, that is weighed by the boom's moment alone.

    While the stick is held, boom and load are one body: the load's distance from the boom's joint enters as a factor of
    the mass, and no motion of the boom tells them apart.
    """
    length = machine.model.machine.link("boom").joint.a
    turn = np.array([[np.cos(q[2]), -np.sin(q[2])], [np.sin(q[2]), np.cos(q[2])]])
    arm = turn @ machine.carrier.centre[:2] + [length, 0.0]
    return float(arm @ turn @ centre[:2] / (arm @ arm))


def weigh(machine: SimulatedMachine, known: Scale, session: Session, case: Case,
          seed: int) -> tuple[Equations, list[Reading]]:
    """What the scale shows in a session."""
    log = machine.log(session, seed)
    read = equations(replace(known, load=carried(machine.carrier, case)), smoothed_log(machine.model, log))
    return read, list(course(read, tare=TARE, needed=0.02 * machine.carrier.full_scale))


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
    alone = np.array([each.alone for each in some])
    limit = {"within 1 % if only the centre were uncertain": round(float(np.mean(np.abs(alone) < 0.01)), 3),
             "correlation of errors with those of the centre": round(float(np.corrcoef(error, alone)[0, 1]), 2)}
    return (limit if np.all(np.isfinite(alone)) else {}) | {
            "within 1 %": round(float(np.mean(np.abs(error) < 0.01)), 3),
            "shown": round(float(np.mean(shown)), 3),
            "RMS error where shown [% of full scale]": round(100 * rms(error[shown]), 2),
            "within 1 % where shown": round(float(np.mean(np.abs(error[shown]) < 0.01)), 3),
            "median std [% of full scale]": round(100 * float(np.median(std)), 2),
            "coverage of 95 % intervals": round(float(np.mean(z < 1.96)), 3),
            "coverage of 95 % intervals where shown": round(float(np.mean(z[shown] < 1.96)), 3),
            "coverage of 68 % intervals": round(float(np.mean(z < 1.0)), 3),
            "RMS error in deviations": round(rms(z), 2),
            "largest error in deviations": round(float(np.max(z)), 2),
            "found within 1.5 s": round(float(np.mean(delay <= 1.5)), 3),
            "largest delay [s]": round(float(np.max(delay)), 2),
            "masses shown that are wrong": round(
                float(sum(each.wrong for each in some)) / max(sum(each.good for each in some), 1), 4),
            "false alarms": int(sum(each.alarms for each in some))}


def rms(values: np.ndarray) -> float:
    """Root mean square, NaN of nothing."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


if __name__ == "__main__":
    import json
    MACHINES = int(sys.argv[1]) if len(sys.argv) > 1 else MACHINES
    print(json.dumps(run(), indent=1))
