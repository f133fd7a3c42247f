"""Tables of few poses: planned postures read by drawn machines, sound or with one reading that is grossly wrong."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hydroopt import KinematicModel, Machine, Poses, calibration_problem, load_machine, pose_problem, solve
from hydroopt.errors import SolverError
from hydroopt.excitation.selection.measure_up import MeasureUpPlan, fewest_readings, measure_up_problem
from hydroopt.results.status import Status
from hydroopt.simulation.pose_table import simulate_poses
from studies.show import table as show

FIRST, TABLES = 7000, 20
"""First seed, none of which served to choose a rule, and tables of each plan."""
SPOILT, GROSS = 8, 100.0
"""Tables of each plan in which one reading is off by so many times its stated accuracy."""
POSES = {"panda_mukca": (7, 10, 20), "tampere_manipulator": (4, 5, 8), "patu655": (7, 10), "backhoe": (6, 12)}
"""Poses of each fixture, or in all, that are planned, by machine."""
MEASURE_UP = Path(__file__).parents[2] / "docs" / "how-to" / "measure_up.toml"
TIPS = (0.03, 0.02, 0.015, 0.01, 0.007)
"""Standard deviations of the tip [m] that measure-ups are planned to."""


class Plan(NamedTuple):
    """Planned postures of a machine, and how to make a table as it would be read of one with all its readings."""

    machine: Machine
    postures: Poses
    read: Callable[[Poses], Poses] = lambda table: table


def plans() -> Iterator[Plan]:
    """All plans."""
    for name, counts in POSES.items():
        machine = load_machine(name)
        for count in counts:
            yield Plan(machine, solve(pose_problem(machine, count, priors=True), candidates=60).postures)
    machine = load_machine(MEASURE_UP)
    for tip in TIPS:
        planned = fewest_readings(measure_up_problem(machine, tip=tip), candidates=20)
        yield Plan(machine, planned.postures, partial(filled_in, planned))


def filled_in(planned: MeasureUpPlan, table: Poses) -> Poses:
    """The planned readings of a table, without the others."""
    channels = dict(table.channels)
    for taken, each in zip(planned.taken.T, planned.readings, strict=True):
        channels |= {name: np.where(taken, channels[name], np.nan) for name in each.channels}
    return replace(table, channels=channels)


def spoilt(machine: Machine, table: Poses, rng: np.random.Generator) -> tuple[Poses, int]:
    """The table with one reading off by `GROSS` times its accuracy, and its row."""
    problem = calibration_problem(machine, table)
    sigma = dict(zip(problem.model.channels, problem.row_sigma.T, strict=True)) | {
        f"{joint}.q": np.full(len(table), value)
        for joint, value in zip(problem.model.joints, problem.angle_sigma, strict=True)}
    read = [(name, row) for name, values in table.channels.items() for row in np.flatnonzero(np.isfinite(values))
            if name in sigma and np.isfinite(sigma[name][row]) and sigma[name][row] > 0]
    name, row = read[rng.integers(len(read))]
    values = table.channels[name].copy()
    values[row] += GROSS * sigma[name][row] * rng.choice([-1, 1])
    return replace(table, channels={**table.channels, name: values}), row


def verdict(machine: Machine, table: Poses, row: int) -> tuple[bool, bool]:
    """Whether a table is not taken as sound, and whether the pose in a row is named."""
    try:
        answer = solve(calibration_problem(machine, table))
    except SolverError as error:  # as of a linkage that no posture closes
        return True, error.where.endswith(f"data row {row + 1}")
    return (answer.status is not Status.OK or bool(answer.suspects),
            any(each.kind == "pose" and bool(each.poses[row]) for each in answer.suspects))


def run() -> dict:
    """How many sound tables are not taken as such, and how many wrong ones are."""
    found = []
    for machine, planned, read in plans():
        model, suspect, wrong = KinematicModel(machine), 0, []
        for k in range(TABLES):
            sound = read(simulate_poses(model, planned, random=True, seed=FIRST + k).poses)
            suspect += verdict(machine, sound, 0)[0]
            if k < SPOILT:
                wrong.append(verdict(machine, *spoilt(machine, sound, np.random.default_rng(FIRST + k))))
        found.append((machine.name, len(planned), TABLES, suspect, SPOILT, *np.sum(wrong, axis=0)))
    show("Tables of few poses", ("machine", "poses", "sound", "suspect", "wrong", "noticed", "its pose named"), found)
    tables, suspect, total, noticed, named = np.sum([each[2:] for each in found], axis=0).tolist()
    return {"tables_of_few_poses": tables, "false_alarms_of_few_poses": round(suspect / tables, 3),
            "gross_errors_of_few_poses": total, "gross_errors_noticed": round(noticed / total, 3),
            "gross_errors_named": round(named / total, 3)}
