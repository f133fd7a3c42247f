"""Logs recorded with the calibrator attached: identified without bias where its bodies are described."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from fixtures.calibrator_with_bodies import attached, attached_motion, motion_about_middle, with_calibrator
from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Fourier
from hydroopt.machine.machine_file import dump_machine, load_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import Trajectory, forces, random_truth, simulate

SECONDS, SAMPLES = 20.0, 300
SMOOTHING = Fourier(SECONDS, 7)
MACHINE = with_calibrator("ball")
FREE = Model(MACHINE)


@cache
def truth(seed: int = 3) -> np.ndarray:
    return random_truth(Model(MACHINE, calibrator=True), seed)


@cache
def log(seed: int, *, with_rig: bool, noise: bool = False, samples: int = SAMPLES) -> Log:
    subject = attached(MACHINE)
    motion = (attached_motion(subject, SECONDS, samples, seed) if with_rig
              else Trajectory(*motion_about_middle(SECONDS, samples, seed)))
    return simulate(subject.model, motion, truth(), noise=noise, seed=seed, name=f"log {seed}")


def unseen_error(psi: np.ndarray) -> np.ndarray:
    """RMS error (n,) of the free machine's forces in an unseen motion, as a part of their RMS."""
    motion = Trajectory(*motion_about_middle(SECONDS, 300, 77))
    true, found = (forces(FREE, motion, values[: len(FREE.parameters)]) for values in (truth(), psi))
    return np.asarray(np.sqrt(np.mean((found - true) ** 2, axis=0) / np.mean(true**2, axis=0)))


@pytest.mark.parametrize("method", [pytest.param("wls", marks=pytest.mark.slow), "sdp"])
@pytest.mark.slow
def test_free_and_attached_logs_together_give_back_the_truth(method: str) -> None:
    problem = identification_problem(MACHINE, [log(1, with_rig=True), log(2, with_rig=True), log(3, with_rig=False)],
                                     [log(4, with_rig=True), log(5, with_rig=False)], smoothing=SMOOTHING)
    assert problem.parameters.names[-10] == "rig_5.m"
    assert "its tip in 'post'" in problem.experiments[0].notes[-1]
    estimate = identify(problem, method, tolerance=1e-9, intervals=False)  # type: ignore[arg-type]
    assert max(fit.relative for fit in estimate.fit["validation"].values()) < 1e-8
    assert np.max(unseen_error(estimate.psi)) < 1e-7


@pytest.mark.slow
def test_attached_logs_are_biased_unless_the_calibrator_is_described(tmp_path: Path) -> None:
    logs = [log(seed, with_rig=True, noise=True) for seed in (31, 32)]
    described = identify(identification_problem(MACHINE, logs), "sdp", intervals=False)
    ignored = identify(identification_problem(FREE, logs), "sdp", intervals=False)
    assert np.max(unseen_error(described.psi)) < 0.15
    assert np.max(unseen_error(ignored.psi)) > 5 * np.max(unseen_error(described.psi))
    saved(described, tmp_path)


def saved(estimate: Estimate, folder: Path) -> None:
    """The calibrated machine has the calibrator's bodies."""
    estimate.save(folder / "out", pages={})
    file = folder / "calibrated.toml"
    file.write_text(dump_machine(estimate.machine))
    again = load_machine(file)
    assert again.calibrator is not None
    body = again.calibrator.links[2].body
    assert body is not None
    assert body.m == pytest.approx(estimate.psi[estimate.problem.parameters.index("rig_2.m")])


@pytest.mark.slow
def test_calibrator_without_bodies_stays_unused() -> None:
    data = MACHINE.model_dump()
    for link in data["calibrator"]["links"]:
        link["body"] = None
    problem = identification_problem(type(MACHINE).model_validate(data), [log(1, with_rig=True)], smoothing=SMOOTHING)
    assert len(problem.parameters) == len(FREE.parameters)
    assert any(note.startswith("not used: ") and "rig_2.q" in note for note in problem.experiments[0].notes)


def test_what_needs_another_motion_is_refused() -> None:
    problem = identification_problem(MACHINE, [log(1, with_rig=True)], smoothing=SMOOTHING)
    with pytest.raises(ProblemError, match="fitted motion cannot be combined with an attached calibrator"):
        problem.with_fitted_motion()
    with pytest.raises(ProblemError, match="instruments cannot be combined with an attached calibrator"):
        problem.with_instruments()
    data = MACHINE.model_dump() | {"fixtures": []}
    with pytest.raises(ProblemError, match="states no fixture"):
        identification_problem(type(MACHINE).model_validate(data), [log(1, with_rig=True)], smoothing=SMOOTHING)
