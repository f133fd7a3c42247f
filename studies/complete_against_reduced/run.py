"""Figure 33: forces of the CAT 215B with and without barrels and rods, what the links' parameters can take over, and
what the two readings of Table 1 do to forces and to tipping.
"""

import numpy as np
from matplotlib.figure import Figure

from hydroopt import Model, load_machine, random_trajectory
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.machine.geometry import Geometry
from hydroopt.plots.figures import BLUE, GREY, INK, ORANGE
from hydroopt.simulation.simulate import Trajectory, forces
from studies import show

SETS = ("thesis_literal", "consistent")
MOTIONS = 10
FACTS = ("force", "neglected", "static", "dynamic", "refitted")


def run() -> dict:
    """RMS over time of each actuator's force and of its neglected part, as medians over the motions."""
    results: dict = {}
    for name in SETS:
        machine = load_machine("cat215b", parameter_set=name)
        complete, reduced = Model(machine), Model(machine, actuator_inertia=False)
        motions = [random_trajectory(complete, duration=33.28, rate=50, seed=seed) for seed in range(MOTIONS)]
        found, turned = (np.median([facts(complete, reduced, motion, psi) for motion in motions], axis=0)
                         for psi in (complete.parameters.nominal, with_rods_turned(complete)))
        rows = []
        for k, (actuator, unit, sigma) in enumerate(zip(machine.actuators, complete.force_units,
                                                        force_noise(complete), strict=True)):
            here = dict(zip(FACTS, found[:, k].tolist(), strict=True))
            part = here["neglected"] / here["force"]
            rows.append((actuator.name, unit, *here.values(), f"{part:.1%}", float(here["neglected"] / sigma),
                         float(turned[1, k])))
            results |= {f"{name}_{actuator.name}_{key}": float(f"{value:.4g}") for key, value in here.items()}
            results |= {f"{name}_{actuator.name}_part": round(part, 3),
                        f"{name}_{actuator.name}_refitted_sigmas": round(float(here["refitted"] / sigma), 3),
                        f"{name}_{actuator.name}_neglected_with_rods_turned": round(float(turned[1, k]))}
        show.table(f"Parameters '{name}': RMS over 33.28 s, median of {MOTIONS} motions",
                   ("actuator", "unit", "force", "neglected", "of that static", "of that dynamic",
                    "left by the best reduced model", "neglected / force", "neglected in σ of the sensors",
                    "neglected if rods lie between their pins"), rows)
        peaks, beyond = (np.median(part, axis=0) for part in zip(
            *(ratios(complete, reduced, motion) for motion in motions), strict=True))
        for k, actuator in enumerate(machine.actuators):
            results |= {f"{name}_{actuator.name}_peak_ratio": round(float(peaks[k]), 3),
                        f"{name}_{actuator.name}_beyond_twofold": round(float(beyond[k]), 3)}
        draw(complete, reduced, motions[0], name)
        results[f"{name}_lagrange_disagreement"] = disagreement(complete, reduced, motions[0])
    return results | readings_of_table_1()


def ratios(complete: Model, reduced: Model, motion: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Peak force of the reduced by that of the complete model (n,), and the part of time in which they differ beyond
    twofold (n,): "a factor of two or more" (Section 5.2)."""
    force, without, _ = parts(complete, reduced, motion, complete.parameters.nominal)
    each = np.abs(without) / np.maximum(np.abs(force), 1e-9)
    return np.max(np.abs(without), axis=0) / np.max(np.abs(force), axis=0), np.mean((each > 2) | (each < 0.5), axis=0)


def readings_of_table_1() -> dict:
    """Static forces in random postures, and where the weight stands, by both readings of Table 1.

    The centre of pressure [m] is that of tracks and links before the swing's axis, the arm stretched to the front at
    rest; beyond 1.65 m the machine tips over.
    """
    machines = {name: load_machine("cat215b", parameter_set=name) for name in ("consistent", "table_1_upwards")}
    models = {name: Model(machine, actuator_inertia=False) for name, machine in machines.items()}
    low, high = np.array([link.joint.range for link in machines["consistent"].links]).T
    q = np.random.default_rng(0).uniform(low, high, (2000, 3))
    still = Trajectory(np.arange(2000.0), q, 0 * q, 0 * q)
    force = {name: forces(model, still, model.parameters.nominal) for name, model in models.items()}
    apart = np.sqrt(np.mean((force["table_1_upwards"] - force["consistent"]) ** 2, axis=0))
    size = np.sqrt(np.mean(force["consistent"] ** 2, axis=0))
    results = {f"table_1_{actuator.name}_static_difference": round(float(apart[k] / size[k]), 4)
               for k, actuator in enumerate(machines["consistent"].actuators) if size[k] > 1}
    stretched = {"boom": np.radians(-10), "stick": np.radians(35)}
    for name, machine in machines.items():
        geometry, moment, mass = Geometry(machine), 0.0, machine.footprint.mass
        for link in machine.links:
            pose = geometry.relative_pose("base", link.name, stretched)
            moment += float(pose.point(link.body.phi[1:4] / link.body.m)[0]) * link.body.m
            mass += link.body.m
        results[f"table_1_{name}_centre_of_pressure_m"] = round(moment / mass, 3)
    show.table("Table 1 read in two ways", ("quantity", "value"), list(results.items()))
    return results


def with_rods_turned(model: Model) -> np.ndarray:
    """Table 13 with the rods' centres of mass between the two pins, where a rod lies, instead of beyond its own."""
    psi = model.parameters.nominal.copy()
    psi[model.parameters.select([f"{c.name}.rod.mc_x" for c in model.machine.cylinders])] *= -1
    return psi


def parts(complete: Model, reduced: Model, motion: Trajectory,
          psi: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Forces of the complete and of the reduced model and the static part of their difference, (N, n) each."""
    still = Trajectory(motion.t, motion.q, 0 * motion.qd, 0 * motion.qdd)
    own = reduced.parameters.nominal
    return (forces(complete, motion, psi), forces(reduced, motion, own),
            forces(complete, still, psi) - forces(reduced, still, own))


def facts(complete: Model, reduced: Model, motion: Trajectory, psi: np.ndarray) -> np.ndarray:
    """RMS (5, n) of `FACTS`; the last is what the reduced model leaves at its best parameters."""
    force, without, static = parts(complete, reduced, motion, psi)
    sigma = force_noise(complete)
    K = reduced.over(reduced.regressor, motion.q, motion.qd, motion.qdd)[0] / sigma[:, None]
    rows = K.reshape(-1, K.shape[2])
    size = np.maximum(np.linalg.norm(rows, axis=0), 1e-9)
    best = np.linalg.lstsq(rows / size, (force / sigma).ravel(), rcond=1e-10)[0] / size
    left = force - K @ best * sigma
    return np.sqrt(np.mean(np.square([force, force - without, static, force - without - static, left]), axis=1))


def disagreement(complete: Model, reduced: Model, motion: Trajectory) -> float:
    """Largest difference [N, N·m] between the neglected part by Newton-Euler and from the bodies' energies."""
    force, without, _ = parts(complete, reduced, motion, complete.parameters.nominal)
    with_, bare = (model.over(model.lagrange_forces, motion.q, motion.qd, motion.qdd, model.parameters.nominal)[0]
                   for model in (complete, reduced))
    return float(np.max(np.abs(force - without - (with_ - bare)[:, :, 0])))


def draw(complete: Model, reduced: Model, motion: Trajectory, name: str) -> None:
    """Both models' forces on the left, as in Figure 33, and their difference on the right."""
    force, without, static = parts(complete, reduced, motion, complete.parameters.nominal)
    with show.look():
        figure = Figure(figsize=(11, 6.2), layout="constrained")
        axes = figure.subplots(len(complete.machine.actuators), 2, sharex=True)
        for k, (actuator, unit) in enumerate(zip(complete.machine.actuators, complete.force_units, strict=True)):
            left, right = axes[k]
            label = "torque [kN·m]" if unit == "N*m" else "force [kN]"
            for ax, values, line in ((left, force, {"color": INK, "label": "complete model"}),
                                     (left, without, {"color": ORANGE, "label": "reduced: no barrels, no rods"}),
                                     (right, force - without, {"color": BLUE, "label": "neglected: their difference"}),
                                     (right, static, {"color": GREY, "ls": "--", "label": "of that weight, at rest"})):
                ax.plot(motion.t, values[:, k] / 1e3, lw=1.3, **line)
            left.set(title=actuator.name, ylabel=label)
            right.set(title=f"{actuator.name}: neglected part", ylabel=label)
        for ax in axes[-1]:
            ax.set(xlabel="time [s]", xlim=(0, motion.t[-1]))
        handles = [*axes[0][0].lines, *axes[0][1].lines]
        figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    show.save(figure, "complete_against_reduced", name)
