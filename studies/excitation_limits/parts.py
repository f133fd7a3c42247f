"""Random machines and limits, and what an independent look says of the motions designed for them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hydroopt import Machine, Model, load_machine, simulate
from hydroopt.errors import ProblemError
from hydroopt.estimation.inference.identifiability import random_states
from hydroopt.excitation.criteria import CRITERIA
from hydroopt.excitation.motion.basis import Fourier, Spline
from hydroopt.excitation.motion.design import design, excitation_problem
from hydroopt.excitation.motion.excitation import Excitation
from hydroopt.kernels import native
from hydroopt.limits.limits import Limits
from hydroopt.machine.environment import Obstacle, Pump
from hydroopt.machine.links import Box
from hydroopt.simulation import simulate as synthetic

BASES = ("cat215b", "cat215b", "patu655_lift", "ur10")
RATE = 20.0
EXACT = 1e-9
"""By how much of itself a bound may be broken by rounding."""


class Outcome(NamedTuple):
    """What became of a setting: broken limits by name, whether the motion moves, and why there is none."""

    broken: tuple[str, ...]
    moves: bool
    refused: str
    wrongly: bool


def random_machine(rng: np.random.Generator) -> Machine:
    """A bundled machine with other lengths, masses and limits."""
    machine = load_machine(str(rng.choice(BASES)))
    stretch, weight = (float(rng.uniform(0.7, 1.4)) for _ in range(2))
    links = []
    for link in machine.links:
        if link.joint.type == "locked":
            links.append(link)
            continue
        low, high = link.joint.range
        a, b = np.sort(rng.uniform(low, high, 2)) if rng.random() < 0.5 else (low, high)
        change: dict[str, Any] = {"lower": float(a), "upper": float(max(b, a + 0.02 * (high - low))),
                                  "max_speed": _maybe(rng, 0.05, 2.0), "max_acceleration": _maybe(rng, 0.05, 5.0)}
        if machine.name == "ur10":  # nothing closes there
            change |= {"a": link.joint.a * stretch, "d": link.joint.d * stretch}
        body = link.body and link.body.model_copy(update={"m": link.body.m * weight})
        links.append(link.model_copy(update={"joint": link.joint.model_copy(update=change), "body": body}))
    update: dict[str, Any] = {"links": tuple(links), "bandwidth": _maybe(rng, 0.3, 5.0)}
    update["cylinders"] = tuple(c.model_copy(update={"max_speed": _maybe(rng, 0.02, 0.5),
                                                     "relief_pressure": _maybe(rng, 1e7, 4e7)})
                                for c in machine.cylinders)
    update["motors"] = tuple(m.model_copy(update={"relief_pressure": _maybe(rng, 5e6, 4e7)}) for m in machine.motors)
    update["drives"] = tuple(d.model_copy(update={"max_torque": _maybe(rng, 30, 600)}) for d in machine.drives)
    update["pump"] = Pump(max_flow=float(10 ** rng.uniform(-5, -2))) if rng.random() < 0.6 else None
    corner, size = rng.uniform(-6, 2, 3), rng.uniform(1, 12, 3)
    update["workspace"] = (Box(lower=tuple(corner), upper=tuple(corner + size)) if rng.random() < 0.25 else None)
    update["ground"] = float(rng.uniform(-3, 0.5)) if rng.random() < 0.5 or machine.footprint else None
    update["obstacles"] = tuple(
        Obstacle(name=f"ball{k}", link="base", centre=tuple(rng.uniform(-5, 5, 3)), radius=float(rng.uniform(0.2, 3)))
        for k in range(rng.integers(0, 3)))
    if machine.footprint is not None:
        update["footprint"] = machine.footprint.model_copy(update={"mass": machine.footprint.mass * weight})
    return machine.model_copy(update=update)


def _maybe(rng: np.random.Generator, low: float, high: float) -> float | None:
    """A number between two, spread over their orders of magnitude, or none."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high)))) if rng.random() < 0.7 else None


def outcomes(seeds: range) -> list[Outcome]:
    """Of the settings of some seeds."""
    native.FEW = 10**9  # every setting is another function; CasADi's own machine is quicker for so few samples
    return [outcome(seed) for seed in seeds]


def outcome(seed: int) -> Outcome:
    """Design a short motion for a random machine, then look at it."""
    rng = np.random.default_rng(seed)
    machine = random_machine(rng)
    model = Model(machine)
    time = float(rng.uniform(2, 6))
    basis = (Fourier(time, int(rng.integers(1, 4)), blend=float(rng.uniform(0.3, 2))) if rng.random() < 0.5
             else Spline(time, int(rng.integers(3, 8))))
    resting = {}
    if len(machine.joints) > 1 and rng.random() < 0.3:
        joint = str(rng.choice(machine.joints))
        resting[joint] = float(rng.uniform(*machine.link(joint).joint.range))
    limits = Limits(model)
    try:
        program = excitation_problem(machine, basis, criterion=str(rng.choice(CRITERIA)), rate=RATE, resting=resting)
        found = design(program, starts=1, seed=seed, search_seconds=0.5)
    except ProblemError as error:
        q = random_states(model, 20_000, rng)[0]
        for joint, at in resting.items():
            q[:, machine.joints.index(joint)] = at
        if "tried" in str(error):  # not even a slight motion is possible, though rest is
            return Outcome((), False, str(error), False)
        possible = np.max(limits.excess(limits.values(q, 0 * q, 0 * q)), axis=1) <= 0
        return Outcome((), False, str(error), bool(np.any(possible)))
    return Outcome(tuple(broken(model, found)), bool(np.max(np.abs(found.trajectory.qd)) > 1e-6), "", False)


def broken(model: Model, found: Excitation) -> list[str]:
    """Names of limits that the motion breaks, computed anew from the trajectory and the machine alone."""
    machine, path = model.machine, found.trajectory
    names = []

    def check(name: str, values: np.ndarray, low: float | None, high: float | None) -> None:
        size = EXACT * max(abs(low or 0), abs(high or 0), 1e-3)
        if (low is not None and np.min(values) < low - size) or (high is not None and np.max(values) > high + size):
            names.append(name)

    def reserved(most: float | None) -> float | None:
        return None if most is None else (1 - found.problem.limits.reserves.pressure) * most

    for k, joint in enumerate(machine.joints):
        own = machine.link(joint).joint
        check(f"{joint} position", path.q[:, k], *own.range)
        for what, values, most in (("speed", path.qd, own.max_speed), ("acceleration", path.qdd, own.max_acceleration)):
            check(f"{joint} {what}", np.abs(values[:, k]), None, most)
    if max(np.max(np.abs(path.qd[[0, -1]])), np.max(np.abs(path.qdd[[0, -1]]))) > 1e-6:
        names.append("rest at the ends")
    length, speed = (part[:, :, 0] for part in model.over(model.cylinder_kinematics, path.q, path.qd, path.qdd)[:2])
    log = simulate(model, path, noise=False)
    flow = np.zeros(len(path.t))
    for k, c in enumerate(machine.cylinders):
        check(f"{c.name} stroke", length[:, k], c.dead_length, c.dead_length + c.stroke)
        check(f"{c.name} speed", np.abs(speed[:, k]), None, c.max_speed)
        flow += np.where(speed[:, k] > 0, c.areas[0], -c.areas[1]) * speed[:, k]
        for chamber in ("p_head", "p_rod"):
            check(f"{c.name} {chamber}", log.channel(f"{c.name}.{chamber}"), None,
                  reserved(c.relief_pressure))
    force = synthetic.forces(model, path, model.parameters.nominal)
    for k, actuator in enumerate(machine.actuators):
        if actuator in machine.motors:
            flow += np.abs(actuator.torque_per_pressure * actuator.gear * path.qd[:, k])
            for chamber in ("p_a", "p_b"):
                check(f"{actuator.name} {chamber}", log.channel(f"{actuator.name}.{chamber}"), None,
                      reserved(actuator.relief_pressure))
        elif actuator in machine.drives:
            check(f"{actuator.name} torque", np.abs(force[:, k]), None,
                  reserved(actuator.max_torque))
    check("pump flow", flow, None, machine.pump.max_flow if machine.pump else None)
    ends = [pose[:, :3, 3] for pose in model.over(model.forward_kinematics, path.q)]
    if machine.workspace:
        for k in range(3):
            check("workspace", ends[-1][:, k], machine.workspace.lower[k], machine.workspace.upper[k])
    if machine.ground is not None:
        for link, end in zip(machine.links, ends, strict=True):
            if np.ptp(end[:, 2]) > 1e-9:
                check(f"{link.name} above ground", end[:, 2], machine.ground, None)
    for obstacle in machine.obstacles:
        check(f"distance to {obstacle.name}", np.linalg.norm(ends[-1] - obstacle.centre, axis=1), obstacle.radius, None)
    tipping = [use for use in found.limits if use.name.startswith("tipping")]
    return names + [use.name for use in tipping if use.room < 0]
