"""The generated feedback and on-line estimation of valves: what Python does in the same loop."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fixtures.library import NOT_FINITE, OK, OPEN_TRIANGLE, OUT_OF_RANGE, Library, machine, subject
from fixtures.tiers import tiered
from hydroopt import random_trajectory
from hydroopt.codegen import self_test
from hydroopt.control.axes import Axes
from hydroopt.control.cascade import Cascade, Gains
from hydroopt.control.closed_loop import simulate
from hydroopt.control.linear_plant import Reading
from hydroopt.control.reference import Demands, Reference, flow_demand
from hydroopt.control.valve_inversion import Valves
from hydroopt.control.valve_refit import ValveRefit
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.simulation.simulate import Trajectory

PERIOD = 0.02


class Watched(Cascade):
    """A cascade that keeps what it reads and gives."""

    def __init__(self, *given: object, refit: ValveRefit) -> None:
        super().__init__(*given, refit=refit)
        self.seen: list[dict[str, np.ndarray]] = []

    def command(self, k: int, reading: Reading) -> np.ndarray:
        before = {"speed_before": self._filtered, "integral": self._integral, "opening_before": self._opening,
                  "acting": self.refit.acting, "state": self.refit.state}
        command = super().command(k, reading)
        given = {"q": reading.q, "q_demanded": self.demand.q[k], "force_measured": reading.force,
                 "force_demanded": self.demand.measured_force[k], "pressure_a": reading.pressure[:, 0],
                 "pressure_b": reading.pressure[:, 1], "supply": reading.supply, "period": [self.period]}
        self.seen.append(before | given | {
            "position_gain": self.gains.position, "force_gain": self.gains.force,
            "integral_time": self.gains.integral_time, "filter_time": self.gains.filter_time,
            ":speed": self._filtered, ":integral": self._integral, ":factors": self.refit.factors,
            ":state": self.refit.state})
        return command


def driven(plant: Plant, flows: float) -> Watched:
    """A loop of 6 s, within the pump's flow, on a machine whose flows are `flows` times those that are known."""
    psi, theta = plant.model.parameters.nominal, plant.parameters.nominal
    true = theta * np.where([".flow_" in key or "rated_flow" in key for key in plant.parameters.names], flows, 1.0)
    t = np.arange(300) * PERIOD
    fast = random_trajectory(plant.model, duration=6.0, rate=1 / PERIOD, seed=1, slowest=0.05, fastest=0.15)
    most = plant.machine.pump.max_flow if plant.machine.pump else None
    longer = max(1.0, 1.2 * flow_demand(plant, fast.q, fast.qd).max() / most) if most else 1.0
    motion = Trajectory(longer * fast.t, fast.q, fast.qd / longer, fast.qdd / longer**2)
    demands, one = Demands(Valves(plant, theta), Reference(motion), t), np.ones(len(Axes(plant).names))
    gains = Gains(1.5 * one, 1e-8 * np.ones(len(plant.actuators)), 2.0 * one, 0.05 * one)
    watched = Watched(demands.valves, demands.by(plant.model, psi), gains, PERIOD,
                      refit=ValveRefit(plant, theta, PERIOD))
    simulate(demands, watched, plant, psi, true, seed=1)
    return watched


@pytest.fixture(scope="module", params=[pytest.param("backhoe", marks=pytest.mark.slow), "patu655_lift"])
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Watched, Library]:
    """A loop with flows a tenth above what the controller knows, and the generated C."""
    plant = Plant(Model(machine(request.param)))
    made = subject(request.param, "double", "valve_refit", "position_feedback")
    return driven(plant, 1.1), Library(made, tmp_path_factory.mktemp("c") / "c", "-O2")


def rows(watched: Watched) -> dict[str, np.ndarray]:
    return {key: np.array([row[key] for row in watched.seen]) for key in watched.seen[0]}


def test_c_feeds_back_as_python_does(case: tuple[Watched, Library]) -> None:
    watched, library = case
    given = rows(watched)
    status, found = library.call("position_feedback", library.prepare(), given, len(watched.seen))
    assert np.all(status == OK)
    assert_allclose(found["speed_added"], given[":speed"], rtol=1e-9, atol=1e-12)
    assert_allclose(found["integral"], given[":integral"], rtol=1e-9, atol=1e-12)


def test_c_learns_the_valves_as_python_does(case: tuple[Watched, Library]) -> None:
    """From sample to sample with the state that C itself kept."""
    watched, library = case
    params, given = library.prepare(), rows(watched)
    state = np.zeros_like(given["state"][0])
    for k in range(len(watched.seen)):
        one = {key: values[k:k + 1] for key, values in given.items()} | {"state": state[None]}
        status, found = library.call("valve_refit", params, one, 1)
        assert status[0] == OK
        state = found["state"][0]
    factors = np.stack([found["factor_extending"][0], found["factor_retracting"][0]], axis=1)
    assert_allclose(factors, given[":factors"][-1], rtol=1e-9)
    assert_allclose(state, given[":state"][-1], rtol=1e-8, atol=1e-12)


def test_flows_that_are_off_are_found(case: tuple[Watched, Library]) -> None:
    """Each factor that was seen is the true one within its error; the others keep what was known of them."""
    watched, _ = case
    refit = watched.refit
    seen = refit.std < 0.05
    assert np.any(seen)
    assert np.all(np.abs(refit.factors - 1.1)[seen] < np.maximum(3.5 * refit.std, 0.02)[seen])
    assert np.all(np.abs(refit.factors - 1.0)[~seen] < 0.15)


def test_c_refuses_what_cannot_be(case: tuple[Watched, Library]) -> None:
    watched, library = case
    params, good = library.prepare(), {key: values[:1] for key, values in rows(watched).items()}
    nothing = good | {"pressure_a": np.full_like(good["pressure_a"], np.nan)}
    assert library.call("valve_refit", params, nothing, 1)[0][0] == NOT_FINITE
    for period in (0.0, -0.02, 1.0):
        for routine in ("valve_refit", "position_feedback"):
            assert library.call(routine, params, good | {"period": np.array([[period]])}, 1)[0][0] == OUT_OF_RANGE
    never = good | {"integral_time": 0 * good["integral_time"]}
    assert library.call("position_feedback", params, never, 1)[0][0] == OUT_OF_RANGE


@pytest.mark.parametrize("real", tiered(["double", "float"], lambda real: real == "double"))
def test_demands_that_no_linkage_can_reach_have_a_status(real: str, tmp_path: Path) -> None:
    """The bucket's linkage closes where the bucket is, and cannot where the motion demands it."""
    library = Library(subject("excavator_bucket", real, "position_feedback"), tmp_path / "c", "-O0")
    count, states = 500, self_test.states(library.interface, 1, seed=3)
    given = {key: np.repeat(values, count, axis=0) for key, values in states.items() if values.ndim == 2}
    given["q_demanded"][:, -1] = np.linspace(-1.5, 1.5, count) * np.pi
    status, found = library.call("position_feedback", library.prepare(), given, count)
    assert set(status) == {OK, OPEN_TRIANGLE, OUT_OF_RANGE}
    assert all(np.all(np.isfinite(found[member][status == OK])) for member in found.dtype.names)
    middle = np.mean(library.interface.machine.link("bucket").joint.range)
    assert np.all((status == OUT_OF_RANGE) == (np.abs(given["q_demanded"][:, -1] - middle) > np.pi))
