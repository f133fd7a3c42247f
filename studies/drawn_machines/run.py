"""CAT 215Bs drawn from the file's confidences: what tracking gains from 30 s of valve test, on each of them."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from typing import Any

import numpy as np

from hydroopt import (
    Log,
    Model,
    combined_problem,
    hydraulic_problem,
    identification_problem,
    load_machine,
    random_truth,
    solve,
)
from hydroopt.control.cascade import Cascade
from hydroopt.control.closed_loop import tip
from hydroopt.control.comparison import FEEDFORWARD, LQG, compare
from hydroopt.control.setting import COMPLETE, TRUE, ModelVariant, Setting
from hydroopt.control.tuning import tuned
from hydroopt.control.valve_refit import ValveRefit
from hydroopt.control.valve_test import driven_test, valve_test
from hydroopt.logs.smoothing import SmoothingSpline
from hydroopt.machine.machine import Machine
from hydroopt.machine.valves import EDGES
from hydroopt.model.plant import Plant
from hydroopt.simulation.drive_valves import random_numbers
from hydroopt.spatial.inertia import Array
from studies import show
from studies.cat215b_tracking.run import RATE, feasible

DRAWS, FEWER, CORES = range(1100, 1150), range(1100, 1120), 2
"""Seeds of the machines, none of which served to improve anything; of those that are tried in more ways; processes."""
SENSITIVITY = 1.6
"""To which gains are tuned, as `hydroopt control` does by default."""
UNLIKE, UNEQUAL = 0.07, 0.3
"""Standard deviations of the four edges, and of the dead bands of both directions, as parts of themselves."""
LATE = 0.030
"""True delay [s] of valves whose file states 20 ms."""
BIAS = np.radians(0.1)
"""Greatest bias of each angle."""
GEOMETRY = (".joint.a", ".joint.d", ".joint.alpha", ".joint.beta", ".dead_length", ".pin")
"""Ends of the names of what poses calibrate."""
SINCE, LESS = 1.1, 0.9
"""By which flows have grown, or become less, since the valve test."""
REPETITIONS, LEARNING, SMOOTH, LEAD = 4, 2.0, 0.1, 0.1
"""Of iterative learning: repetitions of the motion, speed per error [1/s], half the width [s] of its low pass, and time
[s] from a command to the error that it corrects."""


@dataclass(frozen=True, eq=False)
class Case:
    """A drawn machine, and the machine as its file describes it.

    Attributes:
        known: by the file.
        true: the plant, whose delays may differ.
        psi: true dynamic parameters.
        theta: true hydraulic ones.
        bias: of the angles' readings, in the test and afterwards.
        seed: of the draw.
    """

    known: Plant
    true: Plant
    psi: Array
    theta: Array
    bias: Array
    seed: int

    def test(self) -> Log:
        """The valve test of 30 s that `hydroopt plan-valve-test` writes."""
        log = driven_test(valve_test(self.known), self.psi, self.theta, plant=self.true, seed=self.seed, rate=RATE)
        read = {f"{joint}.q": log.channels[f"{joint}.q"] + off
                for joint, off in zip(self.known.machine.joints, self.bias, strict=True)}
        return replace(log, channels={**log.channels, **read})

    def identified(self) -> tuple[Array, Array]:
        """Dynamic and hydraulic parameters identified from one valve test."""
        log = self.test()
        valves = solve(hydraulic_problem(self.known.machine, [log]))
        theta = self.known.parameters.nominal.copy()
        for name, k in self.known.parameters.positions.items():
            if name in valves.parameters and valves.parameters[name].value is not None:
                theta[k] = valves.parameters[name].value
        smoothing = SmoothingSpline(bandwidth=valve_test(self.known).bandwidth)
        return solve(identification_problem(self.known.model, [log], smoothing=smoothing)).psi, theta

    def setting(self, theta: Array, *, sensitivity: float = SENSITIVITY, flows: float = 1.0) -> Setting:
        """A motion that no part of identification saw, for controllers that know θ."""
        scale = [flows if ".flow_" in name or ".rated_flow" in name else 1.0 for name in self.known.parameters.names]
        return Setting(self.known, feasible(self.known.model, 12.0, 100 * self.seed),
                       ModelVariant(TRUE, "drawn", self.true.model, self.psi), self.theta * scale, theta, RATE,
                       self.seed, sensitivity, bias=self.bias)


def run() -> dict:
    """RMS distances of the tip [mm] over drawn machines, by what is known of them, in each kind of truth."""
    with ProcessPoolExecutor(CORES, get_context("spawn")) as pool:
        results = summed(list(pool.map(figures, DRAWS)))
    show.table("RMS distance of the tip [mm]", ("quantity", "value"), list(results.items()))
    return results


def figures(seed: int) -> dict[str, float]:
    """RMS distances of the tip [mm] of one drawn machine; those of `FEWER` have more of them."""
    case = drawn(seed)
    one, nominal = case.identified(), (case.known.model.parameters.nominal, case.known.parameters.nominal)
    found = {"nominal": tracked(case, *nominal), "identified": tracked(case, *one),
             "cautious": tracked(case, *one, sensitivity=1.3)}
    if seed not in FEWER:
        return found
    found |= {"true": tracked(case, case.psi, case.theta), "learning": learned(case),
              "flows_since": tracked(case, *one, flows=SINCE),
              "flows_since_refit": tracked(case, *one, flows=SINCE, refit=True),
              "flows_less_refit": tracked(case, *one, flows=LESS, refit=True),
              "refit": tracked(case, *one, refit=True)}
    for name, make in KINDS.items():
        other = make(seed)
        found |= {name: tracked(other, *other.identified()), f"{name}_true": tracked(other, other.psi, other.theta)}
    found["biased_alone"] = moved(biased(seed))
    gain, phase = margins(case, *one)
    return found | {"lqg_by_feedforward": beside_lqg(case, *one), "gain_margin_db": gain, "phase_margin_deg": phase}


def summed(found: Sequence[dict[str, float]]) -> dict[str, Any]:
    """Medians and extremes over machines."""
    columns = {name: np.array([one[name] for one in found if name in one]) for name in max(found, key=len)}
    ratio, gain, phase = (columns.pop(name) for name in ("lqg_by_feedforward", "gain_margin_db", "phase_margin_deg"))
    beyond = np.sqrt(np.maximum(columns["biased"]**2 - columns["biased_alone"]**2, 0.0))
    results = {"improved": round(float(np.mean(columns["identified"] < columns["nominal"])), 3)}
    for name, values in (*columns.items(), ("biased_beyond", beyond)):
        results |= {f"{name}_median_mm": round(float(np.median(values)), 1),
                    f"{name}_greatest_mm": round(float(np.max(values)), 1)}
    return results | {"lqg_by_feedforward": round(float(np.median(ratio)), 2),
                      "lqg_by_feedforward_greatest": round(float(np.max(ratio)), 2),
                      "gain_margin_db": round(float(np.min(gain)), 1),
                      "phase_margin_deg": round(float(np.min(phase)), 1)}


def file(*, apart: bool = False, delay: float | None = None) -> Plant:
    """The machine file with a sensor for the supply's pressure, with edges and dead bands `apart`, or another delay."""
    data = load_machine("cat215b").model_dump()
    for sensor in data["sensors"]:
        if any(".p_" in channel for channel in sensor["channels"]):
            sensor["channels"] = [*sensor["channels"], "pump.p_supply"]
            break
    for actuator in (*data["motors"], *data["cylinders"]):
        valve, notes = actuator["circuit"]["valve"], f"{actuator['name']}.circuit.valve."
        if delay is not None:
            valve["delay"] = delay
        for one, others in (("rated_flow", EDGES), ("dead_band", ("dead_band_reverse",))) if apart else ():
            valve |= dict.fromkeys(others, valve[one])
            data["notes"] |= {notes + other: data["notes"][notes + one] for other in others}
        if apart:
            valve["rated_flow"] = None
            del data["notes"][notes + "rated_flow"]
    return Plant(Model(Machine.model_validate(data)))


def zeros() -> Machine:
    """The machine file after a calibration of its geometry, of which nothing but zeros of two angles is uncertain."""
    data = PLAIN.machine.model_dump()
    data["notes"] = {name: note for name, note in data["notes"].items() if not name.endswith(GEOMETRY)}
    data["notes"] |= {f"{joint}.joint.theta": {"sigma": BIAS / np.sqrt(3), "source": "accuracy of the sensor"}
                      for joint in ("boom", "stick")}
    return Machine.model_validate(data)


def drawn(seed: int, known: Plant | None = None, true: Plant | None = None) -> Case:
    """Bodies, friction, valves and oil drawn from the file's confidences."""
    known = known or PLAIN
    return Case(known, true or known, random_truth(known.model, seed), random_numbers(known, seed), np.zeros(3), seed)


def both_ways(seed: int) -> Case:
    """Four edges and two dead bands of each valve apart, all of them numbers of their own in the file."""
    case, rng = drawn(seed, APART), np.random.default_rng(seed)
    theta = case.theta.copy()
    for name, k in case.known.parameters.positions.items():
        if ".flow_" in name:
            theta[k] *= 1 + UNLIKE * rng.standard_normal()
        if ".dead_band" in name:
            theta[k] = np.clip(theta[k] * (1 + UNEQUAL * rng.standard_normal()), 0.005, 0.15)
    return replace(case, theta=theta)


def late(seed: int) -> Case:
    """Valves that answer later than the file states."""
    return drawn(seed, true=TARDY)


def biased(seed: int) -> Case:
    """Angles that are read wrong, in the test as in the motion."""
    return replace(drawn(seed), bias=np.random.default_rng(seed).uniform(-BIAS, BIAS, 3))


def zeroed(seed: int) -> Case:
    """The biased machine after `hydroopt identify --with-geometry`, which finds the angles' zeros by the lengths of
    the cylinders, measured in the same test; nothing shows the swing's."""
    case = biased(seed)
    found = solve(combined_problem(ZEROS, [case.test()])).parameters
    return replace(case, bias=case.bias + [found[f"{joint}.theta"].value if f"{joint}.theta" in found else 0.0
                                           for joint in case.known.machine.joints])


def tracked(case: Case, psi: Array, theta: Array, *, sensitivity: float = SENSITIVITY, flows: float = 1.0,
            refit: bool = False) -> float:
    """RMS distance of the tip [mm] from the motion, with gains tuned by what is known."""
    setting = case.setting(theta, sensitivity=sensitivity, flows=flows)
    return rms(setting, cascade(setting, psi, ValveRefit(case.known, theta, 1 / RATE) if refit else None))


def moved(case: Case) -> float:
    """RMS distance [mm] of the tip where all biased readings are exactly as demanded: what the bias itself does."""
    setting = case.setting(case.theta)
    q = setting.reference.at(setting.t).q
    off = tip(case.true, q - case.bias) - tip(case.true, q)
    return float(1e3 * np.sqrt(np.mean(np.sum(off**2, axis=1))))


def cascade(setting: Setting, psi: Array, refit: ValveRefit | None = None, kind: type[Cascade] = Cascade) -> Cascade:
    """The feedforward cascade that knows ψ and the setting's θ."""
    plant, demands = setting.plant, setting.demands
    gains = tuned(setting.points(plant, psi, setting.theta), demands.valves, setting.sensitivity)
    return kind(demands.valves, demands.by(plant.model, psi), gains, 1 / RATE, refit=refit)


def rms(setting: Setting, controller: Cascade) -> float:
    """Of the tip's distance [mm] from where the true machine's would be; infinite if it hits its stops."""
    done = setting.run(controller)
    return np.inf if done.stopped else float(1e3 * np.sqrt(np.mean(setting.tip_error(done) ** 2)))


class Learning(Cascade):
    """A cascade with a speed of each actuator added that former repetitions have learned."""

    def __init__(self, *given: Any, refit: ValveRefit | None = None) -> None:
        super().__init__(*given, refit=refit)
        self.added = np.zeros_like(self.demand.preview.speed)
        self.errors = np.zeros_like(self.added)

    def command(self, k: int, reading: Any) -> Array:
        self.errors[k] = self.demand.length[k] - reading.length
        return super().command(k, reading)

    def _speed(self, k: int, reading: Any) -> Array:
        return super()._speed(k, reading) + self.added[k]

    def learn(self) -> None:
        """Add the errors, without their noise and at the time of the command that they follow (Arimoto 1984)."""
        width = round(SMOOTH * RATE)
        kernel = np.hanning(2 * width + 1) / np.sum(np.hanning(2 * width + 1))
        lead = round(LEAD * RATE)
        for k in range(self.errors.shape[1]):
            smooth = np.convolve(np.pad(self.errors[:, k], width, mode="edge"), kernel, mode="valid")
            self.added[:, k] += LEARNING * np.append(smooth[lead:], np.full(lead, smooth[-1]))


def learned(case: Case) -> float:
    """RMS distance [mm] in the last of `REPETITIONS` of one motion, from nominal bodies and valves."""
    setting = case.setting(case.known.parameters.nominal)
    controller = cascade(setting, case.known.model.parameters.nominal, kind=Learning)
    assert isinstance(controller, Learning)
    for _ in range(REPETITIONS - 1):
        rms(setting, controller)
        controller.learn()
    return rms(setting, controller)


def beside_lqg(case: Case, psi: Array, theta: Array) -> float:
    """RMS distance of the tip with LQG by that with the feedforward, both identified and with the gains of today."""
    variant = ModelVariant(COMPLETE, "identified", case.known.model, psi)
    done = compare(case.setting(theta), [variant], [FEEDFORWARD, LQG])
    found = {each.kind: each.tip_rms for each in done.outcomes if each.variant.name == COMPLETE}
    return found[LQG] / found[FEEDFORWARD]


def margins(case: Case, psi: Array, theta: Array) -> tuple[float, float]:
    """Least gain margin [dB] and phase margin [deg] of the cascade's loops on the true machine, anywhere."""
    variant = ModelVariant(COMPLETE, "identified", case.known.model, psi)
    best = compare(case.setting(theta), [variant], [FEEDFORWARD]).outcomes[0]
    loops = [each.actuator.name for each in case.known.actuators]
    return (min(float(20 * np.log10(best.worst(loop, "gain").gain)) for loop in loops),
            min(float(np.degrees(best.worst(loop, "phase").phase)) for loop in loops))


PLAIN, APART, TARDY = file(), file(apart=True), file(delay=LATE)
ZEROS = zeros()
KINDS = {"both_ways": both_ways, "late": late, "biased": biased, "zeroed": zeroed}
