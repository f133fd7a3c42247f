"""Tables 16, 17 and the RMS of Section 4.6: five runs of 1664 samples, another motion predicted."""

import numpy as np
from matplotlib.figure import Figure

from hydroopt import (
    IdentificationProblem,
    Machine,
    Model,
    identification_problem,
    load_machine,
    random_trajectory,
    random_truth,
    simulate,
    solve,
)
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.plots.figures import BLUE, GREEN, GREY, INK, ORANGE
from hydroopt.simulation.simulate import Trajectory, forces
from studies import show, thesis

SEEDS = 5
LENGTHS = (333, 333, 333, 333, 332)
"""Samples of the five runs, 1664 together."""

TABLES = {"complete": thesis.TABLE_16, "reduced": thesis.TABLE_17}
KEY_ROWS = ("boom_cylinder.barrel.m", "boom_cylinder.rod.m", "stick_cylinder.barrel.m", "stick_cylinder.rod.m",
            "boom.mc_x", "stick.mc_x", "swing.I_zz", "stick.I_zz", "swing_motor.tau_coulomb", "boom.tau_coulomb",
            "stick.tau_coulomb", "swing_motor.tau_offset", "boom_cylinder.f_offset", "stick_cylinder.f_offset")


def run() -> dict:
    """RMS of predicted forces against measured and noise-free ones, and negative masses; medians over truths."""
    machine = load_machine("cat215b")
    model = Model(machine)
    noise = force_noise(model)
    found: dict[tuple[str, str], list[dict]] = {}
    for seed in range(SEEDS):
        truth = random_truth(model, seed)
        runs = [simulate(model, window(model, 100 * seed + k, samples), truth, seed=10 * seed + k, name=f"run {k + 1}")
                for k, samples in enumerate(LENGTHS)]
        motion = random_trajectory(model, duration=33.28, rate=50, seed=1000 + seed)
        unseen = simulate(model, motion, truth, seed=99 + seed, name="unseen")
        exact = forces(model, motion, truth)
        for kind in TABLES:
            problem = identification_problem(machine, runs, [unseen], actuator_inertia=kind == "complete")
            for how, judged in identified(problem, kind, motion, exact).items():
                found.setdefault((kind, how), []).append(judged)
    results: dict = {"samples": sum(LENGTHS)}
    for (kind, how), some in found.items():
        for against, unit in (("measured", 1.0), ("exact", noise)):
            error = np.median([one[against] for one in some], axis=0) / unit
            results |= {f"{kind}_{how}_against_{against}_{actuator.name}": float(f"{value:.4g}")
                        for actuator, value in zip(machine.actuators, error, strict=True)}
        results[f"{kind}_{how}_negative_masses"] = float(np.median([one["negative_masses"] for one in some]))
    for k, actuator in enumerate(machine.actuators):
        results[f"thesis_complete_in_sigmas_{actuator.name}"] = round(float(thesis.RMS["complete"][k] / noise[k]), 2)
    report(model, found, results)
    last = {key: some[-1] for key, some in found.items()}
    draw_forces(model, motion, problem.validation[0].force, exact, last)
    draw_rms(machine, results, noise)
    return results


def window(model: Model, seed: int, samples: int) -> Trajectory:
    """The first samples of a smooth random motion."""
    motion = random_trajectory(model, duration=33.28, rate=50, seed=seed)
    return Trajectory(motion.t[:samples], motion.q[:samples], motion.qd[:samples], motion.qdd[:samples])


def identified(problem: IdentificationProblem, kind: str, motion: Trajectory, exact: np.ndarray) -> dict[str, dict]:
    """Nominal, the thesis's way, base parameters and the default method, judged on the unseen run without its ends.

    Measured forces are predicted from the measured angles, as on a real machine, noise-free ones from the true motion.
    """
    model, data, names = problem.model, problem.validation[0], tuple(TABLES[kind])
    seen, true = (model.over(model.regressor, some.q, some.qd, some.qdd)[0] for some in (data.motion, motion))
    masses = [k for k, name in enumerate(problem.parameters.names) if name.endswith(".m")]
    judged = {}
    for how, psi in (("nominal", problem.parameters.nominal), ("thesis_way", thesis.identified(problem, names)),
                     ("wls", solve(problem, "wls").psi), ("sdp", solve(problem).psi)):
        judged[how] = {"measured": rms((seen @ psi - data.force)[data.inside]), "predicted": true @ psi,
                       "exact": rms((true @ psi - exact)[data.inside]), "negative_masses": int(np.sum(psi[masses] < 0)),
                       "values": dict(zip(names, psi[problem.parameters.select(names)].tolist(), strict=True))}
    return judged


def rms(error: np.ndarray) -> np.ndarray:
    """Eq. 3.44, per column."""
    return np.sqrt(np.mean(error**2, axis=0))


COLUMNS = (("complete", "thesis_way"), ("reduced", "thesis_way"), ("complete", "nominal"), ("complete", "wls"),
           ("complete", "sdp"), ("reduced", "sdp"))


def report(model: Model, found: dict, results: dict) -> None:
    """Print the thesis's values next to ours."""
    rows: list[tuple] = []
    for k, (actuator, unit) in enumerate(zip(model.machine.actuators, model.force_units, strict=True)):
        rows.append((actuator.name, "thesis, real machine", unit, *(thesis.RMS[how][k] for how in thesis.RMS), *"---"))
        rows += [(actuator.name, text, own, *(results[f"{kind}_{how}_against_{against}_{actuator.name}"]
                                              for kind, how in COLUMNS))
                 for against, own, text in (("measured", unit, "simulated, measured forces"),
                                            ("exact", "σ", "simulated, noise-free forces"))]
    show.table(f"RMS of predicted forces of another motion; simulated: medians over {SEEDS} truths",
               ("actuator", "", "unit", "complete", "reduced", "nominal", "complete, wls", "complete, sdp",
                "reduced, sdp"), rows)
    literal = Model(load_machine("cat215b", parameter_set="thesis_literal")).parameters
    for kind, table in TABLES.items():
        show.table(f"Table {16 if kind == 'complete' else 17}; simulated: median absolute value of {SEEDS} truths; SI",
                   ("parameter", "Table 13", "thesis, real machine", "simulated, thesis's way", "simulated, sdp"),
                   [(name, float(literal.nominal[literal.index(name)]),
                     table[name][0], *(float(np.median([abs(one["values"][name]) for one in found[kind, how]]))
                                       for how in ("thesis_way", "sdp")))
                    for name in (KEY_ROWS if kind == "complete" else table)])


def draw_forces(model: Model, motion: Trajectory, measured: np.ndarray, exact: np.ndarray, found: dict) -> None:
    """Figure 37: forces of the unseen motion, measured and of the nominal and the identified models; one truth."""
    lines = (("nominal", GREEN, found["complete", "nominal"]),
             ("complete, the thesis's way", ORANGE, found["complete", "thesis_way"]),
             ("reduced, the thesis's way", GREY, found["reduced", "thesis_way"]),
             ("complete, sdp", BLUE, found["complete", "sdp"]))
    with show.look():
        figure = Figure(figsize=(11, 7), layout="constrained")
        axes = figure.subplots(len(model.machine.actuators), 2, sharex=True)
        for k, (actuator, unit) in enumerate(zip(model.machine.actuators, model.force_units, strict=True)):
            left, right = axes[k]
            left.plot(motion.t, measured[:, k] / 1e3, color=INK, lw=0.5, alpha=0.5, label="measured (simulated)")
            for label, colour, one in lines:
                left.plot(motion.t, one["predicted"][:, k] / 1e3, color=colour, label=label)
                if label != "nominal":
                    right.plot(motion.t, (one["predicted"] - exact)[:, k] / 1e3, color=colour)
            what = "torque [kN·m]" if unit == "N*m" else "force [kN]"
            left.set(title=actuator.name, ylabel=what)
            right.set(title=f"{actuator.name}: predicted − noise-free", ylabel=what)
        for ax in axes[-1]:
            ax.set(xlabel="time [s]", xlim=(0, motion.t[-1]))
        figure.legend(handles=axes[0][0].lines, loc="outside upper center", ncols=5)
    show.save(figure, "thesis_runs", "forces")


def draw_rms(machine: Machine, results: dict, noise: np.ndarray) -> None:
    """The thesis's RMS list and ours, in standard deviations of the sensors."""
    entries = (("complete", ORANGE, "complete", "thesis_way"), ("reduced", GREY, "reduced", "thesis_way"),
               ("nominal", GREEN, "complete", "nominal"), ("complete, sdp", BLUE, "complete", "sdp"))
    with show.look():
        figure = Figure(figsize=(8, 3.6), layout="constrained")
        ax = figure.subplots()
        for j, (label, colour, kind, how) in enumerate(entries):
            x = np.arange(len(noise)) + 0.2 * (j - 1.5)
            mine = [results[f"{kind}_{how}_against_measured_{a.name}"] for a in machine.actuators] / noise
            ax.bar(x, mine, 0.17, color=colour, label=f"{label}, simulated")
            if label in thesis.RMS:
                ax.plot(x, thesis.RMS[label] / noise, ls="none", marker="x", ms=6, mew=1.6, color=INK,
                        label="thesis, real machine" if j == 0 else None)
        ax.axhline(1, color=INK, lw=0.8, ls="--", label="noise of the sensors alone")
        ax.set_xticks(np.arange(len(noise)), [a.name for a in machine.actuators])
        ax.set(yscale="log", ylabel="RMS error / σ of the sensors [-]", xlim=(-0.5, len(noise) - 0.5),
               title="Measured forces of a motion nobody fitted")
        ax.yaxis.set_major_formatter("{x:g}")
        figure.legend(loc="outside right upper")
    show.save(figure, "thesis_runs", "rms")
