"""A log that contradicts the machine file makes the answer suspect, and no machine is made of it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import hydroopt as ho
from hydroopt.cli import app
from hydroopt.errors import SolverError
from hydroopt.results.status import Status


@pytest.fixture(scope="module")
def log() -> ho.Log:
    model = ho.Model(ho.load_machine("cat215b"))
    motion = ho.random_trajectory(model, duration=16.0, rate=50.0, seed=1)
    return ho.simulate(model, motion, ho.random_truth(model, seed=1), seed=1)


def test_a_reversed_sign_is_named_first_and_no_machine_is_saved(log: ho.Log) -> None:
    flipped = replace(log, channels={**log.channels, "boom.q": -log.channels["boom.q"]})
    estimate = ho.solve(ho.identification_problem(ho.load_machine("cat215b"), [flipped]), "wls", intervals=False)
    assert estimate.status is Status.SUSPECT
    assert (estimate.diagnostics[0].kind, estimate.diagnostics[0].subject) == ("log misread", ("boom.q",))
    assert "cat215b.toml" not in estimate.files()


def test_a_sound_log_is_not_refuted(log: ho.Log) -> None:
    estimate = ho.solve(ho.identification_problem(ho.load_machine("cat215b"), [log]), "wls", intervals=False)
    assert not estimate.refuted


FLIPPED = ("the sign of boom.q reversed", lambda channels: {**channels, "boom.q": -channels["boom.q"]})
IN_BAR = ("all pressures in bar", lambda channels: {name: values / 1e5 if ".p_" in name else values
                                                    for name, values in channels.items()})
EXCHANGED = ("boom.q and stick.q exchanged",
             lambda channels: {**channels, "boom.q": channels["stick.q"], "stick.q": channels["boom.q"]})


@pytest.mark.slow
@pytest.mark.parametrize(("reading", "mistake", "loaded"), [(*FLIPPED, False), (*IN_BAR, True), (*EXCHANGED, False)])
def test_a_payload_names_the_mistake_in_either_session(log: ho.Log, reading, mistake, loaded: bool) -> None:
    halves = log.split(0.5)
    wrong = replace(halves[loaded], channels=mistake(halves[loaded].channels))
    found = ho.payload(ho.load_machine("cat215b"), *(([halves[0]], [wrong]) if loaded else ([wrong], [halves[1]])))
    assert found.status is Status.SUSPECT
    assert found.refuted
    assert (found.diagnostics[0].kind, found.diagnostics[0].evidence["reading"]) == ("log misread", reading)


def test_the_command_ends_with_3_unless_forced(log: ho.Log, tmp_path: Path) -> None:
    bar = {name: values / 1e5 if ".p_" in name else values for name, values in log.channels.items()}
    replace(log, channels=bar).to_frame().to_parquet(tmp_path / "bar.parquet")
    arguments = ["identify", "cat215b", str(tmp_path / "bar.parquet"), "--method", "wls", "-o", str(tmp_path / "out")]
    done = CliRunner().invoke(app, arguments)
    assert isinstance(done.exception, SolverError), done.output
    assert done.exception.exit_code == 3
    assert "or accept it with --force" in str(done.exception)
    assert "suspect. Read with all pressures in bar" in done.output
    assert not (tmp_path / "out/cat215b.toml").exists()
    assert ho.load(tmp_path / "out").status is Status.SUSPECT


@pytest.fixture(scope="module")
def in_degrees() -> tuple[ho.Model, ho.Log]:
    model = ho.Model("excavator_bucket")
    log = ho.simulate(model, ho.random_trajectory(model, duration=12.0, rate=25.0, seed=1), seed=1)
    angles = {name: x for name, x in log.channels.items() if ".length" not in name}
    return model, replace(log, channels={**angles, "bucket.q": np.degrees(angles["bucket.q"])})


def test_what_ends_a_fit_is_named_by_the_mistake_in_the_log(in_degrees: tuple[ho.Model, ho.Log]) -> None:
    """Time in milliseconds lets no joint move; angles in degrees open a linkage, so that the model is no number."""
    lift = ho.Model("patu655_lift")
    log = ho.simulate(lift, ho.random_trajectory(lift, duration=12.0, rate=25.0, seed=1), seed=1)
    slow = replace(log, t=1000 * log.t)
    with pytest.raises(SolverError, match="agrees with the time in milliseconds"):
        ho.solve(ho.identification_problem(lift, [slow]), "wls", intervals=False)
    with pytest.raises(SolverError, match=r"agrees with bucket\.q in deg"):
        ho.solve(ho.identification_problem(in_degrees[0], [in_degrees[1]]), "wls", intervals=False)


def test_postures_that_the_machine_cannot_take_are_refused(in_degrees: tuple[ho.Model, ho.Log],
                                                           monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where no mistake explains them."""
    monkeypatch.setattr("hydroopt.estimation.dynamic.identify.contradictions", lambda *_: ())
    with pytest.raises(ho.LogError, match=r"a linkage does not close, .*unit, sign or zero of bucket\.q,"):
        ho.solve(ho.identification_problem(in_degrees[0], [in_degrees[1]]), "wls", intervals=False)


def test_a_log_without_sensor_errors_is_called_so(log: ho.Log) -> None:
    """Smoothing as the sensors' rates ask for would be what is left."""
    model = ho.Model(ho.load_machine("patu655_lift").model_copy(update={"sensors": (), "bandwidth": None}))
    exact = ho.simulate(model, ho.random_trajectory(model, duration=12.0, rate=50.0, seed=1), seed=1)
    found = ho.solve(ho.identification_problem(model, [exact]), "wls", intervals=False)
    assert any(each.kind == "no sensor errors in the log" for each in found.diagnostics)
    other = ho.solve(ho.identification_problem("cat215b", [log]), "wls", intervals=False)
    assert not any(each.kind == "no sensor errors in the log" for each in other.diagnostics)
