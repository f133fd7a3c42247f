"""Identification from pressures that lag behind: the model lags alike."""

import numpy as np
import pytest

import hydroopt as ho
from hydroopt.errors import MachineError, ProblemError
from hydroopt.estimation.dynamic.experiment import experiment
from hydroopt.logs.lag import lagged
from hydroopt.machine.links import Note
from hydroopt.machine.machine_file import dump_machine, read_machine

PRESSURES = ("p_head", "p_rod", "p_a", "p_b")


def machine_of(lag: float, sigma: float | None = None) -> ho.Machine:
    """The excavator whose pressure transducers lag."""
    machine = ho.load_machine("cat215b")
    data, notes = machine.model_dump(exclude={"notes"}), dict(machine.notes)
    for k, sensor in enumerate(data["sensors"]):
        if sensor["channels"][0].rpartition(".")[2] in PRESSURES:
            sensor["lag"] = lag
            notes |= {f"sensors.{k}.lag": Note(sigma=sigma)} if sigma else {}
    return ho.Machine.model_validate(data | {"notes": notes})


@pytest.fixture(scope="module")
def late():
    model = ho.Model(machine_of(0.06))
    truth = ho.random_truth(model, 1)
    course = ho.random_trajectory(model, duration=30.0, rate=50.0, seed=2, fastest=0.6)
    return model, truth, course


def test_the_model_lags_as_readings_do(late):
    model, truth, course = late
    log = ho.simulate(model, course, truth, noise=False)
    made = experiment(model, log)
    forces = model.over(model.inverse_dynamics, course.q, course.qd, course.qdd, truth)[0][:, :, 0]
    true = lagged(course.t, forces, 0.06)
    assert made.force == pytest.approx(true, rel=1e-6, abs=1.0)
    off = (made.predicted(truth) - made.force)[made.inside[:, None] & made.known]
    assert np.sqrt(np.mean(off**2)) < 0.003 * np.sqrt(np.mean(made.force**2))


def test_forces_are_as_good_as_without_a_lag(late):
    model, truth, course = late
    unseen = ho.random_trajectory(model, duration=30.0, rate=50.0, seed=3, fastest=0.6)
    K = model.over(model.regressor, unseen.q, unseen.qd, unseen.qdd)[0]

    def error(said: ho.Machine, true: ho.Machine) -> float:
        log = ho.simulate(ho.Model(true), course, truth, seed=1)
        problem = ho.identification_problem(said, [log])
        return float(np.sqrt(np.mean((K @ (ho.solve(problem, intervals=False).psi - truth) / problem.force_std) ** 2)))

    sound = error(machine_of(0.0), machine_of(0.0))
    assert error(machine_of(0.06), machine_of(0.06)) < 1.2 * sound
    assert error(machine_of(0.0), machine_of(0.06)) > 4 * sound


def test_what_a_lag_may_differ_by_is_freed_within_its_sigma(late):
    model, truth, course = late
    log = ho.simulate(model, course, truth, seed=1)
    estimate = ho.solve(ho.identification_problem(machine_of(0.045, 0.01), [log]).free("lag"))
    found, = estimate.freed.as_dicts()
    assert found["prior_std"] == pytest.approx(10.0)
    assert abs(found["size"] - 15.0) < 3 * found["std"] < 5.0


def test_what_cannot_be_combined_is_refused(late):
    model, truth, course = late
    log = ho.simulate(model, course, truth)
    problem = ho.identification_problem(model, [log])
    for combined in (problem.with_fitted_motion, problem.with_instruments):
        with pytest.raises(ProblemError, match="cannot be combined with forces that lag"):
            combined()


def test_a_lag_has_a_place_in_the_machine_file():
    machine = machine_of(0.06, 0.01)
    again = read_machine(dump_machine(machine))
    channel = "boom_cylinder.p_head"
    assert again.lag(channel) == machine.lag(channel)
    assert (again.lag(channel).value, again.lag(channel).sigma) == (0.06, pytest.approx(0.01))
    assert again.lag("boom.q").value == 0.0
    with pytest.raises(MachineError, match=r"a lag of 'pump.p_supply' has no meaning here"):
        read_machine(dump_machine(machine) + '\n[[sensors]]\nchannels = ["pump.p_supply"]\naccuracy = "1 bar"\n'
                     'lag = "10 ms"\n')
    with pytest.raises(MachineError, match="lag"):
        read_machine(dump_machine(machine) + '\n[[sensors]]\nchannels = ["swing.qd"]\naccuracy = "1 deg/s"\n'
                     'lag = "-10 ms"\n')
