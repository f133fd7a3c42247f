"""Logs that lack forces or samples: what is there is used, what is lost is said."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from fixtures.two_sessions import SPATIAL, recorded
from hydroopt.errors import LogError
from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.estimation.dynamic.friction_choice import choose_friction
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.payload import payload
from hydroopt.estimation.dynamic.problem import IdentificationProblem, identification_problem
from hydroopt.logs.log import Log
from hydroopt.logs.log_files import read_log
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.report import identification as page
from hydroopt.results.diagnostic import of_kind
from hydroopt.simulation.simulate import random_trajectory, simulate

LOST = "boom_cylinder.p_head"
WITH_CYLINDERS = Model(load_machine("cat215b"))


@pytest.fixture(scope="module")
def logs() -> list[Log]:
    """Two logs with the noise of the machine file's sensors."""
    return [replace(simulate(WITH_CYLINDERS, random_trajectory(WITH_CYLINDERS, duration=12.0, rate=50.0, seed=seed),
                             seed=seed), name=f"motion {seed}") for seed in (1, 2)]


def lacking(log: Log, *channels: str) -> Log:
    return replace(log, channels={name: x for name, x in log.channels.items() if name not in channels})


def with_holes(log: Log, rows: slice, *channels: str) -> Log:
    there = np.ones(log.size, bool)
    there[rows] = False
    return replace(log, channels={name: np.where(there, x, np.nan) if name in channels else x
                                  for name, x in log.channels.items()})


def unmeasured(machine: Machine, name: str) -> Machine:
    """The machine whose file says that a cylinder is not measured."""
    data = machine.model_dump(exclude={"notes"})
    cylinders = [each | {"measured": each["name"] != name} for each in data["cylinders"]]
    return Machine.model_validate({**data, "cylinders": cylinders, "notes": machine.notes})


def predicted(estimate: Estimate, *rows: int) -> np.ndarray:
    return estimate.predictions["validation"][0][:, list(rows)]


def test_a_missing_pressure_is_the_same_as_an_actuator_that_is_not_measured(logs: list[Log]) -> None:
    """Apart from rounding: the equations are compiled from other expressions."""
    machine, (log, other) = WITH_CYLINDERS.machine, logs
    found = identify(identification_problem(machine, [lacking(log, LOST)], [other]), intervals=False)
    stated = identify(identification_problem(unmeasured(machine, "boom_cylinder"), [log], [other]), intervals=False)
    assert found.problem.parameters.names == stated.problem.parameters.names
    ours, theirs = predicted(found, 0, 2), predicted(stated, 0, 1)
    assert np.max(np.abs(ours - theirs)) < 1e-9 * np.max(np.abs(theirs))
    assert found.identifiability.category == stated.identifiability.category
    assert found.sigma[[0, 2]] == pytest.approx(stated.sigma, rel=1e-10)
    assert found.correlation_time[[0, 2]] == pytest.approx(stated.correlation_time, rel=1e-9)
    assert sorted(found.fit["train"]) == ["all", "stick_cylinder", "swing_motor"]
    (lost,) = of_kind(found.diagnostics, "force not measured in a log")
    assert lost.subject == ("boom_cylinder",)
    assert lost.evidence["channels"] == LOST
    assert found.machine.cylinders[0].measured
    assert found.next_steps[0].text == "Record the force of boom_cylinder, or its pressures."


def of_problem(change: Callable[[IdentificationProblem], IdentificationProblem]) -> Callable[[list[Log]], Estimate]:
    return lambda logs: identify(change(identification_problem(WITH_CYLINDERS, logs)), intervals=False)


WAYS = {
    "squares": of_problem(lambda problem: problem), "huber": of_problem(lambda problem: problem.with_loss("huber")),
    "correlated": of_problem(lambda problem: problem.with_correlated_channels()),
    "faults": of_problem(lambda problem: problem.free("delay", "offset")),
    "fitted motion": of_problem(lambda problem: problem.with_fitted_motion()),
    "choice of friction": lambda logs: choose_friction(
        WITH_CYLINDERS.machine, logs[:1], logs[1:], ["coulomb", "coulomb+viscous"], method="wls")}


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("way", ["squares", *(pytest.param(way, marks=pytest.mark.slow)
                                              for way in WAYS if way != "squares")])
@pytest.mark.parametrize("lost", ["all of one log", "all of both", "a stretch"])
def test_every_way_of_estimation_does_without(logs: list[Log], way: str, lost: str) -> None:
    partly = with_holes(logs[0], np.s_[100:220], LOST) if lost == "a stretch" else lacking(logs[0], LOST)
    other = lacking(logs[1], LOST) if lost == "all of both" else logs[1]
    found = WAYS[way]([partly, other])
    assert np.all(np.isfinite(found.psi))
    assert ("boom_cylinder" in found.fit["train"]) is not (lost == "all of both" or (
        way == "choice of friction" and lost == "all of one log"))
    assert found.diagnostics
    html = page.render(found)
    assert "lacks boom_cylinder.p_head" in html or lost == "a stretch"
    assert "nan" not in re.sub("<script.*?</script>", "", html.lower().partition("<body>")[2], flags=re.DOTALL)


def test_a_stretch_without_a_pressure_costs_this_equation_alone(logs: list[Log]) -> None:
    whole, found = (identification_problem(WITH_CYLINDERS, [log]).experiments[0]
                    for log in (logs[0], with_holes(logs[0], np.s_[100:220], LOST)))
    told = np.ones((logs[0].size, 3), bool)
    told[100:220, 1] = False
    np.testing.assert_array_equal(found.known, whole.known & told)
    np.testing.assert_array_equal(found.motion.q, whole.motion.q)
    np.testing.assert_array_equal(found.force[told], whole.force[told])


def test_a_stretch_without_angle_is_the_same_as_two_stretches(logs: list[Log], tmp_path: Path) -> None:
    with_holes(logs[0], np.s_[100:160], "boom.q").write(tmp_path / "holes.csv")
    holes, whole = read_log(tmp_path / "holes.csv"), logs[0]
    there = np.r_[:100, 160:whole.size]
    cut = Log(whole.name, whole.t[there], {name: x[there] for name, x in whole.channels.items()},
              there + 1, (there >= 160).astype(int))
    assert "boom.q: samples 101–160 hold no finite number; dropped" in [one.text for one in holes.findings]
    found, stated = (identify(identification_problem(WITH_CYLINDERS, [log]), seed=1) for log in (holes, cut))
    np.testing.assert_array_equal(found.psi, stated.psi)
    np.testing.assert_array_equal(found.std, stated.std)


def test_a_dead_sensor_is_the_same_as_a_missing_one(logs: list[Log]) -> None:
    dead = replace(logs[0], channels={**logs[0].channels, LOST: np.full(logs[0].size, 1.3e7)})
    found, stated = (identification_problem(WITH_CYLINDERS, [log]) for log in (dead, lacking(logs[0], LOST)))
    np.testing.assert_array_equal(found.experiments[0].known, stated.experiments[0].known)
    texts = [one.text for one in found.experiments[0].log.findings]
    assert f"{LOST} reads 1.3e+07 Pa in all samples while boom moves; left out" in texts


def test_a_chamber_that_is_open_to_the_tank_stays(logs: list[Log]) -> None:
    vented = replace(logs[0], channels={**logs[0].channels, "boom_cylinder.p_rod": np.full(logs[0].size, 2e5)})
    assert np.all(np.isfinite(identification_problem(WITH_CYLINDERS, [vented]).experiments[0].plotted.force))


def test_a_log_without_any_force_is_refused(logs: list[Log]) -> None:
    none = lacking(logs[0], *(name for name in logs[0].channels if ".p_" in name))
    with pytest.raises(LogError, match=r"there is no channel 'swing_motor\.p_a'"):
        identification_problem(WITH_CYLINDERS, [none])


def test_a_long_log_does_without_as_well(logs: list[Log], tmp_path: Path, in_pieces: Callable[[int], None]) -> None:
    columns = {f"{name} [{logs[0].units[name]}]": x for name, x in
               with_holes(logs[0], np.s_[100:220], "stick_cylinder.p_rod").channels.items()}
    columns[f"{LOST} [Pa]"] = np.full(logs[0].size, np.nan)
    parquet.write_table(pa.table({"t [s]": logs[0].t, **columns}), tmp_path / "long.parquet")
    whole = identification_problem(WITH_CYLINDERS, [read_log(tmp_path / "long.parquet")])
    stated = identify(whole, intervals=False)
    in_pieces(300)
    problem = identification_problem(WITH_CYLINDERS, [read_log(tmp_path / "long.parquet")])
    (pieces,) = problem.experiments
    assert len(pieces.log.spans) > 1
    found = identify(problem, intervals=False)
    assert found.weighted_residuals.samples == pytest.approx(stated.weighted_residuals.samples)
    assert found.sigma[[0, 2]] == pytest.approx(stated.sigma[[0, 2]], rel=0.05)
    assert sorted(found.fit["train"]) == ["all", "stick_cylinder", "swing_motor"]
    assert of_kind(found.diagnostics, "force not measured in a log")
    assert np.isfinite(pieces.moments(found.psi)).all()


def test_a_load_is_weighed_without_one_torque() -> None:
    """What the other joints tell of it: the load's mass within its interval, which is wider."""
    psi = SPATIAL.parameters.nominal
    loaded = psi.copy()
    loaded[SPATIAL.parameters.index("fore.m")] += 2.0
    loaded[SPATIAL.parameters.index("fore.mc_x")] += 2.0 * 0.8
    first, second = recorded(SPATIAL, psi, 1, 0.5), recorded(SPATIAL, loaded, 2, 0.5)
    whole = payload(SPATIAL.machine, [first], [second])
    partly = payload(SPATIAL.machine, [first], [lacking(second, "post.tau")])
    (lost,) = of_kind(partly.diagnostics, "force not measured in a log")
    assert lost.evidence["log"] == second.name
    assert whole.mass.std <= 1.1 * partly.mass.std
    assert abs(partly.mass.value - 2.0) < 3 * partly.mass.std
