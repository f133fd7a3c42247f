"""UR10e, published runs: unseen motion by the definition of their source, a damaged log, and a known payload."""

from pathlib import Path

import numpy as np
from scipy.signal import butter, filtfilt

from hydroopt import Log, LogError, Machine, identification_problem, load_machine, payload, read_log, solve
from hydroopt.logs.log import read_map

HERE = Path(__file__).parent
DATA = HERE.parents[2] / "shared" / "data" / "ur10e_mamedov" / "dataset_ur10e"
LEARNT = ("identification_data/ur-20_02_10-30sec_12harm", 635, 3510)
UNSEEN = ("validation_data/ur-20_01_17-ptp_10_points", 700, 4200)
UNLOADED = ("identification_data/ur-20_02_19_14harm50sec", 195, 4966)
LOADED = ("identification_data/ur-20_02_19_14harm50secLoad", 308, 5071)
DAMAGED = "identification_data/ur-20_02_19_15harm50secLoad"
"""Logs and, as in the source's scripts, their first and last rows."""
LOAD = 2.805
"""Mass of the load [kg], by the source."""
DEAD_ZONES = (None, 0.003, 0.01, 0.03)
GAINS = (0.0, 0.05, 0.1, 0.2)


def run() -> dict | None:
    """Residuals ‖error‖/‖torque‖ over all joints [%] and the payload [kg]; None where the data are not at hand."""
    if not DATA.exists():
        return None
    machine, learnt, unseen = load_machine("ur10e"), log(*LEARNT), log(*UNSEEN)
    first, last = learnt.split(0.7)
    results: dict = {}
    for width in DEAD_ZONES:  # judged by the last part of the learnt log alone
        problem = identification_problem(with_dead_zone(machine, width), [first], [last])
        found = residuals(solve(problem, intervals=False), "validation")
        results |= {f"holdout_dead_zone_{width}{name}": value for name, value in found.items()}
    for method in ("wls", "sdp"):
        estimate = solve(identification_problem(machine, [learnt], [unseen]), method, intervals=False)
        for which in ("train", "validation"):
            results |= {f"{method}_{which}{name}": value for name, value in residuals(estimate, which).items()}
        results[f"{method}_inconsistent_bodies"] = sum(s < 0 for s in estimate.consistency.values())
    estimate = solve(identification_problem(with_dead_zone(machine, None), [learnt], [unseen]), intervals=False)
    results |= {f"no_dead_zone_validation{name}": value for name, value in residuals(estimate, "validation").items()}
    return results | damaged(machine) | carried(machine)


def log(name: str, first: int | None = None, last: int | None = None) -> Log:
    """A log, or its rows `first` to `last`, which count from 1."""
    rows = None if first is None else (first, last)
    return read_log(DATA / f"{name}.csv", mapping=read_map(HERE / "map.toml").model_copy(update={"rows": rows}))


def with_dead_zone(machine: Machine, width: float | None) -> Machine:
    """The machine with a dead zone [rad/s] of this width in all of its drives."""
    drives = [drive.model_copy(update={"friction": drive.friction.model_copy(update={"dead_zone": width})})
              for drive in machine.drives]
    return machine.model_copy(update={"drives": tuple(drives)})


def residuals(estimate, which: str) -> dict[str, float]:
    """Residuals by what is filtered: the measured torque (the source's definition), both torques, none.

    The filter is that of the source for currents: Butterworth of order 5 to a tenth of half the sampling rate, forward
    and backward.
    """
    data = (estimate.problem.experiments if which == "train" else estimate.problem.validation)[0]
    measured, predicted = data.force, estimate.predict(data)
    low, low_predicted = (filtfilt(*butter(5, 0.1), force, axis=0) for force in (measured, predicted))
    pairs = {"": (low, predicted), "_both_filtered": (low, low_predicted), "_unfiltered": (measured, predicted)}
    return {name: round(100 * float(np.linalg.norm((a - b)[data.inside]) / np.linalg.norm(a[data.inside])), 2)
            for name, (a, b) in pairs.items()}


def damaged(machine: Machine) -> dict:
    """What is said of the damaged log, and what its sound rows tell."""
    try:
        log(DAMAGED)
        said = ""
    except LogError as error:
        said = f"{error.what} -> {error.remedy}"
    sound = log(DAMAGED, 11, 6106)
    estimate = solve(identification_problem(machine, [sound]), "wls", intervals=False)
    return {"damaged_rows_named": said.startswith("data rows 2–10, 6107 are damaged") and "rows = [11, 6106]" in said,
            "sound_samples": len(sound.t), "sound_train": residuals(estimate, "train")[""]}


def carried(machine: Machine) -> dict:
    """The load's mass [kg] with its 95 % interval, by what the drive gains may be off; `payload` is that by 10 %."""
    results: dict = {}
    for gain in GAINS:
        mass = payload(machine, [log(*UNLOADED)], [log(*LOADED)], friction_changes=True, gain=gain).mass
        name = "payload" if gain == 0.1 else f"payload_gains_to_{gain:g}"
        results |= {f"{name}_kg": round(mass.value, 3), f"{name}_ci95": tuple(round(end, 3) for end in mass.ci95)}
    low, high = results["payload_ci95"]
    return results | {"payload_error_percent": round(100 * abs(results["payload_kg"] / LOAD - 1), 1),
                      "payload_in_its_interval": low <= LOAD <= high}
