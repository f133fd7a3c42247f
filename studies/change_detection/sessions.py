"""Five sessions in time order: false alarms of the whole comparison, power, the right session, drift against step."""

from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from hydroopt import Model, load_machine, random_trajectory, random_truth, simulate
from hydroopt.estimation.dynamic.change import named_parts, usual_parts
from hydroopt.estimation.dynamic.change_history import ChangeHistory, change_history
from hydroopt.estimation.dynamic.change_space import Shape
from hydroopt.estimation.dynamic.session_scan import session_scan
from hydroopt.estimation.dynamic.stored_information import StoredInformation, stored_information

SESSIONS, AT, LEVEL = 5, 3, 0.05
TRIALS, CHANGED = 200, 15
MACHINE, DURATION, RATE = "patu655_lift", 20.0, 50.0
OF = "lift_cylinder.f_coulomb"
"""The parameter that changes."""
SHAPES = {"step": Shape(AT), "drift": Shape(None)}


def run(trials: Iterable[int] = range(TRIALS), changed: Iterable[int] = range(CHANGED)) -> dict[str, Any]:
    """Shares of alarms and of names at 5 % where nothing changed, and what is said of a step and of a drift."""
    with threadpool_limits(limits=1, user_api="blas"):
        return _shares(Model(load_machine(MACHINE)), trials, changed)


def _shares(model: Model, trials: Iterable[int], changed: Iterable[int]) -> dict[str, Any]:
    parts = named_parts(model.parameters, usual_parts(model.parameters))
    place, alarms, names, seen = parts.index(OF), [], [], []
    said: dict[str, list[str]] = {shape: [] for shape in SHAPES}
    for seed in trials:
        truth = random_truth(model, seed)
        sound = [_session(model, truth, 10 * seed + k) for k in range(SESSIONS)]
        scan = session_scan(model, parts, sound)
        alarms.append(scan.p_value < LEVEL)
        names.append(alarms[-1] and np.nanmin(scan.p_values) < LEVEL)
        if seed not in changed:
            continue
        put_down, alarm = (sizes[place, AT - 2] for sizes in scan.detectable(LEVEL))
        seen.append(_changed(model, parts, truth, seed, sound, Shape(AT), alarm).detected)
        for word, shape in SHAPES.items():
            history = _changed(model, parts, truth, seed, sound, shape, 2 * put_down).history(OF)
            right = history.session == (AT if word == "step" else None)
            said[word].append(str(history.course) if right or history.course != "step" else "wrong session")
    counts = {word: Counter(courses) for word, courses in said.items()}
    return {"sessions_false_alarms": round(float(np.mean(alarms)), 4),
            "sessions_false_names": round(float(np.mean(names)), 4),
            "sessions_power_at_detectable": round(float(np.mean(seen)), 3),
            "sessions_step_at_right_session": counts["step"]["step"],
            "sessions_step_undecided": counts["step"]["undecided"],
            "sessions_step_wrong": counts["step"]["drift"] + counts["step"]["wrong session"],
            "sessions_drift_right": counts["drift"]["drift"], "sessions_drift_undecided": counts["drift"]["undecided"],
            "sessions_drift_wrong": counts["drift"]["step"] + counts["drift"]["wrong session"]}


def _changed(model: Model, parts: tuple[str, ...], truth: np.ndarray, seed: int, sound: list[StoredInformation],
             shape: Shape, size: float) -> ChangeHistory:
    """The comparison where one parameter follows a shape of this size."""
    sessions = []
    for k, part in enumerate(shape.course(SESSIONS)):
        moved = truth.copy()
        moved[model.parameters.index(OF)] += size * part
        sessions.append(sound[k] if part == 0 else _session(model, moved, 10 * seed + k))
    return change_history(model, parts, sessions, LEVEL)


def _session(model: Model, psi: np.ndarray, seed: int) -> StoredInformation:
    motion = random_trajectory(model, duration=DURATION, rate=RATE, seed=300_000 + seed)
    return stored_information(model, [simulate(model, motion, psi, seed=300_000 + seed)])
