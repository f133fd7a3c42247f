"""Tables 4 to 7 and 9 parameter by parameter, the thesis beside ours, and the paths of Figures 22 to 25."""

import math

import numpy as np

from hydroopt import SolverError, load_machine, path_difference, solve
from hydroopt.estimation.kinematic import link_by_link
from hydroopt.estimation.kinematic.initial_guesses import guess_unsensed
from hydroopt.estimation.kinematic.maximum_likelihood import maximum_likelihood
from hydroopt.estimation.kinematic.observability import linearise, observability
from hydroopt.results.tables import number
from studies import show
from studies.cat215b_calibration.chain import Machine, misjudged, paths, with_drift

NAMES = ("swing.alpha", "swing.a", "boom.locked.swing_moves", "boom.alpha", "boom.a", "boom.d", "boom.beta",
         "stick.locked.boom_moves", "stick.alpha", "stick.a", "stick.beta", "ball.x", "ball.z")
"""alpha_1, a_1, theta_2, alpha_2, a_2, d_2, beta_2, theta_3, alpha_3, a_3, beta_3, −a_0, −d_0."""
TRUTH = (-90.0, 0.340, -27.8, 0.0, 5.180, -0.110, 0.0, 80.6, 0.0, 1.800, 0.0, 2.160, -0.840)
"""Table 2 in degrees and metres, with the corrected sign of theta_2."""
THESIS = {
    "table_4": (-90.0, 0.306, -27.0, 0.0, 5.188, -0.110, 0.0, 80.7, 0.0, 1.797, 0.0, 2.160, -0.908),
    "table_5": (-90.1, 0.298, -26.8, 0.2, 5.199, -0.100, -0.2, 80.7, 0.0, 1.796, 0.0, 2.161, -0.913),
    "table_6": (-96.7, 0.513, -31.1, 13.4, 4.992, 0.728, -7.4, 83.2, -0.7, 1.770, 0.0, 2.163, -0.758),
    "table_7": (-84.5, 0.011, -31.3, -4.7, 5.485, 0.001, -2.0, 84.2, -3.6, 1.868, -1.3, 2.122, -0.623),
    "table_9": (-86.2, 0.401, -31.2, -2.1, 5.312, -0.059, -3.4, 77.5, 0.2, 1.848, -2.8, 2.122, -0.699)}
"""As printed; 7 and 9 are of the real machine."""
ITERATIONS = {"table_4": (6, 11, 5), "table_5": (6, 14, 7), "table_6": (8, 20, 12), "table_7": (11, 18, 8)}
"""Of the stages that move stick, boom and swing."""
PATHS = {"table_7": (0.212, 0.256), "table_9": (0.153, 0.205)}
"""RMS [m] of the end of stick and grapple against the nominal model, from the manipulator's side (Section 3.8)."""
TABLES = {"table_4": "creep", "table_5": "creep and sensors", "table_6": "creep and flexibility"}
PRIOR_SEEDS = 5


def flexible(setup, poses, seed):
    """Readings of grapple and yoke a degree off, at random, wherever the stick or the arm is drawn in."""
    rng = np.random.default_rng(seed)
    k = setup.model.joints.index("yoke")
    stressed = np.abs(setup.q[:, k]) > np.quantile(np.abs(setup.q[:, k]), 0.8)
    channels = dict(poses.channels)
    for name in ("grapple", "yoke"):
        channels[f"{name}.q"] = channels[f"{name}.q"] + np.where(stressed, rng.normal(0, math.radians(1), len(setup.q)),
                                                                 0.0)
    return type(poses)(name=poses.name, stage=poses.stage, fixture=poses.fixture, channels=channels)


def errors(problem, theta) -> np.ndarray:
    """Errors of `NAMES` [m, deg] against Table 2."""
    found = np.array([theta[problem.parameters.index(name)] for name in NAMES])
    return np.where([is_length(name) for name in NAMES], found, np.degrees(found)) - TRUTH


def is_length(name) -> bool:
    """Whether a parameter is a length, not an angle."""
    return name.rpartition(".")[2] in ("a", "d", "x", "z")


def simulated() -> dict:
    """One simulation each of Tables 4 to 6."""
    creeping = Machine(creep="even")
    exact, noisy = creeping.poses(None), creeping.poses(0)
    cases = {"table_4": exact, "table_5": noisy, "table_6": flexible(creeping, exact, 0)}
    results: dict = {}
    for table, poses in cases.items():
        results |= one_table(table, creeping, poses)
    return results


def one_table(table, setup, poses) -> dict:
    """The thesis's method, ours, with drift, without suspects, with a robust loss, with wrong priors."""
    plain = setup.problem(poses)
    drift = setup.problem(poses, with_drift(setup.machine, 0.3))
    steps = link_by_link.sequential_least_squares(plain, plain.start, plain.layout.reading)
    best = solve(drift)
    odd = [suspect.poses for suspect in best.suspects if suspect.kind.is_poses]
    answers = {"link by link": errors(plain, steps.parameters), "joint": joint_errors(plain),
               "joint, drift": errors(drift, best.theta),
               "without suspects": joint_errors(drift.without(np.any(odd, axis=0)) if odd else drift),
               "robust": joint_errors(drift.with_loss("student_t")),
               "joint, drift, wrong priors": with_priors(setup, poses)}
    bound = dict(zip(best.observability.names, best.observability.std, strict=True))
    results, rows = {}, []
    for k, name in enumerate(NAMES):
        length = is_length(name)
        unit, factor = ("mm", 1e3) if length else ("deg", 1.0)
        own = {"thesis": THESIS[table][k] - TRUTH[k], **{way: error[k] for way, error in answers.items()},
               "bound": bound[name] if length else math.degrees(bound[name])}
        own = {way: number(round(factor * float(value), 3)) for way, value in own.items()}
        results[f"{table}: error of {name} [{unit}]"] = own
        rows.append((f"{name} [{unit}]", *own.values()))
    counts = tuple(stage.iterations for stage in steps.stages[:3])
    results[f"{table}: iterations of stick, boom, swing"] = {"thesis": ITERATIONS[table], "ours": counts}
    for stage, count in zip(steps.stages, counts, strict=False):
        results[f"{table}_iterations_{stage.joint}"] = count
    results[f"{table}_a_1_mm"] = round(1e3 * abs(float(answers["joint, drift"][1])), 2)
    show.table(f"{table}, {TABLES[table]}: errors; iterations {counts}, thesis {ITERATIONS[table]}",
               ("parameter", *own), rows)
    return results


def joint_errors(problem) -> np.ndarray:
    """Errors of `NAMES` by the joint estimate; NaN where it does not converge, since too few poses are left."""
    try:
        theta = maximum_likelihood(problem, problem.start, guess_unsensed(problem, problem.start))[0]
    except SolverError:
        return np.full(len(NAMES), np.nan)
    return errors(problem, theta)


def with_priors(setup, poses) -> np.ndarray:
    """Root mean square over machine files that are wrong by their own sigmas, which count as measurements."""
    found = []
    for seed in range(PRIOR_SEEDS):
        problem = setup.problem(poses, misjudged(with_drift(setup.machine, 0.3), seed), priors=True)
        found.append(joint_errors(problem))
    return np.sqrt(np.mean(np.square(found), axis=0))


def uneven() -> dict:
    """Table 5 with creep that is not what the method assumes."""
    results = {}
    for shape in ("even", "settling", "slip"):
        setup = Machine(creep=shape)
        drift = setup.problem(setup.poses(0), with_drift(setup.machine, 0.3))
        off = joint_errors(drift)
        plain = setup.problem(setup.poses(0))
        theta = link_by_link.sequential_least_squares(plain, plain.start, plain.layout.reading).parameters
        steps = errors(plain, theta)
        for key, k in (("a_1", 1), ("a_2", 4), ("a_3", 9), ("ball_z", 12)):
            results[f"creep_{shape}_{key}_mm"] = round(1e3 * abs(float(off[k])), 2)
            results[f"creep_{shape}_{key}_link_by_link_mm"] = round(1e3 * abs(float(steps[k])), 2)
    return results


def accuracies(seeds: int) -> dict:
    """Section 3.7.2: relative error of a_1 by the thesis's method and the bound, for two accuracies, without creep."""
    results = {}
    for accuracy in (0.1, 0.05):
        setup = Machine(accuracy=accuracy)
        names, least = bound(setup)
        off = []
        for seed in range(seeds):
            problem = setup.problem(setup.poses(seed))
            theta = link_by_link.sequential_least_squares(problem, problem.start, problem.layout.reading).parameters
            off.append(theta[problem.parameters.index("swing.a")] / 0.34 - 1)
        key = f"resolvers_{accuracy}_deg_a_1"
        results |= {f"{key}_link_by_link_rms_percent": round(100 * float(np.sqrt(np.mean(np.square(off)))), 2),
                    f"{key}_link_by_link_largest_percent": round(100 * float(np.max(np.abs(off))), 2),
                    f"{key}_bound_percent": round(100 * float(least[names.index("swing.a")]) / 0.34, 2)}
    return results


def bound(setup) -> tuple:
    """Names and Cramér-Rao standard deviations of all free parameters, at the truth."""
    problem = setup.problem(setup.poses(None))
    seen = observability(problem, linearise(problem, problem.start, setup.q))
    return seen.names, seen.std


def end_paths() -> dict:
    """Figures 22 to 25: RMS [m] between the ends of stick and grapple by the nominal and by identified geometries.

    All three joints move along the sweeps of their stages at once, the grapple hangs as locked.
    """
    nominal, results = load_machine("cat215b"), {}
    motion = dict(zip(("stick", "boom", "swing"), paths().values(), strict=True))
    motion |= {"grapple_swing": np.full(len(motion["boom"]), math.radians(42.9)), "grapple": 0 * motion["boom"]}
    for table in ("table_5", "table_6", "table_7", "table_9"):
        stated = {name: value if is_length(name) else math.radians(value)
                  for name, value in zip(NAMES, THESIS[table], strict=True)
                  if ".locked." not in name and "ball" not in name}
        results |= {f"path_{table}_{point}_m": round(path_difference(nominal, nominal.with_values(stated), motion,
                                                                     point).rms, 3) for point in ("stick", "grapple")}
    setup = Machine(creep="even")
    drift = setup.problem(setup.poses(0), with_drift(setup.machine, 0.3))
    theta = maximum_likelihood(drift, drift.start, guess_unsensed(drift, drift.start))[0]
    ours = nominal.with_values({name: float(theta[drift.parameters.index(name)]) for name in NAMES
                                if ".locked." not in name and "ball" not in name})
    return results | {f"path_ours_as_table_5_{point}_m": round(path_difference(nominal, ours, motion, point).rms, 4)
                      for point in ("stick", "grapple")}


