"""Tables 11 and 12: the cylinders' triangles without priors, with a length fixed, and what more makes them solvable."""

import math

import numpy as np
from matplotlib.figure import Figure

from hydroopt import SolverError, calibration_problem
from hydroopt.estimation.kinematic.initial_guesses import guess_unsensed
from hydroopt.estimation.kinematic.maximum_likelihood import maximum_likelihood
from hydroopt.estimation.kinematic.observability import linearise, observability
from hydroopt.estimation.kinematic.residuals import loop_fit
from hydroopt.machine.links import Note
from hydroopt.plots.figures import BLUE, GREY, INK, ORANGE
from hydroopt.results.tables import number
from hydroopt.simulation import postures
from studies import show
from studies.cat215b_calibration.chain import POSES, SWEEPS

SIDES = ("l_l", "l_u", "offset", "l_c")
TABLE_11 = {("boom_cylinder", "measured"): (0.658, 1.974, -78.6, 1.434),
            ("boom_cylinder", "computed"): (0.545, 2.000, -56.9, 1.210),
            ("stick_cylinder", "measured"): (2.725, 0.724, 10.3, 2.116),
            ("stick_cylinder", "computed"): (2.444, 0.766, 5.0, 1.801)}
"""l_l, l_u [m], offset [deg] and l_c [m]: sides from the joint to the barrel's and to the rod's pin."""
TABLE_12 = {("boom_cylinder", "measured"): (0.4, 99.99), ("boom_cylinder", "computed"): (3.0, 99.91),
            ("stick_cylinder", "measured"): (2.0, 99.98), ("stick_cylinder", "computed"): (27.0, 97.12)}
"""RMS [mm] and VAF [%]."""
HIDDEN = ("boom_cylinder.barrel.x", "boom_cylinder.barrel.y", "boom_cylinder.rod.z", "stick_cylinder.barrel.x",
          "stick_cylinder.barrel.z", "stick_cylinder.rod.z")
"""Held: a turn of the whole triangle about its joint, and what lies along the axes, of which lengths tell nothing."""
FIXED_LENGTH = {"boom_cylinder": ("rod.x", "rod.y"), "stick_cylinder": ("barrel.x", "barrel.y")}
"""Pins whose distance from the joint the thesis fixed (* in Table 11), 2.000 m and 2.444 m."""
TAPE, SHORT = 2e-3, "sweeps"
"""Standard deviation [m] of a tape along the retracted cylinder; name of the motion of the thesis's stages."""
WAYS = ("nothing more", "one length fixed", "dead length by tape", "one pin by tape", "full range of angles",
        "ten times the poses")


def triangles(setup) -> dict:
    """All ways of both tables, for cylinders and sources of angles."""
    results: dict = {}
    rows, spread = [], {}
    for source in ("measured", "computed"):
        for way in WAYS:
            if source == "computed" and way in ("full range of angles", "ten times the poses"):
                continue
            problem, unseen = told(setup, source, way)
            try:
                theta, q = maximum_likelihood(problem, problem.start, guess_unsensed(problem, problem.start))
            except SolverError:
                results[f"triangle_{source}_{way.replace(' ', '_')}_converged"] = False
                continue
            seen, fits = observability(problem, linearise(problem, theta, q)), loop_fit(problem, theta, q)
            for cylinder in setup.machine.cylinders:
                right = sides(setup.machine, problem.parameters, setup_truth(problem, setup), cylinder)
                found = sides(setup.machine, problem.parameters, theta, cylinder)
                std = deviations(setup.machine, problem, theta, seen.covariance, cylinder)
                rms, vaf = TABLE_12[cylinder.name, source]
                theirs = TABLE_11[cylinder.name, source]
                key = f"{cylinder.name}, {source} angles, {way}"
                off = 1e3 * (found - right)[[0, 1, 3]]
                spread[key] = 1e3 * std[[0, 1, 3]]
                results[f"table_11 {key}"] = {
                    name: {"truth": round(float(right[k]), 4), "ours": round(float(found[k]), 4),
                           "std": number(round(float(std[k]), 4)), "thesis, of the real machine": theirs[k]}
                    for k, name in enumerate(SIDES)}
                fit = fits[f"{cylinder.name}.length"]
                held = prediction(unseen, theta, setup, cylinder)
                results[f"table_12 {key}"] = {"RMS [mm]": round(1e3 * fit.rms, 3), "VAF [%]": round(100 * fit.vaf, 4),
                                              "unseen over the full range, true lengths [mm]": round(1e3 * held, 3),
                                              "thesis": [rms, vaf]}
                short = f"triangle_{cylinder.name}_{source}_{way.replace(' ', '_')}"
                results |= {f"{short}_largest_error_mm": round(float(np.max(np.abs(off))), 1),
                            f"{short}_largest_std_mm": number(round(float(np.max(1e3 * std[[0, 1, 3]])), 1)),
                            f"{short}_fit_mm": round(1e3 * fit.rms, 2), f"{short}_unseen_mm": round(1e3 * held, 2)}
                rows.append((cylinder.name, source, way, *(f"{o:+.0f} ± {s:.0f}" for o, s in zip(
                    off, spread[key], strict=True)), f"{found[2] - right[2]:+.2f}", 1e3 * fit.rms, rms, 1e3 * held))
    show.table("Triangles without priors: errors ± standard deviations [mm], offset [deg], fit and prediction",
               ("cylinder", "angles", "measured besides", *SIDES[:2], "l_c", "offset", "RMS [mm]", "thesis",
                "unseen [mm]"), rows)
    draw(spread)
    return results


def told(setup, source, way):
    """The problem with what is measured, and joint vectors of the full range that nobody measured."""
    machine, model = setup.machine, setup.model
    channels = [f"{c.name}.length" for c in machine.cylinders]
    rng = np.random.default_rng(0)
    unseen = np.zeros((400, len(model.joints)))
    for name in ("boom", "stick"):
        unseen[:, model.joints.index(name)] = rng.uniform(*machine.link(name).joint.range, len(unseen))
    fixed = {}
    if source == "measured":
        ranges = {name: machine.link(name).joint.range if way == "full range of angles" else np.radians(
            SWEEPS[f"{name}_moves"]) for name in ("boom", "stick")}
        q = np.zeros((POSES * (10 if way == "ten times the poses" else 1), len(model.joints)))
        for name, limits in ranges.items():
            q[:, model.joints.index(name)] = rng.uniform(*limits, len(q))
        poses = postures.record(model, q, ["angles"] * len(q), [""] * len(q), geometry=setup.geometry, seed=1,
                                channels=["boom.q", "stick.q", *channels])
    else:
        poses = postures.record(model, setup.q, setup.labels, ["ball"] * len(setup.q), geometry=setup.geometry, seed=1,
                                channels=[*(f"{model.joints[k]}.q" for k in postures.sensed_joints(model)), *channels])
        fixed = {"ball.y": 0.0}
    machine, known = besides(machine, way)
    problem = calibration_problem(machine, poses, fixed=fixed, priors=known)
    held = {name: problem.start[problem.parameters.index(name)] for name in HIDDEN}
    if source == "measured":  # which tell of nothing but the triangles
        held |= {name: value for name, value in zip(problem.parameters.names, problem.start, strict=True)
                 if "cylinder" not in name}
    if way == "one length fixed":
        held |= {f"{cylinder}.{pin}": problem.start[problem.parameters.index(f"{cylinder}.{pin}")]
                 for cylinder, pins in FIXED_LENGTH.items() for pin in pins}
    return problem.fixing(**held), unseen


def besides(machine, way):
    """The machine with a tape's reading, wrong by its own error, as the only prior; whether priors count."""
    if way not in ("dead length by tape", "one pin by tape"):
        return machine, False
    rng = np.random.default_rng(2)
    notes = {path: note if not note.sigma or not path.startswith(("swing", "boom", "stick", "ball"))
             else note.model_copy(update={"sigma": 1e3}) for path, note in machine.notes.items()}
    read = {}
    for cylinder in machine.cylinders:
        if way == "dead length by tape":
            notes[f"{cylinder.name}.dead_length"] = Note(sigma=TAPE)
            read[f"{cylinder.name}.dead_length"] = cylinder.dead_length + TAPE * float(rng.standard_normal())
        else:
            end = FIXED_LENGTH[cylinder.name][0].partition(".")[0]
            notes[f"{cylinder.name}.{end}.pin"] = Note(sigma=TAPE)
            for axis, value in zip("xy", getattr(cylinder, end).pin, strict=False):
                read[f"{cylinder.name}.{end}.{axis}"] = value + TAPE * float(rng.standard_normal())
    return machine.with_values(read).model_copy(update={"notes": notes}), True


def setup_truth(problem, setup) -> np.ndarray:
    """The parameters that the poses were made with."""
    true = dict(zip(setup.model.parameters.names, setup.geometry, strict=True))
    return np.array([true.get(name, value)
                     for name, value in zip(problem.parameters.names, problem.start, strict=True)])


def sides(machine, parameters, theta, cylinder) -> np.ndarray:
    """l_l, l_u [m], offset [deg] and l_c [m] of Eq. 3.26 from pins."""
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
    return np.array([math.hypot(fixed[0], fixed[1]), math.hypot(moving[0], moving[1]), (offset + 180) % 360 - 180,
                     value[f"{cylinder.name}.dead_length"]])


def deviations(machine, problem, theta, covariance, cylinder) -> np.ndarray:
    """Standard deviations (4,) of the sides, from the covariance of the pins."""
    free = np.flatnonzero(problem.free)
    steps = 1e-6 * np.eye(len(problem.parameters))[free]
    slope = np.array([(sides(machine, problem.parameters, theta + step, cylinder)
                       - sides(machine, problem.parameters, theta - step, cylinder)) / 2e-6 for step in steps])
    known = np.isfinite(np.diag(covariance))
    lost = np.any(np.abs(slope[~known]) > 1e-9, axis=0)  # which numbers depend on what the data do not identify
    slope, covariance = slope[known], covariance[np.ix_(known, known)]
    return np.where(lost, np.inf, np.sqrt(np.einsum("ki,kl,li->i", slope, covariance, slope)))


def prediction(unseen, theta, setup, cylinder) -> float:
    """RMS [m] of the cylinder's length at true angles of the full range: stroke plus dead length."""
    k = [each.name for each in setup.machine.cylinders].index(cylinder.name)
    g = theta[: len(setup.model.parameters)]
    strokes = [setup.model.over(setup.model.strokes, geometry, unseen)[0][:, k, 0] for geometry in (g, setup.geometry)]
    return float(np.sqrt(np.mean((strokes[0] - strokes[1]) ** 2)))


def draw(spread: dict) -> None:
    """Standard deviations of the three lengths by what is measured."""
    keys = list(spread)
    with show.look():
        figure = Figure(figsize=(9, 0.9 + 0.27 * len(keys)), layout="constrained")
        ax = figure.subplots()
        for k, (name, colour) in enumerate(zip(("l_l", "l_u", "l_c"), (BLUE, ORANGE, INK), strict=True)):
            ax.plot([max(spread[key][k], 0.05) for key in keys], np.arange(len(keys)), ls="none", marker="o", ms=4.5,
                    color=colour, label=name)
        ax.axvline(10, color=GREY, lw=0.8, label="1 cm: as good as a careful tape")
        ax.set(xscale="log", xlabel="standard deviation without priors [mm]", ylim=(len(keys) - 0.5, -0.5))
        ax.xaxis.set_major_formatter("{x:g}")
        ax.set_yticks(np.arange(len(keys)), keys, fontsize=7)
        figure.legend(loc="outside upper center", ncols=4)
    show.save(figure, "cat215b_calibration", "triangles")
