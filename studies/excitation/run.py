"""CAT 215B, thesis's sensors, 33 s: is what is expected achieved, and what is a designed motion worth?"""

import math
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np

from hydroopt import excitation_problem, load_machine, random_trajectory
from hydroopt.excitation.criteria import presumed_noise
from hydroopt.excitation.motion.basis import Fourier
from hydroopt.excitation.motion.design import design
from hydroopt.excitation.motion.excitation import Excitation
from hydroopt.excitation.motion.expected_accuracy import expected_accuracy
from hydroopt.excitation.motion.random_motion import random_motion, resting_posture
from hydroopt.simulation import simulate
from studies.excitation import parts

RANDOM, IDENTIFIED, UNSEEN, CORES = 1000, 400, 10, 2
SECONDS = 50.0


def shared(pool: ProcessPoolExecutor, function, first, count: int) -> list:
    """A function's results over seeds, dealt to the processes."""
    size = -(-count // (4 * CORES))
    jobs = [pool.submit(function, first, range(start, min(start + size, count))) for start in range(0, count, size)]
    return [one for job in jobs for one in job.result()]


def scatter(path, structure, found) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations of the base parameters over identifications, and which of them all of these have."""
    common = set(structure.basis).intersection(*(basis for basis, _, _ in found))
    places = [k for k, column in enumerate(structure.basis) if column in common]
    values = np.array([[value[basis.index(structure.basis[k])] for k in places] for basis, value, _ in found])
    return values.std(axis=0, ddof=1), np.array(places)


def unseen_errors(model, program, found) -> dict[str, float]:
    """Median over logs and motions of the RMS of noise-free forces, in standard deviations of the sensors."""
    sigma, truth = presumed_noise(model), model.parameters.nominal
    still = resting_posture(program, np.random.default_rng(0))
    motions = {
        "of_the_same_kind": [
            Excitation(program, random_motion(program, still, np.random.default_rng((8, k)))).trajectory
            for k in range(UNSEEN)],
        "over_all_ranges": [random_trajectory(model, duration=33.28, rate=50, seed=100 + k) for k in range(UNSEEN)]}
    return {kind: float(np.median([
        np.sqrt(np.mean(((simulate.forces(model, path, psi) - simulate.forces(model, path, truth)) / sigma) ** 2))
        for path in paths for _, _, psi in found[:20]])) for kind, paths in motions.items()}


def run() -> dict:
    """Ratios of scatter to expectation, of the designed motion to the best random one, and the time it took [s]."""
    program = excitation_problem(load_machine("cat215b"), Fourier(29.0, 10))
    model, asked = program.information.model, program.information.parameters
    began = time.perf_counter()
    best = design(program, processes=CORES, search_seconds=SECONDS)
    took = time.perf_counter() - began
    with ProcessPoolExecutor(CORES, get_context("spawn")) as pool:
        value, x = min(shared(pool, parts.random_motions, program, RANDOM), key=lambda each: each[0])
        other = Excitation(program, x)
        found = shared(pool, parts.identified, best.trajectory, IDENTIFIED)
        found_by_other = shared(pool, parts.identified, other.trajectory, 20)
    expectation = expected_accuracy(model, best.trajectory, asked.structure)
    achieved, places = scatter(best.trajectory, asked.structure, found)
    ratio = achieved / expectation.base[places]
    # what the motion tells more of than was known before
    prior = np.linalg.inv(model.parameters.information) if np.all(np.diag(model.parameters.information) > 0) else None
    before = np.sqrt(np.diag(asked.structure.grouping @ prior @ asked.structure.grouping.T))[places] \
        if prior is not None else np.full(len(places), np.inf)
    told = expectation.base[places] < before
    ours, theirs = unseen_errors(model, program, found), unseen_errors(model, program, found_by_other)
    names = np.array(asked.names)[places]
    return {
        "design_s": round(took, 1), "all_limits_kept": all(use.room >= 0 for use in best.limits),
        "d_efficiency": round(math.exp((value - best.value) / 2), 2),
        "criterion_designed": round(best.value, 3), "criterion_best_random": round(value, 3),
        "base_parameters": len(asked.columns), "compared": len(places), "told_better_than_known": int(told.sum()),
        "scatter_to_expected": round(float(np.exp(np.mean(np.log(ratio[told])))), 3),
        "scatter_to_expected_lowest": round(float(ratio[told].min()), 3),
        "scatter_to_expected_highest": round(float(ratio[told].max()), 3),
        "highest_is": str(names[told][np.argmax(ratio[told])]),
        "scatter_to_expected_of_all": round(float(np.exp(np.mean(np.log(ratio)))), 3),
        "scatter_to_expected_of_all_lowest": round(float(ratio.min()), 3),
        "scatter_to_expected_of_all_highest": round(float(ratio.max()), 3),
        **{f"unseen_{kind}": round(error, 3) for kind, error in ours.items()},
        **{f"unseen_{kind}_by_random": round(error, 3) for kind, error in theirs.items()},
        **{f"unseen_{kind}_times_better": round(theirs[kind] / error, 2) for kind, error in ours.items()}}
