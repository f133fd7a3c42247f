"""Several sessions: false alarms of the whole comparison, power, the right session, drift against step, real runs."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from hydroopt import Model, load_machine, random_trajectory, random_truth, simulate
from hydroopt.estimation.dynamic.change import usual_names
from hydroopt.estimation.dynamic.change_history import change_history
from hydroopt.estimation.dynamic.change_space import Shape
from hydroopt.estimation.dynamic.session_scan import session_scan
from hydroopt.estimation.dynamic.session_scatter import random_amounts
from hydroopt.estimation.dynamic.stored_information import StoredInformation, stored_information
from studies.repeats.run import parts_of, whole_runs

SESSIONS, AT, LEVEL = 5, 3, 0.05
SCATTER = 0.05
"""Random differences of friction and offsets from session to session, RMS over the friction force."""
PARTS = (3, 4)
"""Into how many sessions real runs are cut."""


class Case(NamedTuple):
    """A simulated machine, which parameter changes and by how much, and how many trials there are."""

    machine: str
    duration: float
    rate: float
    changes: str
    size: float
    trials: int
    courses: int


CASES = (Case("cat215b", 33.28, 50.0, "boom_cylinder.f_coulomb", 400.0, 40, 12),
         Case("patu655_lift", 20.0, 50.0, "lift_cylinder.f_coulomb", 200.0, 60, 15))


def run() -> dict[str, Any]:
    """Simulated machines and parts of real runs; shares at 5 %."""
    with threadpool_limits(limits=1, user_api="blas"):
        found = {f"{case.machine}_sessions_{key}": value for case in CASES for key, value in simulated(case).items()}
        return found | real()


def simulated(case: Case) -> dict[str, Any]:
    """Alarms where nothing changed, and where sessions scatter; power and names of a step and a drift."""
    model = Model(load_machine(case.machine))
    parts = usual_names(model.parameters)
    place, k = parts.index(case.changes), model.parameters.index(case.changes)
    alarms: dict[str, list[bool]] = {key: [] for key in ("sound", "names", "scatter", "step", "drift", "detectable")}
    said: dict[str, list[str]] = {"step": [], "drift": []}
    for seed in range(case.trials):
        truth, rng = random_truth(model, seed), np.random.default_rng(seed)
        sound = [_session(case, model, truth, 10 * seed + number) for number in range(SESSIONS)]
        scan = session_scan(model, parts, sound)
        alarms["sound"].append(scan.p_value < LEVEL)
        alarms["names"].append(alarms["sound"][-1] and np.nanmin(scan.p_values) < LEVEL)
        alarms["scatter"].append(session_scan(model, parts, list(_scattered(model, parts, sound, rng))).p_value < LEVEL)
        stepped = truth.copy()
        stepped[k] += case.size
        later = [_session(case, model, stepped, 10 * seed + number) for number in range(AT - 1, SESSIONS)]
        alarms["step"].append(session_scan(model, parts, [*sound[: AT - 1], *later]).p_value < LEVEL)
        drifting = _following(sound, k, case.size, Shape(None))
        alarms["drift"].append(session_scan(model, parts, drifting).p_value < LEVEL)
        if seed >= case.courses:
            continue
        put_down, alarm = (sizes[place, AT - 2] for sizes in scan.detectable(LEVEL))
        alarms["detectable"].append(
            session_scan(model, parts, _following(sound, k, alarm, Shape(AT))).p_value < LEVEL)
        for word, shape in (("step", Shape(AT)), ("drift", Shape(None))):
            history = change_history(model, parts, _following(sound, k, 2 * put_down, shape), LEVEL).history(
                case.changes)
            right = history.session == shape.session
            said[word].append(str(history.course) if right or history.course != "step" else "wrong session")
    shares = {key: round(float(np.mean(some)), 3) for key, some in alarms.items()}
    counts = {word: Counter(courses) for word, courses in said.items()}
    size = f"{case.size:.0f}"
    return {"trials": case.trials, "false_alarms": shares["sound"], "false_names": shares["names"],
            "scattered_false_alarms": shares["scatter"], f"power_step_{size}_n": shares["step"],
            f"power_drift_{size}_n": shares["drift"], "power_at_detectable": shares["detectable"],
            "courses": case.courses, "step_at_right_session": counts["step"]["step"],
            "step_undecided": counts["step"]["undecided"],
            "step_wrong": counts["step"]["drift"] + counts["step"]["wrong session"],
            "drift_right": counts["drift"]["drift"], "drift_undecided": counts["drift"]["undecided"],
            "drift_wrong": counts["drift"]["step"] + counts["drift"]["wrong session"]}


def real() -> dict[str, Any]:
    """p-values of parts of one run of real arms as sessions, and how many raise an alarm."""
    p_values = {}
    for name, (machine, log) in whole_runs().items():
        model = Model(machine)
        parts = usual_names(model.parameters)
        for count in PARTS:
            sessions = [stored_information(model, [part]) for part in parts_of(log, count)]
            p_values[f"{name}_{count}_parts_p"] = float(f"{session_scan(model, parts, sessions).p_value:.2g}")
    return p_values | {"runs_in_parts": len(p_values), "alarms_within_runs": sum(p < LEVEL for p in p_values.values())}


def _session(case: Case, model: Model, psi: np.ndarray, seed: int) -> StoredInformation:
    motion = random_trajectory(model, duration=case.duration, rate=case.rate, seed=300_000 + seed)
    return stored_information(model, [simulate(model, motion, psi, seed=300_000 + seed)])


def _following(sessions: Sequence[StoredInformation], k: int, size: float, shape: Shape) -> list[StoredInformation]:
    """The same sessions where a parameter follows a shape."""
    return [_moved(session, np.array([k]), np.array([size * part]))
            for session, part in zip(sessions, shape.course(len(sessions)), strict=True)]


def _scattered(model: Model, parts: Sequence[str], sessions: Sequence[StoredInformation],
               rng: np.random.Generator) -> Iterator[StoredInformation]:
    """The same sessions where friction and offsets are off by random amounts, those of some more than of others."""
    places = model.parameters.select(parts)
    sizes = SCATTER * random_amounts(model, places, sessions) * np.exp(rng.standard_normal(len(places)) / 2)
    for session in sessions:
        yield _moved(session, places, sizes * rng.standard_normal(len(places)))


def _moved(session: StoredInformation, places: np.ndarray, change: np.ndarray) -> StoredInformation:
    """The information of a session in which some parameters differ: forces are linear in them, weights stay."""
    triangles = session.triangles.copy()
    triangles[:, :, -1] += triangles[:, :, places] @ change
    return replace(session, triangles=triangles)
