"""Panda with a ball in sockets (MUKCA): geometry from one place, tested at eight others; which place is wrong."""

from pathlib import Path

import numpy as np

from hydroopt import calibration_problem, load_machine, read_pose_files, solve
from hydroopt.estimation.kinematic.accuracy import prediction_test
from hydroopt.estimation.kinematic.observability import linearise
from hydroopt.estimation.kinematic.pose_faults import SuspectKind
from hydroopt.estimation.kinematic.residuals import predicted

DATA = Path(__file__).parents[2] / "data" / "mukca_panda_2"
SHIFT = 1.959964
SIZES, SUBSETS = (10, 20, 40, 80), 20
"""Numbers of poses of random subsets, and how many subsets of each."""


def balls(model, geometry, poses) -> np.ndarray:
    """Ball centres (N, 3) [m] by the sensed joint angles."""
    q = np.stack([poses.channels[f"{joint}.q"] for joint in model.joints], axis=1)
    return model.over(model.tip, geometry[: len(model.parameters)], q)[0][:, :, 0]


def sockets(poses) -> list[np.ndarray]:
    """Poses of each place and socket, as masks (N,)."""
    return [there for stage in dict.fromkeys(poses.stage) for hole in ("hole_0", "hole_1")
            if (there := (poses.stage == stage) & (poses.fixture == hole)).any()]


def scatter(tip, poses) -> np.ndarray:
    """Distance (N,) [m] of each ball from the mean of its place and socket."""
    away = np.zeros(len(tip))
    for there in sockets(poses):
        away[there] = np.linalg.norm(tip[there] - tip[there].mean(axis=0), axis=1)
    return away


def plain(machine):
    """The machine for plain least squares: no compliance, all readings exact, the gap of every pose alike."""
    links = tuple(link.model_copy(update={"joint": link.joint.model_copy(update={"compliance": None})})
                  for link in machine.links)
    return machine.model_copy(update={"links": links, "sensors": ()})


def mm(value) -> float:
    """In millimetres."""
    return round(1e3 * float(value), 4)


def run() -> dict:
    """Mean ball scatter in mm, at places that took no part in the fit unless stated otherwise."""
    machine = load_machine("panda_mukca")
    poses = read_pose_files(sorted(DATA.glob("*/hole_*.csv")), mapping=DATA / "map.toml")
    high, center = poses.stage == "high", poses.stage == "front_center"
    results: dict = {"poses": len(poses)}

    one_place = solve(calibration_problem(machine, poses.select(center)))
    least_squares = solve(calibration_problem(plain(machine), poses.select(center), priors=False))
    nominal = one_place.problem.start
    for name, solved, geometry in (("nominal", one_place, nominal), ("plain", least_squares, least_squares.theta),
                                   ("ours", one_place, one_place.theta)):
        away = scatter(balls(solved.problem.model, geometry, poses), poses)
        results |= {f"{name}_front_center_itself": mm(away[center].mean()),
                    f"{name}_front_center_to_others": mm(away[~center].mean()),
                    f"{name}_front_center_to_others_without_high": mm(away[~center & ~high].mean())}
    results |= authors_figures(one_place, least_squares, poses, center)

    everything = solve(calibration_problem(machine, poses))
    flagged = sorted({suspect.name.rpartition(".")[2] for suspect in everything.suspects
                      if suspect.kind is not SuspectKind.POSE})
    tip = balls(everything.problem.model, everything.theta, poses)
    results |= {"inconsistent_places": flagged, "high_fitted_to_everything": mm(scatter(tip, poses)[high].mean())}

    places = [place for place in dict.fromkeys(poses.stage) if place != "high"]
    train = np.isin(poses.stage, places[::2])
    rest = np.isin(poses.stage, places[1::2])
    ours = solve(calibration_problem(machine, poses.select(train)))
    theirs = solve(calibration_problem(plain(machine), poses.select(train), priors=False))
    held = poses.select(rest)
    away = [scatter(balls(c.problem.model, c.theta, held), held) for c in (ours, theirs)]
    low, high_end = interval(away[0] - away[1], held)
    results |= {"ours_every_second_to_rest": mm(away[0].mean()), "plain_every_second_to_rest": mm(away[1].mean()),
                "ours_minus_plain": mm((away[0] - away[1]).mean()), "ours_minus_plain_low": mm(low),
                "ours_minus_plain_high": mm(high_end), "coverage_with_wild_poses": round(coverage(ours, held), 4),
                "coverage_of_stated_error": round(coverage(cleaned(ours), held), 4)}
    return results | coverage_of_places(machine, poses) | suspect_subsets(machine, poses.select(~high))


def suspect_subsets(machine, poses) -> dict:
    """Share of random subsets of sound poses, by their size, in which anything is suspected."""
    rng, found = np.random.default_rng(5), {}
    for size in SIZES:
        chosen = [np.isin(np.arange(len(poses)), rng.choice(len(poses), size, replace=False)) for _ in range(SUBSETS)]
        alarms = [bool(solve(calibration_problem(machine, poses.select(some))).suspects) for some in chosen]
        found[f"suspect_subsets_of_{size}"] = round(float(np.mean(alarms)), 3)
    return found


def coverage_of_places(machine, poses) -> dict:
    """Share of residuals within their 95 % intervals at every place, predicted from every other place alone."""
    inside: dict[tuple[str, str], np.ndarray] = {}
    places = list(dict.fromkeys(map(str, poses.stage)))
    for place in places:
        solved = solve(calibration_problem(machine, poses.select(poses.stage == place)))
        for other in places:
            if other != place:
                inside[place, other] = prediction_test(solved, poses.select(poses.stage == other)).inside
    pairs = {pair: float(np.mean(hits)) for pair, hits in inside.items()}
    sound = [pair for pair in inside if "high" not in pair]
    return {"coverage_of_all_places": round(float(np.mean(np.concatenate(list(inside.values())))), 4),
            "coverage_of_places_without_high": round(float(np.mean(np.concatenate([inside[p] for p in sound]))), 4),
            "coverage_at_high": round(float(np.mean(np.concatenate(
                [hits for (_, other), hits in inside.items() if other == "high"]))), 4),
            "lowest_coverage_of_a_pair_without_high": round(min(pairs[p] for p in sound), 4)}


def authors_figures(ours, least_squares, poses, center) -> dict:
    """Consistency sqrt(Σ var of both sockets) and distortion | |m₀ − m₁| − 50 mm |, means over places, as the authors
    of the data define them."""
    found = {}
    for name, solved, geometry in (("nominal", ours, ours.problem.start), ("plain", least_squares, least_squares.theta),
                                   ("ours", ours, ours.theta)):
        tip = balls(solved.problem.model, geometry, poses)
        table = {}
        for place in dict.fromkeys(poses.stage):
            pair = [tip[(poses.stage == place) & (poses.fixture == hole)] for hole in ("hole_0", "hole_1")]
            table[place] = (np.sqrt(sum(p.var(axis=0).sum() for p in pair)),
                            abs(np.linalg.norm(pair[0].mean(axis=0) - pair[1].mean(axis=0)) - 0.05))
        others = np.mean([v for place, v in table.items() if place != "front_center"], axis=0)
        found |= {f"authors_{name}_consistency_itself": mm(table["front_center"][0]),
                  f"authors_{name}_consistency_others": mm(others[0]),
                  f"authors_{name}_distortion_others": mm(others[1])}
    return found


def interval(difference, poses) -> tuple[float, float]:
    """95 % interval of the mean by resampling whole sockets, whose poses share their errors."""
    rng = np.random.default_rng(0)
    groups = [difference[there] for there in sockets(poses)]
    means = [np.concatenate([groups[k] for k in rng.integers(len(groups), size=len(groups))]).mean()
             for _ in range(4000)]
    return float(np.quantile(means, 0.025)), float(np.quantile(means, 0.975))


def cleaned(calibration):
    """The calibration again without the poses that it suspects: they enlarge the noise on which intervals rest."""
    return solve(calibration.problem.without(calibration.suspicious))


def coverage(calibration, poses) -> float:
    """Share of unseen balls within the 95 % error stated for each coordinate: noise, play and geometry together."""
    fresh, theta, q = predicted(calibration.problem, calibration.theta, poses)
    at = linearise(fresh, theta, q)
    # whitened by what sensors and play state; geometry adds its own share
    shared = [k for k, name in enumerate(fresh.parameters.names) if name in calibration.observability.names]
    order = [calibration.observability.names.index(fresh.parameters.names[k]) for k in shared]
    slope = at.jacobian[:, :, shared]
    geometry = calibration.observability.covariance[np.ix_(order, order)]
    variance = calibration.noise_scale**2 * (1 + np.einsum("nik,kl,nil->ni", slope, geometry, slope))
    gap = at.residual
    return float(np.mean(np.abs(gap) < SHIFT * np.sqrt(variance)))
