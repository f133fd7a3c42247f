"""Identification from a log in pieces against the same at once."""

from __future__ import annotations

import json
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydroopt import cli
from hydroopt.estimation.dynamic import experiment as experiments
from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.estimation.dynamic.experiment import experiment
from hydroopt.estimation.dynamic.friction_choice import friction_problem
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import IdentificationProblem, identification_problem
from hydroopt.logs import log as logs
from hydroopt.logs import mapped
from hydroopt.logs.log import Log
from hydroopt.logs.log_files import read_log
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory, simulate

BORDER = 1501
"""Samples of a piece, which nothing else is a multiple of."""
Change = Callable[[IdentificationProblem], IdentificationProblem]


@pytest.fixture(scope="module")
def log(cat215b: Model, cat_truth: np.ndarray) -> Log:
    return simulate(cat215b, random_trajectory(cat215b, duration=160, rate=50, seed=5), cat_truth, seed=5)


def identified(cat215b: Model, log: Log, method: str = "wls", change: Change = lambda same: same) -> Estimate:
    train, unseen = log.split(0.7)
    problem = change(identification_problem(cat215b.machine, [train], [unseen]))
    return identify(problem, method, intervals=False)  # type: ignore[arg-type]


def apart(one: Estimate, other: Estimate) -> float:
    """Largest difference of base parameters, in standard deviations."""
    assert one.identifiability.basis == other.identifiability.basis
    return float(np.max(np.abs(one.base_value - other.base_value) / one.base_std))


@pytest.mark.parametrize("change", [
    lambda same: same, lambda problem: problem.with_loss("huber"), lambda problem: problem.with_correlated_channels()],
    ids=["squares", "huber", "correlated"])
def test_pieces_tell_what_the_whole_tells(
        cat215b: Model, log: Log, in_pieces: Callable[[int], None], change: Change) -> None:
    whole = identified(cat215b, log, change=change)
    in_pieces(BORDER)
    pieces = identified(cat215b, log, change=change)
    assert len(pieces.problem.experiments[0].log.spans) == 4
    assert apart(whole, pieces) < 1e-6
    np.testing.assert_allclose(pieces.base_std, whole.base_std, rtol=1e-8)
    np.testing.assert_allclose(pieces.sigma, whole.sigma, rtol=1e-8)
    np.testing.assert_allclose(pieces.correlation_time, whole.correlation_time, rtol=1e-6)
    for part in ("train", "validation"):
        for channel, fit in whole.fit[part].items():
            other = pieces.fit[part][channel]
            assert (other.rms, other.vaf, other.relative) == pytest.approx((fit.rms, fit.vaf, fit.relative), rel=1e-6)
    for one, other in zip(whole.problem.experiments, pieces.problem.experiments, strict=True):
        assert one.sample_count == other.sample_count
        assert one.notes[-1:] == other.notes[-1:]


@pytest.mark.slow
def test_the_most_probable_machine_is_the_same(cat215b: Model, log: Log, in_pieces: Callable[[int], None]) -> None:
    whole = identified(cat215b, log, "qp")
    in_pieces(BORDER)
    np.testing.assert_allclose(*(one.psi / cat215b.parameters.scale for one in (identified(cat215b, log, "qp"), whole)),
                               atol=1e-6)


@pytest.mark.slow
def test_friction_that_is_not_linear_takes_long_logs(
        cat215b: Model, log: Log, in_pieces: Callable[[int], None]) -> None:
    def fitted() -> Estimate:
        problem = friction_problem(cat215b.machine, [log], [], "coulomb+viscous+stribeck")
        return identify(problem, "nlp", intervals=False)

    whole = fitted()
    in_pieces(BORDER)
    scale = whole.problem.parameters.scale
    np.testing.assert_allclose(fitted().psi / scale, whole.psi / scale, atol=1e-5)


@pytest.mark.slow
def test_borders_leave_no_trace_in_a_log_with_gaps_and_losses(
        cat215b: Model, log: Log, tmp_path: Path, in_pieces: Callable[[int], None]) -> None:
    broken = {name: x.copy() for name, x in log.channels.items()}
    broken["boom_cylinder.p_head"][BORDER - 3 : BORDER + 5] = np.nan
    broken["stick.q"][4000] = np.nan
    t = log.t + 2.0 * (log.t > 61.3)
    Log("broken", t, broken).write(tmp_path / "log.parquet")
    found = []
    for piece in (10_000, BORDER, 4000):
        in_pieces(piece)
        found.append(identified(cat215b, read_log(tmp_path / "log.parquet", treatment={"nan": "drop"})))
    assert max(apart(found[0], other) for other in found[1:]) < 1e-6
    for one in found:
        rows = {(f.kind, f.channel): (f.first, f.last, f.count) for f in one.problem.experiments[0].log.findings}
        assert rows == {("nan", "boom_cylinder.p_head"): (1499, 1506, 8), ("nan", "stick.q"): (4001, 4001, 1),
                        ("gap", "t"): (1507, 3067, 2), ("irregular", "t"): (4002, 4002, 1)}


@pytest.mark.slow
def test_memory_hardly_grows_with_the_log(cat215b: Model, log: Log, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                          in_pieces: Callable[[int], None]) -> None:
    in_pieces(2000)
    monkeypatch.setattr(logs, "BLOCK", 256)
    monkeypatch.setattr(logs, "SAMPLE", 4096)
    monkeypatch.setattr(mapped, "MAPPED", 4000)
    monkeypatch.setattr("hydroopt.logs.formats.parquet_file.BATCH", 2048)
    peaks = []
    for copies in (2, 8):
        t = np.arange(copies * log.size) / 50
        Log("long", t, {name: np.tile(x, copies) for name, x in log.channels.items()}).write(tmp_path / "log.parquet")
        tracemalloc.start()
        data = experiment(cat215b, read_log(tmp_path / "log.parquet"))
        assert data.sample_count > 0.9 * t.size
        assert np.sum(data.bands().counts) > 0
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    numbers = (peaks[1] - peaks[0]) / (6 * log.size) / 8
    assert numbers < 4, "a sample is thirty numbers, of which few are in memory at a time"


@pytest.mark.slow
def test_a_log_in_memory_is_that_of_a_file(cat215b: Model, log: Log, tmp_path: Path) -> None:
    copies = 25
    t, rng = np.arange(copies * log.size) / 50, np.random.default_rng(1)
    made = Log("long", t, {name: np.tile(x, copies) + 1e-3 * np.std(x) * rng.standard_normal(t.size)
                           for name, x in log.channels.items()}, units=log.units)
    made.write(tmp_path / "long.parquet")
    kept, read = (identified(cat215b, one) for one in (made, read_log(tmp_path / "long.parquet")))
    assert apart(kept, read) < 1e-6
    np.testing.assert_allclose(read.base_std, kept.base_std, rtol=1e-8)


@pytest.mark.slow
def test_the_command_shows_a_part_of_a_long_file(log: Log, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log.write(tmp_path / "log.parquet")
    monkeypatch.setattr(experiments, "SHOWN", 1000)
    monkeypatch.setattr(experiments, "BLOCK", 1000)
    monkeypatch.setattr(sys, "argv", ["hydroopt", "identify", "cat215b", str(tmp_path / "log.parquet"), "--holdout",
                                      "0.3", "--method", "wls", "-o", str(tmp_path / "out"), "--quiet"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 0
    content = json.loads((tmp_path / "out/estimate.json").read_text())
    rows = [(one["role"], one["first_sample"], one["last_sample"], one["samples"]) for one in content["inputs"]]
    assert rows == [("train", 1, 5600, 5600), ("validation", 5601, 8000, 2400)]
    assert any("figures and diagnostics show samples" in note for note in content["inputs"][0]["notes"])
    assert "figures and diagnostics show samples" in (tmp_path / "out/report.html").read_text()
    assert content["fit"]["validation"]["all"]["relative"] < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wheel_loader", "scissor_lift", "backhoe", "forestry_crane", "knuckle_boom_crane"])
def test_pieces_tell_what_the_whole_tells_of_other_machines(name: str, in_pieces: Callable[[int], None]) -> None:
    """Loops, opposed cylinders, a chained telescope, joints that swing freely.

    Base parameters that the motion hardly determines follow the readings' last bits by more than 1e-6 of their
    standard deviations; pieces change them by no more than these bits do, whose draws differ by a factor of three.
    """
    model, rng = Model(load_machine(name)), np.random.default_rng(0)
    log = simulate(model, random_trajectory(model, duration=66.56, rate=50, seed=2), seed=2)
    rounded = [replace(log, channels={name: np.nextafter(x, rng.choice([-np.inf, np.inf], x.shape))
                                      for name, x in log.channels.items()}) for _ in range(4)]
    whole, *others = (identify(identification_problem(model, [each]), "wls", intervals=False)
                      for each in (log, *rounded))
    in_pieces(BORDER)
    pieces = identify(identification_problem(model, [log]), "wls", intervals=False)
    assert apart(whole, pieces) < 3 * max(apart(whole, other) for other in others) < 1e-3
    np.testing.assert_allclose(pieces.sigma, whole.sigma, rtol=1e-9)
