"""What neglecting a bucket linkage costs: its bodies left out, and a straight cylinder in the place of the linkage."""

import numpy as np
from scipy.optimize import least_squares

from hydroopt import Model, identification_problem, load_machine, random_trajectory, random_truth, simulate, solve
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Fourier
from hydroopt.machine.machine import Machine
from hydroopt.model.over_range import lever_arms
from hydroopt.simulation.simulate import forces
from studies import show

PERIOD, RATE, TRUTHS = 33.28, 25.0, (1, 2, 3)
LINKAGE, CYLINDER = ("rocker", "coupler"), "bucket_cylinder"


def run() -> dict:
    """Forces of the linkage's bodies, and unseen bucket forces by three models of one excavator."""
    machine = load_machine("excavator_bucket")
    machines = {"linkage": machine, "massless": machine.without_bodies(LINKAGE), "straight": straight(machine)}
    return weights(machine, machines["massless"]) | lever_arm_errors(machines) | unseen(machines)


def straight(machine: Machine) -> Machine:
    """The machine whose bucket cylinder acts on the bucket directly, at the pins whose lever arm is most like its own.

    Barrel and rod may be pinned anywhere; dead length and stroke follow. Its bodies are the true cylinder's.
    """
    q, arm = bucket_arm(machine)

    def arms(pins: np.ndarray) -> np.ndarray:
        barrel, rod = pins[:2] - [machine.link("stick").joint.a, 0.0], pins[2:]
        turned = np.stack([np.cos(q) * rod[0] - np.sin(q) * rod[1], np.sin(q) * rod[0] + np.cos(q) * rod[1]])
        along = turned - barrel[:, None]
        length = np.linalg.norm(along, axis=0)
        return (turned[0] * along[1] - turned[1] * along[0]) / length, length

    fits = [least_squares(lambda pins: arms(pins)[0] / arm - 1, start) for start in (
        (0.2, 0.8, -0.2, 0.6), (0.2, 0.8, -0.6, 0.2), (1.0, 1.5, 0.1, 0.6), (1.5, 0.8, -0.3, 0.5))]
    pins = min(fits, key=lambda fit: fit.cost).x
    length = arms(pins)[1]
    data = machine.model_dump(exclude={"notes"})
    data["links"] = [link for link in data["links"] if link["name"] not in LINKAGE]
    data["loops"] = []
    cylinder = next(each for each in data["cylinders"] if each["name"] == CYLINDER)
    cylinder["barrel"]["pin"], cylinder["rod"]["pin"] = (*pins[:2], 0.0), (*pins[2:], 0.0)
    cylinder["rod"]["link"] = "bucket"
    cylinder |= {"dead_length": float(length.min()) - 0.01, "stroke": float(np.ptp(length)) + 0.02}
    notes = {path: note for path, note in machine.notes.items()
             if not path.startswith((*LINKAGE, "bucket_linkage", f"{CYLINDER}.rod.pin", f"{CYLINDER}.barrel.pin"))}
    return Machine.model_validate({**data, "notes": notes})


def bucket_arm(machine: Machine) -> tuple[np.ndarray, np.ndarray]:
    """Angles (N,) [rad] over the bucket's range and the lever arm (N,) [m] of its cylinder."""
    curve = next(each for each in lever_arms(Model(machine)) if each.subject == CYLINDER)
    return curve.position, curve.value


def weights(machine: Machine, massless: Machine) -> dict:
    """RMS of each force, of the part that the linkage's bodies make, and of what no other body can take over."""
    complete, without = Model(machine), Model(massless)
    motions = [random_trajectory(complete, duration=PERIOD, rate=RATE, seed=seed) for seed in range(5)]
    sigma, found = force_noise(complete), []
    for motion in motions:
        force = forces(complete, motion, complete.parameters.nominal)
        part = force - forces(without, motion, without.parameters.nominal)
        K = without.over(without.regressor, motion.q, motion.qd, motion.qdd)[0] / sigma[:, None]
        rows = K.reshape(-1, K.shape[2])
        size = np.maximum(np.linalg.norm(rows, axis=0), 1e-9)
        left = part - K @ (np.linalg.lstsq(rows / size, (part / sigma).ravel(), rcond=1e-10)[0] / size) * sigma
        found.append(np.sqrt(np.mean(np.square([force, part, left]), axis=1)))
    force, part, left = np.median(found, axis=0)
    rows = [(each.name, force[k], part[k], f"{part[k] / force[k]:.1%}", part[k] / sigma[k], left[k] / sigma[k])
            for k, each in enumerate(machine.balances)]
    show.table("Bodies of rocker and coupler left out, RMS, medians of 5 motions",
               ("actuator", "force", "neglected", "part", "in sigma", "refitted, in sigma"), rows)
    results: dict = {}
    for name, _, _, _, neglected, refitted in rows:
        results |= {f"{name}_neglected_sigmas": round(float(neglected), 3),
                    f"{name}_refitted_sigmas": round(float(refitted), 4)}
    return results | {f"{CYLINDER}_neglected_part": round(float(part[-1] / force[-1]), 4)}


def lever_arm_errors(machines: dict[str, Machine]) -> dict:
    """Least and greatest error of the straight cylinder's lever arm over the bucket's range."""
    (_, true), (_, other) = bucket_arm(machines["linkage"]), bucket_arm(machines["straight"])
    error = other / true - 1
    return {"lever_arm_error_min": round(float(error.min()), 3), "lever_arm_error_max": round(float(error.max()), 3)}


def unseen(machines: dict[str, Machine]) -> dict:
    """Error of unseen bucket forces without noise by each model, as a part of the force; medians over true machines."""
    complete = Model(machines["linkage"])
    found: dict[str, list[float]] = {name: [] for name in machines}
    status: dict[str, list[str]] = {name: [] for name in machines}
    for seed in TRUTHS:
        truth = random_truth(complete, seed)
        motions = [random_trajectory(complete, duration=PERIOD, rate=RATE, seed=10 * seed + k) for k in (1, 2)]
        log = without_lengths(simulate(complete, motions[0], truth, seed=seed))
        force = forces(complete, motions[1], truth)[:, -1]
        for name, machine in machines.items():
            answer = solve(identification_problem(machine, [log], smoothing=Fourier(PERIOD, 20)))
            predicted = forces(answer.problem.model, motions[1], answer.psi)[:, -1]
            found[name].append(float(np.sqrt(np.mean((predicted - force) ** 2) / np.mean(force**2))))
            status[name].append(answer.status)
    median = {name: float(np.median(values)) for name, values in found.items()}
    show.table("Unseen bucket force without noise, error as a part of it",
               ("model", "median", "least", "greatest", "status"),
               [(name, f"{median[name]:.2%}", f"{min(values):.2%}", f"{max(values):.2%}", ", ".join(status[name]))
                for name, values in found.items()])
    return {f"{name}_unseen": round(value, 4) for name, value in median.items()} | {
        "straight_suspect": sum(each != "ok" for each in status["straight"])}


def without_lengths(log: Log) -> Log:
    """The log of a machine without length sensors, whose lengths would contradict the straight cylinder at once."""
    kept = {name: values for name, values in log.channels.items() if not name.endswith(".length")}
    return Log(log.name, log.t, kept, units={name: log.units[name] for name in kept})


if __name__ == "__main__":
    print(run())
