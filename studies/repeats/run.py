"""Do intervals hold when a machine is measured again? Parts of runs of three arms, and simulated sound logs."""

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hydroopt import (
    Log,
    Machine,
    Model,
    compare,
    identification_problem,
    load_machine,
    random_trajectory,
    random_truth,
    read_log,
    simulate,
    solve,
)
from hydroopt.estimation.dynamic.session_comparison import named_parts
from hydroopt.estimation.inference.identifiability import structural
from studies.panda_gaz2019 import run as panda
from studies.ur10e_mamedov import run as ur10e

KR300 = Path(__file__).parents[2] / "data" / "kr300"
SIMULATED = {"cat215b": (33.28, 50.0, 10), "kr300": (10.0, 250.0, 10)}
"""Duration [s], rate [Hz] and number of simulated machines."""
WITHIN = 1.96
WORDS = {2: "halves", 3: "thirds", 4: "quarters"}


def run() -> dict[str, Any] | None:
    """Shares of standardised differences within ±1.96, by method; p-values of no change; sound logs."""
    if not (ur10e.DATA.exists() and panda.DATA.exists()):
        return None
    results: dict[str, Any] = {}
    for method in ("sdp", "wls"):
        whole: list[np.ndarray] = []
        friction: list[np.ndarray] = []
        for name, (machine, parts) in runs().items():
            z, varying = differences(machine, parts, method)
            results[f"{name}_{method}"] = share(z)
            whole.append(z.ravel())
            friction.append(z[:, varying].ravel())
        results[f"agreement_{method}"] = share(np.concatenate(whole))
        results[f"agreement_{method}_friction_and_offsets"] = share(np.concatenate(friction))
    alarms: list[bool] = []
    for name, (machine, parts) in runs().items():
        change = compare(machine, [parts[0], parts[-1]])
        results |= {f"{name}_p": float(f"{change.p_value:.2g}"), f"{name}_phi": round(change.split_half, 2)}
        alarms.append(change.detected)
    results |= {"parts_compared": len(alarms), "alarms_between_parts": int(np.sum(alarms))}
    for name, (duration, rate, count) in SIMULATED.items():
        results |= sound(name, duration, rate, count)
    return results


def whole_runs() -> dict[str, tuple[Machine, Log]]:
    """Machines and one run of each, or of the UR10e three."""
    found = {"kr300": (load_machine("kr300"), read_log(KR300 / "run_A.mat", mapping=KR300 / "map.toml"))}
    for name in ("LEARNT", "UNSEEN", "UNLOADED"):
        found[f"ur10e_{name.lower()}"] = (load_machine("ur10e"), ur10e.log(*getattr(ur10e, name)))
    return found | {"panda": (load_machine("panda"), panda.recordings()[0])}


def runs() -> dict[str, tuple[Machine, list[Log]]]:
    """Machines and the parts of one of their runs."""
    counts = {"kr300": (2, 3), "panda": (4,)}
    return {f"{name}_{WORDS[count]}": (machine, parts_of(log, count))
            for name, (machine, log) in whole_runs().items() for count in counts.get(name, (2,))}


def parts_of(log: Log, count: int) -> list[Log]:
    """So many parts of equal length."""
    edges = np.linspace(0, log.size, count + 1).astype(int)
    return [log.slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]


def estimated(machine: Machine, log: Log, method: str) -> tuple[np.ndarray, np.ndarray]:
    """Structural base parameters and their standard deviations by one log."""
    model = Model(machine)
    found, grouping = solve(identification_problem(model, [log]), method), structural(model).grouping
    if found.posterior is not None:
        return grouping @ found.psi, found.posterior.interval(grouping)[0]
    R = found.weighted_residuals.R
    scaled = R * model.parameters.scale
    _, singular, axes = np.linalg.svd(scaled, full_matrices=False)
    known = singular > 1e-9 * singular[0]
    root = model.parameters.scale[:, None] * axes[known].T / singular[known]
    return grouping @ found.psi, np.linalg.norm(grouping @ root, axis=1)


def differences(machine: Machine, parts: Sequence[Log], method: str) -> tuple[np.ndarray, np.ndarray]:
    """Standardised differences (pairs, base parameters), and which of these are friction or offsets."""
    model = Model(machine)
    base = structural(model)
    varying = set(named_parts(model.parameters, ["friction", "offset"]))
    found = [estimated(machine, part, method) for part in parts]
    z = np.array([(a[0] - b[0]) / np.hypot(a[1], b[1]) for a, b in itertools.combinations(found, 2)])
    return z, np.array([model.parameters.names[k] in varying for k in base.basis])


def share(z: np.ndarray) -> float:
    """Part of standardised differences within ±1.96."""
    return round(float(np.mean(np.abs(z[np.isfinite(z)]) < WITHIN)), 3)


def sound(name: str, duration: float, rate: float, count: int) -> dict[str, Any]:
    """Coverage of the true base parameters, and errors over stated σ (RMS): 1 if intervals are as wide as need be."""
    machine = load_machine(name)
    model = Model(machine)
    z = []
    for seed in range(count):
        truth = random_truth(model, 7000 + seed)
        motion = random_trajectory(model, duration=duration, rate=rate, seed=8000 + seed)
        log = simulate(model, motion, truth, seed=seed)
        value, std = estimated(machine, log, "sdp")
        z.append((value - structural(model).grouping @ truth) / std)
    return {f"{name}_simulated_coverage": share(np.array(z)),
            f"{name}_simulated_error_over_std": round(float(np.sqrt(np.nanmean(np.array(z) ** 2))), 2)}
