"""Chapter 3 on the CAT 215B: Tables 4, 5, 6, 11 and 12 by simulation, and 200 seeds against the Cramér-Rao bound."""

import math

import numpy as np

from hydroopt import calibration_problem, load_machine, solve
from hydroopt.estimation.kinematic import joint, link_by_link
from hydroopt.estimation.kinematic.observability import linearise, observability
from hydroopt.estimation.kinematic.unsensed_angles import guess_unsensed
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.simulation import postures

SEEDS, POSES = 200, 120
SWEEPS = {"stick_moves": (60, 115), "boom_moves": (-48, -8), "swing_moves": (-30, 30)}
"""Ranges [deg], assumed: Figures 16 to 18 are missing from the source."""
DRIFT = {"swing": 0.0, "boom": -0.3, "stick": 0.3}
"""Creep [deg] of a locked joint during a stage, assumed like the ranges."""
SHOWN = ("swing.a", "boom.a", "boom.d", "stick.a", "ball.x", "ball.z", "swing.alpha", "boom.alpha", "boom.beta",
         "stick.alpha", "stick.beta", "boom.locked.swing_moves", "stick.locked.boom_moves")
TABLES = {  # the thesis's own figures, metres and degrees; ball.x and ball.z are −a_0 and −d_0
    "table_4_drift": {"swing.a": 0.306, "boom.a": 5.188, "stick.a": 1.797, "ball.x": 2.160, "ball.z": -0.908},
    "table_5_drift_and_sensors": {"swing.a": 0.298, "boom.a": 5.199, "stick.a": 1.796, "ball.x": 2.161,
                                  "ball.z": -0.913},
    "table_6_drift_and_flexibility": {"swing.a": 0.513, "boom.a": 4.992, "stick.a": 1.770, "ball.x": 2.163,
                                      "ball.z": -0.758}}
TABLE_11 = {("boom_cylinder", "measured"): (0.658, 1.974, -78.6, 1.434),
            ("boom_cylinder", "computed"): (0.545, 2.000, -56.9, 1.210),
            ("stick_cylinder", "measured"): (2.725, 0.724, 10.3, 2.116),
            ("stick_cylinder", "computed"): (2.444, 0.766, 5.0, 1.801)}
"""l_l, l_u [m], offset [deg] and l_c [m], sides from the joint to the barrel's and to the rod's pin."""
TABLE_12 = {("boom_cylinder", "measured"): (0.4, 99.99), ("boom_cylinder", "computed"): (3.0, 99.91),
            ("stick_cylinder", "measured"): (2.0, 99.98), ("stick_cylinder", "computed"): (27.0, 97.12)}
"""RMS [mm] and VAF [%]."""


def paths() -> dict:
    """Angles [rad] of the moving joint of each stage: out and back, twice."""
    return {stage: np.radians((low + high) / 2 + (high - low) / 2 * np.sin(np.linspace(0, 4 * np.pi, POSES)))
            for stage, (low, high) in SWEEPS.items()}


class Machine:
    """The nominal machine, its thesis-like sweeps, and what is held: cylinder pins and the ball's free direction."""

    def __init__(self, drift: bool) -> None:
        self.machine = with_drift(load_machine("cat215b"), 0.0)
        self.model = KinematicModel(self.machine)
        self.geometry = self.model.parameters.nominal
        self.fixture = np.array(self.machine.fixtures[0].position)
        self.stages = {stage.name: stage for stage in self.machine.stages}
        self.crept: dict[str, float] = {}
        self.q = np.concatenate([self.swept(name, path, drift) for name, path in paths().items()])
        self.labels = [name for name in paths() for _ in range(POSES)]

    def swept(self, name, path, drift) -> np.ndarray:
        """Closed postures of a stage; locked joints creep evenly if asked."""
        stage = self.stages[name]
        q = postures.sweep(self.model, stage, path[:, None], geometry=self.geometry, fixture=self.fixture)
        if drift:
            q = q.copy()
            for locked in stage.locked.keys() & DRIFT.keys():  # it goes on from where it was, until the joint moves
                before = self.crept.get(locked, 0.0)
                creep = before + DRIFT[locked] * np.linspace(0, 1, len(q))
                q[:, self.model.joints.index(locked)] += np.radians(creep)
                self.crept[locked] = creep[-1]
            for moved in stage.moves:
                self.crept.pop(moved, None)
            free = postures.sensed_joints(self.model)
            q, closed = postures.close(self.model, self.geometry, q, free, self.fixture)
            assert closed.all()
        return q

    def poses(self, seed):
        """What the calibrator's sensors read."""
        return postures.record(self.model, self.q, self.labels, ["ball"] * len(self.q), geometry=self.geometry,
                               seed=seed)

    def problem(self, poses, machine=None, *, priors=False):
        """Their calibration; without priors, so that nothing but the data counts."""
        problem = calibration_problem(machine or self.machine, poses, priors=priors, fixed={"ball.y": 0.0})
        pins = {name: problem.parameters.nominal[k] for k, name in enumerate(problem.parameters.names)
                if "cylinder" in name}
        return problem.fixing(**pins)


def with_drift(machine, degrees):
    """The machine file with a drift of locked joints as a nuisance."""
    stages = tuple(stage.model_copy(update={"drift": math.radians(degrees)}) for stage in machine.stages)
    return machine.model_copy(update={"stages": stages})


def bound(setup) -> tuple:
    """Names and Cramér-Rao standard deviations of all free parameters, at the truth."""
    problem = setup.problem(setup.poses(None))
    seen = observability(problem, linearise(problem, problem.start, setup.q))
    return seen.names, seen.std


def monte_carlo(setup) -> dict:
    """Scatter of the joint estimate over noise, against the bound, and coverage of its intervals."""
    names, least = bound(setup)
    errors, inside = [], []
    for seed in range(SEEDS):
        problem = setup.problem(setup.poses(seed))
        solved = solve(problem)
        free = problem.free
        truth = problem.parameters.nominal[free]
        errors.append(solved.theta[free] - truth)
        interval = solved.ci95[free]
        inside.append((interval[:, 0] <= truth) & (truth <= interval[:, 1]))
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    ratio = rms / least
    worst = int(np.argmax(ratio))
    return {"worst_rms_over_bound": round(float(ratio[worst]), 3), "worst_rms_over_bound_of": names[worst],
            "pooled_coverage": round(float(np.mean(inside)), 4),
            "pooled_rms_over_bound": round(float(np.sqrt(np.mean(ratio**2))), 3),
            "a_1_rms_mm": round(1e3 * float(rms[names.index("swing.a")]), 2),
            "a_1_bound_mm": round(1e3 * float(least[names.index("swing.a")]), 2)}


def flexible(setup, poses, seed):
    """Readings of grapple and yoke a degree off, at random, wherever the stick or the arm is drawn in."""
    rng = np.random.default_rng(seed)
    k = {name: setup.model.joints.index(name) for name in ("grapple", "yoke", "stick", "boom")}
    stressed = np.abs(setup.q[:, k["yoke"]]) > np.quantile(np.abs(setup.q[:, k["yoke"]]), 0.8)
    channels = dict(poses.channels)
    for name in ("grapple", "yoke"):
        channels[f"{name}.q"] = channels[f"{name}.q"] + np.where(stressed, rng.normal(0, math.radians(1), len(setup.q)),
                                                                 0.0)
    return type(poses)(name=poses.name, stage=poses.stage, fixture=poses.fixture, channels=channels)


def tables(drifting) -> dict:
    """One simulation each of Tables 4 to 6: the thesis's estimator, ours, ours with drift, ours with a robust loss."""
    exact, noisy = drifting.poses(None), drifting.poses(0)
    cases = {"table_4_drift": exact, "table_5_drift_and_sensors": noisy,
             "table_6_drift_and_flexibility": flexible(drifting, exact, 0)}
    truth = drifting.problem(exact).parameters
    results: dict = {}
    for table, poses in cases.items():
        plain = drifting.problem(poses)
        drift = drifting.problem(poses, with_drift(drifting.machine, 0.3))
        best = solve(drift)
        odd = [suspect.poses for suspect in best.suspects if suspect.kind.is_poses]
        cleaned = solve(drift.without(np.any(odd, axis=0))) if odd else best
        answers = {"hierarchical": link_by_link.sequential_least_squares(plain, plain.start, plain.layout.reading)[0],
                   "joint": joint.maximum_likelihood(plain, plain.start, guess_unsensed(plain, plain.start))[0],
                   "joint_with_drift": best.theta, "joint_without_suspects": cleaned.theta,
                   "joint_robust": solve(drift.with_loss("student_t")).theta}
        for name, value in TABLES[table].items():
            right = truth.nominal[truth.index(name)]
            entry = {"thesis": round(1e3 * float(value - right), 1)}
            for way, theta in answers.items():
                problem = plain if len(theta) == len(plain.parameters) else drift
                entry[way] = round(1e3 * float(theta[problem.parameters.index(name)] - right), 2)
            entry["bound"] = round(1e3 * float(best.observability.std[best.observability.names.index(name)]), 2)
            results[f"{table}: error of {name} [mm]"] = entry
    return results


def sides(machine, parameters, theta, cylinder) -> dict:
    """l_l, l_u, offset and l_c of Eq. 3.26 from calibrated pins."""
    value = dict(zip(parameters.names, theta, strict=True))
    pins = {end: np.array([value.get(f"{cylinder.name}.{end}.{axis}", getattr(cylinder, end).pin["xyz".index(axis)])
                           for axis in "xyz"]) for end in ("barrel", "rod")}
    before = machine.link(cylinder.barrel.link).joint
    # the barrel's pin seen from the driven joint's axis: alpha of −90° turns its height into −y
    fixed = pins["barrel"] - np.array([value.get(f"{cylinder.barrel.link}.a", before.a), 0, 0])
    if abs(before.alpha) > 1:
        fixed = np.array([fixed[0], -fixed[2], fixed[1]])
    moving = pins["rod"]
    offset = math.degrees(math.atan2(moving[1], moving[0]) - math.atan2(fixed[1], fixed[0]))
    return {"l_fixed": math.hypot(fixed[0], fixed[1]), "l_moving": math.hypot(moving[0], moving[1]),
            "offset": (offset + 180) % 360 - 180, "l_c": float(value[f"{cylinder.name}.dead_length"])}


def triangles(setup) -> dict:
    """Tables 11 and 12: triangles from measured angles, and from angles that the closed chain gives, σ of 2 mm."""
    machine, model = setup.machine, setup.model
    results: dict = {}
    rng = np.random.default_rng(0)
    for source in ("measured", "computed"):
        channels = [f"{c.name}.length" for c in machine.cylinders]
        fixed = {}
        if source == "measured":
            q = np.zeros((2 * POSES, len(model.joints)))
            for name in ("boom", "stick"):
                q[:, model.joints.index(name)] = rng.uniform(*machine.link(name).joint.range, len(q))
            poses = postures.record(model, q, ["angles"] * len(q), [""] * len(q), geometry=setup.geometry, seed=1,
                                    channels=["boom.q", "stick.q", *channels])
        else:
            poses = postures.record(model, setup.q, setup.labels, ["ball"] * len(setup.q), geometry=setup.geometry,
                                    seed=1, channels=[*(f"{model.joints[k]}.q" for k in postures.sensed_joints(model)),
                                             *channels])
            fixed = {"ball.y": 0.0}
        problem = calibration_problem(machine, poses, fixed=fixed)
        solved = solve(problem)
        for cylinder in machine.cylinders:
            fit = solved.fit["train"][f"{cylinder.name}.length"]
            found = sides(machine, problem.parameters, solved.theta, cylinder)
            right = sides(machine, problem.parameters, problem.parameters.nominal, cylinder)
            place = f"{cylinder.name} from {source} angles"
            results |= {f"table_11 {place}: {key}": {"truth": round(right[key], 4), "ours": round(found[key], 4),
                                                     "thesis, of the real machine": theirs}
                        for key, theirs in zip(right, TABLE_11[cylinder.name, source], strict=True)}
            rms, vaf = TABLE_12[cylinder.name, source]
            results[f"table_12 {place}: RMS [mm]"] = {"ours": round(1e3 * fit.rms, 3), "thesis": rms}
            results[f"table_12 {place}: VAF [%]"] = {"ours": round(100 * fit.vaf, 4), "thesis": vaf}
    return results


def run() -> dict:
    """Everything, in millimetres and degrees."""
    quiet = Machine(drift=False)
    names, least = bound(quiet)
    results = {"bound: " + name: round(float(1e3 * std if is_length(name) else math.degrees(std)), 3)
               for name, std in zip(names, least, strict=True) if name in SHOWN}
    results |= tables(Machine(drift=True)) | triangles(quiet) | monte_carlo(quiet)
    return results


def is_length(name) -> bool:
    """Whether a parameter is a length, not an angle."""
    return name.rpartition(".")[2] in ("a", "d", "x", "z")
