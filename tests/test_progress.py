"""Long computations tell what part of them is done."""

from __future__ import annotations

from collections.abc import Callable

import pytest

import hydroopt as ho
from hydroopt.codegen.folder import Code
from hydroopt.codegen.parameter_source import read
from hydroopt.excitation.selection.exchange import fedorov_exchange
from hydroopt.excitation.selection.pose_problem import pose_problem
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.support.progress import Progress

LIFT = "patu655_lift"


def logs(count: int) -> list[ho.Log]:
    return [ho.simulate(LIFT, ho.random_trajectory(LIFT, duration=8, rate=20, seed=k), seed=k) for k in range(count)]


def planned(progress: Progress) -> None:
    fedorov_exchange(pose_problem(load_machine("panda_mukca"), 8), candidates=30, progress=progress)


def compared(progress: Progress) -> None:
    ho.compare(LIFT, logs(2), progress=progress)


def compared_several(progress: Progress) -> None:
    ho.compare(LIFT, logs(3), progress=progress)


def written(progress: Progress) -> None:
    machine: Machine
    machine, origin = read(LIFT)
    Code(machine, origin, routines=["inverse_dynamics"]).files(progress)


@pytest.mark.parametrize(("job", "steps"), [(planned, 12), (compared, 3), (compared_several, 4), (written, 4)])
def test_the_part_that_is_done_grows_from_none_to_nearly_all(job: Callable[[Progress], None], steps: int) -> None:
    told: list[tuple[str, float | None]] = []
    job(lambda text, part=None, /: told.append((text, part)))
    parts = [part for _, part in told]
    assert len(told) == steps
    assert len({text for text, _ in told}) == steps
    assert parts == sorted(parts)
    assert parts[0] == 0
    assert 0.3 < parts[-1] < 1
