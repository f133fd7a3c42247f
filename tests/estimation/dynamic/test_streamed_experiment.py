"""Identification from a log in pieces against the same from memory, and against itself."""

from __future__ import annotations

import json
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydroopt import cli
from hydroopt.errors import LogError, ProblemError
from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.estimation.dynamic.friction_choice import friction_problem
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.estimation.dynamic.streamed_experiment import StreamedExperiment, streamed_experiment
from hydroopt.logs import stream as streaming
from hydroopt.logs.log import Log
from hydroopt.logs.log_files import read_log
from hydroopt.logs.smoothing import Fourier
from hydroopt.logs.stream import LogStream, stream
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory, simulate

BORDER = 1501
"""Rows of a piece, which nothing else is a multiple of."""


@pytest.fixture(scope="module")
def log(cat215b: Model, cat_truth: np.ndarray) -> Log:
    return simulate(cat215b, random_trajectory(cat215b, duration=160, rate=50, seed=5), cat_truth, seed=5)


@pytest.fixture(scope="module")
def path(log: Log, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("logs") / "log.parquet"
    log.write(file)
    return file


def identified(cat215b: Model, log: Log | LogStream, method: str = "wls") -> Estimate:
    train, unseen = log.split(0.7)
    problem = identification_problem(cat215b.machine, [train], [unseen])
    return identify(problem, method, intervals=False)  # type: ignore[arg-type]


def apart(one: Estimate, other: Estimate) -> float:
    """Largest difference of base parameters, in standard deviations."""
    assert one.identifiability.basis == other.identifiability.basis
    return float(np.max(np.abs(one.base_value - other.base_value) / one.base_std))


def test_pieces_tell_what_the_whole_tells(cat215b: Model, path: Path) -> None:
    whole, pieces = identified(cat215b, read_log(path)), identified(cat215b, stream(path, piece=BORDER))
    assert apart(whole, pieces) < 1e-6
    np.testing.assert_allclose(pieces.base_std, whole.base_std, rtol=1e-8)
    np.testing.assert_allclose(pieces.sigma, whole.sigma, rtol=1e-9)
    np.testing.assert_allclose(pieces.correlation_time, whole.correlation_time, rtol=1e-6)
    for part in ("train", "validation"):  # from residuals of every sample, and from triangles
        for channel, fit in whole.fit[part].items():
            other = pieces.fit[part][channel]
            assert (other.rms, other.vaf, other.relative) == pytest.approx((fit.rms, fit.vaf, fit.relative), rel=1e-6)
    left_out = "samples at the ends of stretches left out"
    for one, other in zip(whole.problem.experiments, pieces.problem.experiments, strict=True):
        assert one.sample_count == other.sample_count
        assert [n for n in one.notes if left_out in n or "still" in n] == [
            n for n in other.notes if left_out in n or "still" in n]


@pytest.mark.slow
def test_the_most_probable_machine_is_the_same(cat215b: Model, path: Path) -> None:
    whole, pieces = (identified(cat215b, one, "qp") for one in (read_log(path), stream(path, piece=BORDER)))
    scale = cat215b.parameters.scale
    np.testing.assert_allclose(pieces.psi / scale, whole.psi / scale, atol=1e-6)


@pytest.mark.slow
def test_borders_leave_no_trace_in_a_log_with_gaps_and_losses(
        cat215b: Model, log: Log, tmp_path: Path) -> None:
    broken = {name: x.copy() for name, x in log.channels.items()}
    broken["boom_cylinder.p_head"][BORDER - 3 : BORDER + 5] = np.nan
    broken["stick.q"][4000] = np.nan
    t = log.t + 2.0 * (log.t > 61.3)
    Log("broken", t, broken).write(tmp_path / "log.parquet")
    found = [identified(cat215b, stream(tmp_path / "log.parquet", piece=piece, treatment={"nan": "drop"}))
             for piece in (BORDER, 4000)]
    assert apart(*found) < 1e-6
    for one in found:
        rows = {(f.kind, f.channel): (f.first, f.last, f.count) for f in one.problem.experiments[0].log.findings}
        assert rows == {("nan", "boom_cylinder.p_head"): (1499, 1506, 8), ("nan", "stick.q"): (4001, 4001, 1),
                        ("gap", "t"): (1507, 3067, 2), ("irregular", "t"): (4002, 4002, 1)}


@pytest.fixture(scope="module")
def totals(cat215b: Model, path: Path) -> StreamedExperiment:
    made = streamed_experiment(cat215b, stream(path, piece=BORDER))
    return StreamedExperiment(cat215b, made.stream, made.smoothing, workers=1)


@pytest.mark.parametrize("workers", [2, 5])
def test_workers_change_no_bit(cat215b: Model, totals: StreamedExperiment, workers: int) -> None:
    other = StreamedExperiment(cat215b, totals.stream, totals.smoothing, workers)
    for one, two in ((totals.totals.known.triangles, other.totals.known.triangles),
                     (totals.totals.others, other.totals.others)):
        np.testing.assert_array_equal(one.full, two.full)
        np.testing.assert_array_equal(one.forces, two.forces)
    np.testing.assert_array_equal(totals.bands().counts, other.bands().counts)
    for one_block, two_block in zip(totals.bands().across[0], other.bands().across[0], strict=True):
        np.testing.assert_array_equal(one_block, two_block)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_log(cat215b: Model, log: Log, tmp_path: Path,
                                           monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streaming, "BLOCK", 256)
    monkeypatch.setattr("hydroopt.logs.formats.parquet_file.BATCH", 2048)
    peaks = []
    for copies in (2, 8):
        t = np.arange(copies * log.size) / 50
        Log("long", t, {name: np.tile(x, copies) for name, x in log.channels.items()}).write(tmp_path / "log.parquet")
        data = streamed_experiment(cat215b, stream(tmp_path / "log.parquet", piece=2000))
        tracemalloc.start()
        assert data.sample_count > 0.9 * t.size
        assert np.sum(data.bands().counts) > 0
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.25 * peaks[0], peaks


@pytest.mark.slow
def test_what_needs_all_samples_is_refused(cat215b: Model, path: Path) -> None:
    pieces = stream(path, piece=BORDER)
    problem = identification_problem(cat215b.machine, [pieces])
    for asked in (problem.with_loss("huber"), problem.with_fitted_motion(), problem.with_correlated_channels()):
        with pytest.raises(ProblemError, match=r"read in pieces, but .* needs all of it at once; .*rows = \["):
            identify(asked, "wls")
    with pytest.raises(ProblemError, match="a choice of friction needs all of it at once"):
        friction_problem(cat215b.machine, [pieces], [], "coulomb")
    with pytest.raises(ProblemError, match="only a smoothing spline joins"):
        identification_problem(cat215b.machine, [pieces], smoothing=Fourier(20.0, 10))
    with pytest.raises(ProblemError, match="the same samples are given twice"):
        identification_problem(cat215b.machine, [pieces], [pieces.slice(5000, 6000)])


def test_a_channel_that_is_missing_is_named(cat215b: Model, log: Log, tmp_path: Path) -> None:
    less = {name: x for name, x in log.channels.items() if name not in ("boom.q", "boom_cylinder.length")}
    Log("less", log.t, less).write(tmp_path / "log.parquet")
    with pytest.raises(LogError, match=r"no channel 'boom\.q' .*'boom\.q \[deg\]'"):
        identification_problem(cat215b.machine, [stream(tmp_path / "log.parquet")])


@pytest.mark.slow
def test_the_command_reads_long_files_in_pieces(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streaming, "STREAMED", 1000)
    monkeypatch.setattr(sys, "argv", ["hydroopt", "identify", "cat215b", str(path), "--holdout", "0.3", "--method",
                                      "wls", "-o", str(tmp_path), "--quiet"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 0
    content = json.loads((tmp_path / "estimate.json").read_text())
    rows = [(one["role"], one["first_sample"], one["last_sample"], one["samples"]) for one in content["inputs"]]
    assert rows == [("train", 1, 5600, 5600), ("validation", 5601, 8000, 2400)]
    assert any("read in pieces" in note for note in content["inputs"][0]["notes"])
    assert "read in pieces" in (tmp_path / "report.html").read_text()
    assert content["fit"]["validation"]["all"]["relative"] < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wheel_loader", "scissor_lift", "backhoe", "forestry_crane", "knuckle_boom_crane"])
def test_pieces_tell_what_the_whole_tells_of_other_machines(name: str, tmp_path: Path) -> None:
    """Loops, opposed cylinders, a chained telescope, joints that swing freely.

    Base parameters that the motion hardly determines follow the readings' last bits by more than 1e-6 of their
    standard deviations; pieces change them by no more than these bits do, whose draws differ by a factor of three.
    """
    model, path = Model(load_machine(name)), tmp_path / "log.parquet"
    simulate(model, random_trajectory(model, duration=66.56, rate=50, seed=2), seed=2).write(path)
    log, rng = read_log(path), np.random.default_rng(0)
    rounded = [replace(log, channels={name: np.nextafter(x, rng.choice([-np.inf, np.inf], x.shape))
                                      for name, x in log.channels.items()}) for _ in range(4)]
    whole, pieces, *others = (identify(identification_problem(model, [each]), "wls", intervals=False)
                              for each in (log, stream(path, piece=BORDER), *rounded))
    assert apart(whole, pieces) < 3 * max(apart(whole, other) for other in others) < 1e-3
    np.testing.assert_allclose(pieces.sigma, whole.sigma, rtol=1e-9)
