"""Several sessions: false alarms of the whole comparison, power, the right session, drift against step, real runs."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from hydroopt import Model, load_machine, random_trajectory, random_truth, simulate
from hydroopt.estimation.dynamic.session_comparison import SessionComparison, session_comparison, usual_names
from hydroopt.estimation.dynamic.session_model import Shape, random_amounts
from hydroopt.estimation.dynamic.stored_information import StoredInformation, stored_information
from studies.repeats.run import parts_of, whole_runs

SESSIONS, AT, LEVEL = 5, 3, 0.05
SCATTER = 0.05
"""Random differences of friction and offsets from session to session, RMS over the friction force."""
DECIDED = 0.95
"""Probability above which `compare` states one shape."""
LARGE = 2.0
"""Size of the changes whose shape is asked for, over the one that is stated as detectable."""
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
    alarms: dict[str, list[bool]] = {key: [] for key in (
        "sound", "scatter", "step", "drift", "detectable", "interval", "others")}
    said: dict[str, list[str]] = {"step": [], "drift": []}

    def compared(sessions: Sequence[StoredInformation]) -> SessionComparison:
        return session_comparison(model, parts, sessions, LEVEL)

    for seed in range(case.trials):
        truth, rng = random_truth(model, seed), np.random.default_rng(seed)
        sound = [_session(case, model, truth, 10 * seed + number) for number in range(SESSIONS)]
        quiet = compared(sound)
        alarms["sound"].append(quiet.detected)
        alarms["scatter"].append(compared(list(_scattered(model, parts, sound, rng))).detected)
        stepped = truth.copy()
        stepped[k] += case.size
        later = [_session(case, model, stepped, 10 * seed + number) for number in range(AT - 1, SESSIONS)]
        alarms["step"].append(compared([*sound[: AT - 1], *later]).detected)
        alarms["drift"].append(compared(_following(sound, k, case.size, Shape(None))).detected)
        if seed >= case.courses:
            continue
        detectable = quiet.differences[place].detectable[AT - 2]
        alarms["detectable"].append(compared(_following(sound, k, detectable, Shape(AT))).detected)
        for word, shape in (("step", Shape(AT)), ("drift", Shape(None))):
            found = compared(_following(sound, k, LARGE * detectable, shape))
            decided = found.shapes[0][1] > DECIDED
            said[word].append("undecided" if not decided else "right" if found.shape == shape else "wrong")
            if found.shape == shape:
                own = found.differences[place]
                alarms["interval"].append(own.ci95[0] <= LARGE * detectable <= own.ci95[1])
                alarms["others"].append(any(one.changed for one in found.differences if one is not own))
    shares = {key: round(float(np.mean(some)), 3) for key, some in alarms.items()}
    counts = {word: Counter(courses) for word, courses in said.items()}
    size = f"{case.size:.0f}"
    return {"trials": case.trials, "false_alarms": shares["sound"], "false_names": shares["others"],
            "interval_coverage": shares["interval"], "scattered_false_alarms": shares["scatter"],
            f"power_step_{size}_n": shares["step"], f"power_drift_{size}_n": shares["drift"],
            "power_at_detectable": shares["detectable"],
            "courses": case.courses, "step_at_right_session": counts["step"]["right"],
            "step_undecided": counts["step"]["undecided"], "step_wrong": counts["step"]["wrong"],
            "drift_right": counts["drift"]["right"], "drift_undecided": counts["drift"]["undecided"],
            "drift_wrong": counts["drift"]["wrong"]}


def real() -> dict[str, Any]:
    """p-values of parts of one run of real arms as sessions, and how many raise an alarm."""
    p_values = {}
    for name, (machine, log) in whole_runs().items():
        model = Model(machine)
        parts = usual_names(model.parameters)
        for count in PARTS:
            sessions = [stored_information(model, [part]) for part in parts_of(log, count)]
            found = session_comparison(model, parts, sessions, LEVEL)
            p_values[f"{name}_{count}_parts_p"] = float(f"{found.p_value:.2g}")
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
