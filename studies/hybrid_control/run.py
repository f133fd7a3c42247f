"""CAT 215B whose tip slides on a stiff floor under a force: what calibration buys in force and position control."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline

from hydroopt import (
    Model,
    identification_problem,
    inverse_kinematics,
    load_machine,
    random_trajectory,
    random_truth,
    simulate,
    solve,
)
from hydroopt.control import closed_loop
from hydroopt.control.cascade import Cascade, Gains
from hydroopt.control.closed_loop import tip
from hydroopt.control.hybrid import ForceGains, Hybrid, Pressing
from hydroopt.control.linear_plant import point
from hydroopt.control.loops import response
from hydroopt.control.reference import Demands, Reference
from hydroopt.control.setting import COMPLETE, NOMINAL, TRUE, ModelVariant, Setting
from hydroopt.control.tuning import tuned
from hydroopt.control.valve_inversion import Valves
from hydroopt.model.plant import Plant, Wall
from hydroopt.simulation.drive_valves import random_numbers
from hydroopt.simulation.simulate import Trajectory
from hydroopt.spatial.inertia import Array
from studies import show

SEEDS = range(10, 15)
RATE = 50.0
"""Of sensors and controller [Hz]."""
SENSITIVITY = 1.3
"""To which gains are tuned."""
FORCE, STIFFNESS, DAMPING, FRICTION = 8e3, 1e6, 0.5, 0.2
"""Normal force [N] that is demanded; the floor's stiffness [N/m], damping [s/m] and coefficient of friction."""
SURFACE, GAP = -1.0, 0.04
"""Height [m] at which the floor is thought to be, and of the tip above it at first."""
WRONG, FACTOR = 0.02, 4.0
"""Standard deviation [m] of the floor's height, at most so much below the tip, and largest factor on its stiffness."""
DOWN, PRESS, SLIDE, END = (0.3, 1.5), (1.0, 2.5), (3.0, 8.0), 8.5
"""Times [s] in which the tip goes down, the force rises, and the tip slides; and the end."""
FAR, NEAR = 6.2, 5.2
"""Distances [m] from the swing's axis between which the tip slides."""
GAINS = ForceGains(proportional=1.1e-5, integral_time=1.0, filter_time=0.05, fastest=0.1)
"""The force's proportional gain is the largest with a gain margin of 6 dB over all factors on the stiffness."""
NORMAL = np.array([0.0, 0.0, 1.0])
NEARLY = 0.2
"""Part of their drawn errors that valves and oil have after an identification of them."""
SLOWEST = 0.02
"""Joint speed [rad/s] from which on the force loop is linearised: slower valves are within their dead band."""
LOST = 0.01
"""Part of the demanded force below which the contact counts as lost."""


class Case(NamedTuple):
    """A true machine on a true floor, and what is known of the machine."""

    psi: Array
    theta: Array
    wall: Wall
    variants: dict[str, ModelVariant]


class Pressed(NamedTuple):
    """What one run achieved while the tip slides: errors of the normal force [kN] and along the floor [mm]."""

    rms: float
    mean: float
    peak: float
    along: float
    lost: float


def run() -> dict:
    """Errors of normal force and path over seeds, by controller and by what it knows."""
    plant = Plant(Model(load_machine("cat215b")))
    motion = path(plant.model)
    deep = path(plant.model, FORCE / STIFFNESS)  # where a floor as it is thought to be bears the force
    gains = gains_of(plant, motion)
    cases = [case(plant, seed) for seed in SEEDS]
    nominal = plant.parameters.nominal
    show.table("The true machines and floors", ("seed", "height of the floor [mm]", "stiffness [MN/m]", "dead bands"), [
        (seed, f"{1e3 * (one.wall.point[2] - SURFACE):.0f}", f"{one.wall.stiffness / 1e6:.2f}",
         " ".join(f"{value:.3f}" for value in one.theta[dead_bands(plant)]))
        for seed, one in zip(SEEDS, cases, strict=True)])
    results: dict = {"gain_margin_db": round(gain_margin(plant, motion), 1)}
    known = [one._replace(theta=nominal) for one in cases]
    for name, some in {"": cases, "_floor_known": [one._replace(wall=floor(0.0, STIFFNESS)) for one in cases],
                       "_floor_and_valves_known": [one._replace(wall=floor(0.0, STIFFNESS)) for one in known]}.items():
        results |= report(f"position_complete{name}", [
            pressed(plant, deep, gains, one, COMPLETE, seed, hybrid=False)
            for seed, one in zip(SEEDS, some, strict=True)])
    for name in (NOMINAL, COMPLETE, TRUE):
        results |= report(f"hybrid_{name}", [pressed(plant, motion, gains, one, name, seed, hybrid=True)
                                             for seed, one in zip(SEEDS, cases, strict=True)])
    for name in (NOMINAL, COMPLETE):
        results |= report(f"hybrid_{name}_valves_known", [
            pressed(plant, motion, gains, one, name, seed, hybrid=True)
            for seed, one in zip(SEEDS, known, strict=True)])
    nearly = [one._replace(theta=nominal + NEARLY * (one.theta - nominal)) for one in cases]
    results |= report("hybrid_complete_valves_nearly_known", [
        pressed(plant, motion, gains, one, COMPLETE, seed, hybrid=True)
        for seed, one in zip(SEEDS, nearly, strict=True)])
    for name in ("", "_valves_known"):
        for key in ("rms", "mean"):
            results[f"nominal_by_complete{name}_{key}"] = round(
                results[f"hybrid_nominal{name}_{key}_kn"] / results[f"hybrid_complete{name}_{key}_kn"], 2)
    results["complete_by_true"] = round(results["hybrid_complete_rms_kn"] / results["hybrid_true_rms_kn"], 2)
    results["position_by_hybrid"] = round(results["position_complete_rms_kn"] / results["hybrid_complete_rms_kn"], 2)
    return results


def case(plant: Plant, seed: int) -> Case:
    """Bodies, friction, valves and floor drawn for a seed; what is known: the machine file, or two logs identified."""
    model, rng = plant.model, np.random.default_rng(seed)
    truth = random_truth(model, seed)
    logs = [simulate(model, random_trajectory(model, duration=20.0, rate=RATE, seed=100 * seed + k), truth,
                     seed=100 * seed + k) for k in (1, 2)]
    estimate = solve(identification_problem(model, logs))
    height = float(np.clip(WRONG * rng.standard_normal(), -GAP + 0.01, GAP - 0.01))
    return Case(truth, random_numbers(plant, seed), floor(height, STIFFNESS * FACTOR ** rng.uniform(-1, 1)), {
        NOMINAL: ModelVariant(NOMINAL, "the machine file", model, model.parameters.nominal),
        COMPLETE: ModelVariant(COMPLETE, "identified", model, estimate.psi),
        TRUE: ModelVariant(TRUE, "drawn", model, truth)})


def dead_bands(plant: Plant) -> list[int]:
    """Places of the valves' dead bands among the hydraulic parameters."""
    return [k for k, name in enumerate(plant.parameters.names) if name.endswith(".dead_band")]


def floor(height: float, stiffness: float) -> Wall:
    """A level floor so much above where it is thought to be [m]."""
    return Wall((0.0, 0.0, SURFACE + height), (0.0, 0.0, 1.0), stiffness, DAMPING, FRICTION)


def path(model: Model, depth: float = 0.0) -> Trajectory:
    """The tip goes down to the floor, presses to a depth [m], and slides towards the machine."""
    fine = np.arange(round(END * 1000) + 1) / 1000
    places = np.column_stack([FAR + (NEAR - FAR) * rise(fine, SLIDE), 0 * fine,
                              SURFACE + GAP * (1 - rise(fine, DOWN)) - depth * rise(fine, PRESS)])
    q, angles = inverse_kinematics(model, places[0])[0].q, np.empty_like(places)
    for k, place in enumerate(places):
        for _ in range(2):  # a millimetre further on, Newton's method takes two steps to rounding
            gap = place - np.asarray(model.forward_kinematics(q)[-1])[:3, 3]
            q = q + np.linalg.solve(np.asarray(model.tip_jacobian(q))[:3], gap)
        angles[k] = q
    curve, t = make_interp_spline(fine, angles, k=5), np.arange(round(END * RATE) + 1) / RATE
    wrench = np.zeros((len(t), 6))
    wrench[:, 2] = FORCE * rise(t, PRESS)
    return Trajectory(t, curve(t), curve(t, 1), curve(t, 2), wrench)


def rise(t: Array, span: tuple[float, float]) -> Array:
    """From 0 to 1 over a span of time, by a polynomial of the fifth degree."""
    x = np.clip((t - span[0]) / (span[1] - span[0]), 0, 1)
    return np.asarray(x**3 * (10 - 15 * x + 6 * x**2))


def gains_of(plant: Plant, motion: Trajectory) -> Gains:
    """Gains of the position loops, tuned on the nominal machine in free space."""
    psi, theta = plant.model.parameters.nominal, plant.parameters.nominal
    setting = Setting(plant, motion, ModelVariant(TRUE, "nominal", plant.model, psi), theta, theta, RATE,
                      sensitivity=SENSITIVITY)
    return tuned(setting.points(plant, psi, theta), setting.demands.valves, setting.sensitivity)


def gain_margin(plant: Plant, motion: Trajectory) -> float:
    """Least gain margin [dB] of the force loop while the nominal machine slides, over the floor's stiffness.

    The linear loop about three points of the motion: normal speed to commands, valves, machine on the floor, actuator
    forces, force at the tip.
    """
    model, psi, theta = plant.model, plant.model.parameters.nominal, plant.parameters.nominal
    z = np.exp(1j * np.geomspace(1, 0.95 * np.pi * RATE, 2000) / RATE)
    pole = np.exp(-1 / RATE / GAINS.filter_time)
    feedback = GAINS.proportional * (1 + 1 / RATE / GAINS.integral_time / (z - 1)) * (1 - pole) / (1 - pole / z)
    largest = 0.0
    for stiffness in STIFFNESS * np.array([1 / FACTOR, 1.0, FACTOR]):
        for k in np.searchsorted(motion.t, SLIDE[0] + (SLIDE[1] - SLIDE[0]) * np.array([0.1, 0.5, 0.9])):
            q = motion.q[k]
            speed = np.where(np.abs(motion.qd[k]) < SLOWEST, SLOWEST, motion.qd[k])
            here = np.asarray(model.forward_kinematics(q)[-1])[2, 3]
            touching = Plant(model, floor(here + FORCE / stiffness - SURFACE, stiffness))
            at = point(touching, "sliding", q, speed, psi, theta, 1 / RATE)
            moved = response(at.system, z)[:, 3:6]
            slopes = Valves(touching, theta).slopes(at.speed, at.length, at.pressure, at.supply)
            to_tip = np.asarray(model.tip_jacobian(q))[:3] @ np.linalg.inv(at.lever_arm)
            across = np.linalg.solve(to_tip, -NORMAL)
            L = feedback * np.einsum("i,wij,j->w", np.linalg.solve(to_tip.T, np.eye(3)).T @ -NORMAL, moved,
                                     slopes.speed * across)
            turns = np.flatnonzero((np.diff(np.sign(L.imag)) != 0) & (L.real[:-1] < 0))
            largest = max([largest, *np.abs(L[turns])])
    return float(-20 * np.log10(largest))


def pressed(plant: Plant, motion: Trajectory, gains: Gains, one: Case, name: str, seed: int, *,
            hybrid: bool) -> Pressed:
    """One run; the controller knows the nominal valves."""
    demands = Demands(Valves(Plant(plant.model, one.wall), plant.parameters.nominal), Reference(motion), motion.t)
    variant = one.variants[name]
    given = demands.valves, demands.by(variant.model, variant.psi), gains, 1 / RATE
    assert motion.wrench is not None
    controller = Hybrid(*given, variant=variant, pressing=Pressing(motion, NORMAL, motion.wrench[:, 2]),
                        force_gains=GAINS) if hybrid else Cascade(*given)
    done = closed_loop.simulate(demands, controller, demands.plant, one.psi, one.theta, seed=seed)
    sliding = done.t >= SLIDE[0]
    error = (done.contact[:, 2] - motion.wrench[:len(done.t), 2])[sliding] / 1e3
    off = np.linalg.norm((tip(plant, done.q) - tip(plant, motion.q[:len(done.t)]))[sliding, :2], axis=1)
    return Pressed(float(np.sqrt(np.mean(error**2))), float(np.mean(error)), float(np.max(np.abs(error))),
                   1e3 * float(np.sqrt(np.mean(off**2))), float(np.mean(error < (LOST - 1) * FORCE / 1e3)))


def report(name: str, runs: list[Pressed]) -> dict[str, float]:
    """A table of the runs by seed, and what they come to together."""
    show.table(f"{name}: while the tip slides under {FORCE / 1e3:g} kN", (
        "seed", "force RMS [kN]", "mean [kN]", "peak [kN]", "along [mm]", "lost [%]"), [
            (seed, f"{one.rms:.2f}", f"{one.mean:.2f}", f"{one.peak:.2f}", f"{one.along:.1f}", f"{100 * one.lost:.0f}")
            for seed, one in zip(SEEDS, runs, strict=True)])
    return {f"{name}_rms_kn": round(float(np.sqrt(np.mean([one.rms**2 for one in runs]))), 3),
            f"{name}_mean_kn": round(float(np.sqrt(np.mean([one.mean**2 for one in runs]))), 3),
            f"{name}_peak_kn": round(max(one.peak for one in runs), 2),
            f"{name}_along_mm": round(float(np.sqrt(np.mean([one.along**2 for one in runs]))), 1),
            f"{name}_lost": round(float(np.mean([one.lost for one in runs])), 3)}
