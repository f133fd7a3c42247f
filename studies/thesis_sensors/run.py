"""Tables 14 and 15: what sensors to ±5 and ±25 psi tell, identified as the thesis did and by the default method."""

from dataclasses import replace
from itertools import product

import numpy as np
from matplotlib.figure import Figure

from hydroopt import (
    IdentificationProblem,
    Machine,
    Model,
    identification_problem,
    load_machine,
    random_trajectory,
    simulate,
    solve,
)
from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.inference.identifiability import RANK_TOLERANCE
from hydroopt.estimation.inference.least_squares import truncated_svd
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.plots.figures import BLUE, GREEN, GREY, INK, ORANGE
from hydroopt.simulation.simulate import Trajectory, forces
from studies import show, thesis

SEEDS = 5
TABLES = {"complete": thesis.TABLE_14, "reduced": thesis.TABLE_15}
ACCURACIES = (5, 25)
"""Of the pressure transducers [psi], in the order of the tables."""

KEY_ROWS = ("boom_cylinder.barrel.m", "boom_cylinder.rod.m", "stick_cylinder.barrel.m", "stick_cylinder.rod.m",
            "boom.mc_x", "stick.mc_x", "boom_cylinder.rod.mc_x", "stick_cylinder.rod.mc_x", "boom_cylinder.rod.I_xx",
            "swing.I_zz", "stick.I_zz", "swing_motor.tau_coulomb", "boom.tau_coulomb", "stick.tau_coulomb",
            "swing_motor.tau_offset", "boom_cylinder.f_offset", "stick_cylinder.f_offset")

_BODIES = Model(load_machine("cat215b", parameter_set="thesis_literal")).parameters
STATED = {name for name, value in zip(_BODIES.names, _BODIES.nominal, strict=True) if value}
"""Parameters that Table 13 does not put at zero."""


class Case:
    """One truth with what it is judged by: forces of an unseen motion and the size of each parameter."""

    def __init__(self, parameter_set: str) -> None:
        self.machine = load_machine("cat215b", parameter_set=parameter_set)
        self.model = Model(self.machine)
        self.equipped = {accuracy: Model(with_transducers(self.machine, accuracy)) for accuracy in ACCURACIES}
        parameters = self.model.parameters
        self.truth = parameters.nominal
        self.sigma = force_noise(self.model)  # of ±25 psi, whatever the case at hand has
        self.unseen = random_trajectory(self.model, duration=30, rate=50, seed=10_000)
        self.forces = self.regressor(self.model) @ self.truth
        # of a body's numbers: the largest of mass, first moments or inertias; else the machine file's sigma
        body = np.array([name.rpartition(".")[2][0] in "mI" for name in parameters.names])
        self.size = np.where(body, parameters.scale / 0.2, parameters.scale)

    def regressor(self, model: Model) -> np.ndarray:
        """K (N, n, p) of the unseen motion."""
        return model.over(model.regressor, self.unseen.q, self.unseen.qd, self.unseen.qdd)[0]

    def judged(self, model: Model, psi: np.ndarray, names: tuple[str, ...]) -> dict:
        """Errors of forces [σ] and of the named parameters [their sizes], number of negative masses."""
        error = np.sqrt(np.mean((self.regressor(model) @ psi - self.forces) ** 2, axis=0)) / self.sigma
        values = dict(zip(names, psi[model.parameters.select(names)].tolist(), strict=True))
        masses = psi[[k for k, name in enumerate(model.parameters.names) if name.endswith(".m")]]
        return {"unseen": error, "values": values, "off": self.off(values), "negative_masses": int(np.sum(masses < 0))}

    def off(self, values: dict[str, float]) -> dict[str, float]:
        """Errors of parameters [their sizes]."""
        k = self.model.parameters.select(values)
        return dict(zip(values, np.abs(list(values.values()) - self.truth[k]) / self.size[k], strict=True))


def run() -> dict:
    """Errors of parameters and of predicted forces, medians over the seeds, beside the thesis's."""
    literal, consistent = Case("thesis_literal"), Case("consistent")
    found: dict[tuple[str, int, str], list[dict]] = {}
    for model, accuracy, seed in product(TABLES, ACCURACIES, range(SEEDS)):
        judgements = [*as_thesis(literal, model, accuracy, seed), *ours(consistent, model, accuracy, seed)]
        for how, judged in judgements:
            found.setdefault((model, accuracy, how), []).append(judged)
    results: dict = table_15(literal)
    for k, actuator in enumerate(literal.machine.actuators):
        results[f"force_sigma_thesis_{actuator.name}"] = round(thesis.SENSOR_ERROR[k] / np.sqrt(3))
        results[f"force_sigma_ours_{actuator.name}"] = round(float(literal.sigma[k]))
    for (model, accuracy, how), some in found.items():
        key = f"{model}_{accuracy}_psi_{how}"
        for actuator, value in zip(literal.machine.actuators, median(some, "unseen"), strict=True):
            results[f"{key}_unseen_{actuator.name}"] = round(float(value), 3)
        results[f"{key}_parameters_off"] = typical(some)
        results[f"{key}_negative_masses"] = float(median(some, "negative_masses"))
        if "impossible_bodies" in some[0]:
            results[f"{key}_impossible_bodies"] = int(max(one["impossible_bodies"] for one in some))
    for model, table in TABLES.items():
        for which, accuracy in enumerate(ACCURACIES):
            printed = {name: values[which] for name, values in table.items()}
            results[f"{model}_{accuracy}_psi_thesis_parameters_off"] = typical([{"off": literal.off(printed)}])
    report(literal, consistent, found, results)
    for model in TABLES:
        draw(literal, found, model)
    return results


def as_thesis(case: Case, model: str, accuracy: int, seed: int) -> list[tuple[str, dict]]:
    """Least squares on the thesis's columns (Eq. 4.58, 4.60), with three readings of what the angles' noise does, and
    with its noise of forces beside ours.
    """
    names = tuple(TABLES[model])
    problem, motion = simulated(case, case.equipped[accuracy].machine, model, accuracy, seed)
    (smooth,) = problem.experiments
    q = np.column_stack([smooth.log.channel(f"{joint}.q") for joint in case.machine.joints])
    qd = np.gradient(q, motion.t, axis=0)
    readings = {"smoothed": smooth, "angles_only": moved(smooth, q, motion.qd, motion.qdd),
                "differences": moved(smooth, q, qd, np.gradient(qd, motion.t, axis=0))}
    # the thesis adds noise to the forces, both chambers' errors at their largest summed, instead of to each pressure
    limit = np.array(thesis.SENSOR_ERROR) * accuracy / 25
    force = forces(case.model, motion, case.truth)
    force = force + np.random.default_rng(1000 + seed).uniform(-limit, limit, force.shape)
    readings |= {f"thesis_noise_{how}": replace(readings[how], force=force) for how in ("smoothed", "angles_only")}
    found = {how: thesis.identified(replace(problem, experiments=(data,)), names) for how, data in readings.items()}
    return [(how, case.judged(problem.model, psi, names)) for how, psi in found.items()]


def moved(data: Experiment, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> Experiment:
    """The experiment with another motion, all of whose samples count as moving."""
    return replace(data, motion=replace(data.motion, q=q, qd=qd, qdd=qdd), known=np.ones_like(data.known))


def ours(case: Case, model: str, accuracy: int, seed: int) -> list[tuple[str, dict]]:
    """What was known beforehand (as badly as the machine file says), base parameters, and the default method."""
    problem, _ = simulated(case, misjudged(case.equipped[accuracy].machine, seed), model, accuracy, seed)
    names = tuple(TABLES[model])
    estimates = {how: solve(problem, how) for how in ("wls", "sdp")}
    return [("known", case.judged(problem.model, problem.parameters.nominal, names)),
            *((how, case.judged(problem.model, estimate.psi, names)
               | {"impossible_bodies": sum(smallest <= 0 for smallest in estimate.consistency.values())})
              for how, estimate in estimates.items())]


def simulated(case: Case, known: Machine, model: str, accuracy: int,
              seed: int) -> tuple[IdentificationProblem, Trajectory]:
    """A complete machine's log of 1664 samples as a problem of the machine as it is known, and its true motion."""
    motion = random_trajectory(case.model, duration=33.28, rate=50, seed=100 + seed)
    log = simulate(case.equipped[accuracy], motion, case.truth, seed=seed)
    return identification_problem(known, [log], actuator_inertia=model == "complete"), motion


def with_transducers(machine: Machine, accuracy: float) -> Machine:
    """The machine with all pressures read to ±accuracy [psi] instead of ±25."""
    data = machine.model_dump()
    for sensor in data["sensors"]:
        if any(".p_" in channel for channel in sensor["channels"]):
            sensor["accuracy"] *= accuracy / 25
    return type(machine).model_validate(data)


def misjudged(machine: Machine, seed: int) -> Machine:
    """The machine as known beforehand: masses and inertias off by 20 %, places by 0.1 or 0.2 m, as its file says."""
    rng = np.random.default_rng(seed)
    data = machine.model_dump()
    holders = [*data["links"], *(cylinder[end] for cylinder in data["cylinders"] for end in ("barrel", "rod"))]
    for body in (holder["body"] for holder in holders):
        if body["com"] is None:
            body["mc"] = tuple((np.array(body["mc"]) * rng.normal(1, 0.2)).tolist())
        else:
            body["com"] = tuple((body["com"] + rng.normal(0, 0.2 if body["m"] > 1000 else 0.1, 3)).tolist())
        body["m"] *= rng.normal(1, 0.2)
        key = "inertia" if body["inertia_com"] is None else "inertia_com"
        body[key] = tuple((np.array(body[key]) * rng.normal(1, 0.2)).tolist())
    return type(machine).model_validate(data)


def noise_free(case: Case, model: str, forces_of: str = "complete") -> dict[str, float]:
    """What the thesis's columns give for exact motion and exact forces of the complete or the reduced model."""
    motion = random_trajectory(case.model, duration=33.28, rate=50, seed=100)
    fitted, forced = (Model(case.machine, actuator_inertia=some == "complete") for some in (model, forces_of))
    K = fitted.over(fitted.regressor, motion.q, motion.qd, motion.qdd)[0].reshape(-1, len(fitted.parameters))
    names = list(TABLES[model])
    right = forces(forced, motion, forced.parameters.nominal).ravel()
    values = truncated_svd(K[:, fitted.parameters.select(names)], right, RANK_TOLERANCE)[0]
    return dict(zip(names, values.tolist(), strict=True))


def table_15(case: Case) -> dict:
    """How near Table 15 at ±5 psi is to what its columns give without noise, and of which model's forces that is."""
    full, bare = (noise_free(case, "reduced", of) for of in TABLES)
    told = ("stick.m", "stick.mc_x", "stick.I_xx", "stick.I_zz", "swing.I_zz")
    moments = ("boom.mc_x", "boom.mc_y", "stick.mc_x", "stick.mc_y")
    printed = {name: values[0] for name, values in thesis.TABLE_15.items()}
    return {"table_15_off_noise_free": round(max(abs(printed[name] / full[name] - 1) for name in told), 3),
            "table_15_moments_nearer_to_complete": sum(abs(printed[name] - full[name]) < abs(printed[name] - bare[name])
                                                       for name in moments)}


def median(some: list[dict], key: str) -> np.ndarray:
    return np.median([one[key] for one in some], axis=0)


def typical(some: list[dict]) -> float:
    """Median over the seeds of the median error of the parameters that Table 13 does not put at zero."""
    each = [np.median([error for name, error in one["off"].items() if name in STATED]) for one in some]
    return float(f"{np.median(each):.3g}")


def sizes(some: list[dict], name: str) -> float:
    """Median of the absolute value of a parameter."""
    return float(np.median([abs(one["values"][name]) for one in some]))


def report(literal: Case, consistent: Case, found: dict, results: dict) -> None:
    """Print the thesis's values next to ours."""
    for model, table in TABLES.items():
        exact, bare = noise_free(literal, model), noise_free(literal, model, "reduced")
        show.table(f"{model} model: Table {14 if model == 'complete' else 15}, and ours on the same columns, angles "
                   f"smoothed (median absolute value over {SEEDS} seeds); SI",
                   ("parameter", "Table 13", "noise-free", "noise-free, no jacks",
                    *(f"±{accuracy} psi: {who}" for accuracy in ACCURACIES for who in ("thesis", "ours"))),
                   [(name, float(literal.truth[literal.model.parameters.index(name)]), exact[name], bare[name],
                     *(value for which, accuracy in enumerate(ACCURACIES)
                       for value in (table[name][which], sizes(found[model, accuracy, "smoothed"], name))))
                    for name in (KEY_ROWS if model == "complete" else table)])
    parameters = consistent.model.parameters
    show.table("Complete model by the default method: median error in the size of the parameter",
               ("parameter", "truth", "size", "known beforehand", *(f"±{accuracy} psi" for accuracy in ACCURACIES)),
               [(name, float(consistent.truth[k]), float(consistent.size[k]),
                 *(float(np.median([one["off"][name] for one in found["complete", accuracy, how]]))
                   for accuracy, how in ((25, "known"), *((accuracy, "sdp") for accuracy in ACCURACIES))))
                for name, k in zip(KEY_ROWS, parameters.select(KEY_ROWS), strict=True)])

    def summary(model: str, accuracy: int, how: str) -> tuple:
        key = f"{model}_{accuracy}_psi_{how}_"
        if how != "thesis":
            return (results[f"{key}negative_masses"], results.get(f"{key}impossible_bodies", "-"),
                    *(results[f"{key}unseen_{a.name}"] for a in literal.machine.actuators))
        column = ACCURACIES.index(accuracy)
        below = sum(values[column] < 0 for name, values in TABLES[model].items() if name.endswith(".m"))
        return below, *("-" * 4)

    methods = ("thesis", "differences", "smoothed", "thesis_noise_smoothed", "angles_only", "thesis_noise_angles_only",
               "known", "wls", "sdp")
    show.table("Parameters off (median, in their sizes), negative masses, impossible bodies at worst, unseen forces",
               ("model", "pressures", "method", "parameters off", "negative masses", "impossible bodies",
                *(f"{a.name} [σ]" for a in literal.machine.actuators)),
               [(model, f"±{accuracy} psi", how, results[f"{model}_{accuracy}_psi_{how}_parameters_off"],
                 *summary(model, accuracy, how))
                for model, accuracy, how in product(TABLES, ACCURACIES, methods)])


def draw(case: Case, found: dict, model: str) -> None:
    """Error of every kept parameter: the thesis's, the same columns', and the default method's."""
    names = list(TABLES[model])
    with show.look():
        figure = Figure(figsize=(11, 1.4 + 0.165 * len(names)), layout="constrained")
        axes = figure.subplots(1, 2, sharey=True, sharex=True)
        for which, (ax, accuracy) in enumerate(zip(axes, ACCURACIES, strict=True)):
            printed = case.off({name: TABLES[model][name][which] for name in names})
            marks = [("thesis", INK, "x", [printed[name] for name in names])]
            for how, label, colour, marker in (("differences", "the thesis's columns, angles not smoothed", GREY, "."),
                                               ("smoothed", "the thesis's columns, smoothed", ORANGE, "o"),
                                               ("sdp", "default (sdp)", BLUE, "s")):
                some = found[model, accuracy, how]
                marks.append((label, colour, marker, [np.median([one["off"][name] for one in some]) for name in names]))
            for label, colour, marker, values in marks:
                ax.plot(np.maximum(values, 1e-4), np.arange(len(names)), ls="none", marker=marker, ms=4, color=colour,
                        label=label)
            ax.axvspan(1e-4, 0.2, color=GREEN, alpha=0.12, lw=0, label="within 20 %, as known beforehand")
            ax.axvline(1, color=GREY, lw=0.8, label="as large as the parameter")
            ax.set(xscale="log", xlim=(1e-4, 3e6), title=f"{model} model, pressures to ±{accuracy} psi",
                   xlabel="error / size of the parameter [-]")
            ax.xaxis.set_major_formatter("{x:g}")
        axes[0].set_yticks(np.arange(len(names)), names, fontsize=7)
        axes[0].set_ylim(len(names), -1)
        figure.legend(handles=axes[0].get_legend_handles_labels()[0], loc="outside upper center", ncols=3)
    show.save(figure, "thesis_sensors", model)
