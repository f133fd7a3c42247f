"""Every bundled machine: its file, its weight against its actuators, and the main jobs with it."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from fixtures import library
from fixtures.periodic import PERIOD, PERIODIC
from fixtures.tiers import machines, tiered
from hydroopt.cli import app
from hydroopt.cli.machine_facts import machine_facts
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.machine.actuators import Drive
from hydroopt.machine.machine_file import bundled, load_machine
from hydroopt.model.model import Model
from hydroopt.simulation.passive_joints import passive_motion
from hydroopt.simulation.simulate import Trajectory, forces, random_trajectory, random_truth, simulate
from oracles.subjects import states

MODELS = Path(__file__).parents[1] / "models"
LONG = {"cat215b", "panda", "panda_mukca", "kr300", "stewart_platform", "ur10", "ur10e"}
"""Machines with several parameter sets, valves or six joints and more, whose files may be longer than 150 lines."""
UNACTUATED = {"panda_mukca"}
"""Machines that state geometry only: no bodies, so that nothing is to be identified from forces."""
DYNAMIC = tuple(name for name in bundled() if name not in UNACTUATED)
SWINGING = ("forestry_crane",)
"""Machines with passive joints, whose motion no period repeats."""
FROM_UNITS = ("excavator_imu",)
"""Machines without sensors at joints: splines through rates and accelerations give the motion, not a Fourier series."""


@cache
def model(name: str) -> Model:
    return Model(load_machine(name))


@pytest.mark.parametrize("name", machines())
def test_file_is_short_and_says_where_its_numbers_come_from(name: str) -> None:
    lines = (MODELS / f"{name}.toml").read_text("utf-8").splitlines()
    assert len(lines) <= 150 or name in LONG
    assert all(line.startswith("#") for line in lines[:2]), "the header says what it is and where its numbers come from"
    machine = load_machine(name)
    assert machine.name == name
    assert machine.description
    unsourced = [path for path, note in machine.notes.items() if note.sigma is not None and not note.source]
    assert not unsourced, f"{unsourced[:3]} state a confidence without a source"


@pytest.mark.parametrize("name", machines(DYNAMIC))
def test_actuators_carry_the_weight(name: str) -> None:
    """Static forces in random postures stay within what relief pressures and motors allow."""
    subject = model(name)
    q, qd, qdd = states(subject.machine, np.random.default_rng(1), 400)
    held = forces(subject, Trajectory(np.arange(400.0), q, 0 * qd, 0 * qdd), subject.parameters.nominal)
    assert np.all(np.isfinite(held))
    for k, balance in enumerate(subject.machine.balances):
        if balance.alone is None:
            continue  # several actuators share the load, or none is there
        if isinstance(balance.alone, Drive):
            push = pull = balance.alone.max_torque
        else:
            push, pull = ((area * balance.alone.relief_pressure if balance.alone.relief_pressure else None)
                          for area in balance.alone.areas)
        if push is not None:
            assert -pull < held[:, k].min(), f"{balance.name} cannot hold the machine"
            assert held[:, k].max() < push, f"{balance.name} cannot hold the machine"


@pytest.mark.parametrize("name", machines())
def test_show_has_nothing_to_object(name: str) -> None:
    facts = machine_facts(load_machine(name))
    assert not facts["diagnostics"]
    assert all(each["margin_deg"] > 10 for each in facts["linkages"])


@pytest.mark.parametrize("name", tiered(
    [name for name in DYNAMIC if name not in SWINGING + FROM_UNITS], lambda name: name in ("patu655", "scissor_lift")))
def test_perfect_sensors_give_back_the_truth(name: str) -> None:
    """From four motions: in two the pins of an excavator's boom turn alike, which leaves their friction together."""
    subject = model(name)
    truth = random_truth(subject, 3)
    logs = [simulate(subject, random_trajectory(subject, duration=PERIOD, rate=12.5, seed=seed), truth, noise=False,
                     name=f"motion {seed}") for seed in (1, 2, 3, 4, 99)]
    problem = identification_problem(subject.machine, logs[:4], logs[4:], smoothing=PERIODIC)
    estimate = identify(problem, "wls", tolerance=1e-9, intervals=False)
    assert max(fit.relative for fit in estimate.fit["validation"].values()) < 1e-9
    state = states(subject.machine, np.random.default_rng(2), 200)
    (K,) = subject.over(subject.regressor, *state)
    np.testing.assert_allclose(K @ estimate.psi, K @ truth, rtol=0, atol=1e-8 * np.max(np.abs(K @ truth)))


@pytest.mark.slow
@pytest.mark.parametrize("name", FROM_UNITS)
def test_perfect_units_leave_a_hundredth_of_what_pressures_err(name: str) -> None:
    subject = model(name)
    truth = random_truth(subject, 3)
    logs = [simulate(subject, random_trajectory(subject, duration=PERIOD, rate=50, seed=seed), truth, noise=False,
                     name=f"motion {seed}") for seed in (1, 2, 99)]
    estimate = identify(identification_problem(subject.machine, logs[:2], logs[2:]), "wls", intervals=False)
    for balance, noise in zip(subject.machine.balances, force_noise(subject), strict=True):
        assert estimate.fit["validation"][balance.name].rms < 0.01 * noise


@pytest.mark.parametrize("name", SWINGING)
def test_what_swings_freely_follows_the_truth_of_its_balance(name: str) -> None:
    """Nothing acts in passive joints: with the true bodies and friction their rows are zero along the motion."""
    subject = model(name)
    truth = random_truth(subject, 3)
    path = random_trajectory(subject, duration=8.0, rate=10.0, seed=1)
    q, qd, qdd = passive_motion(subject, path.t, (path.q, path.qd, path.qdd), truth)
    passive = [k for k, balance in enumerate(subject.machine.balances) if not balance.actuators]
    driven = [k for k in range(q.shape[1]) if k not in passive]
    np.testing.assert_allclose(q[:, driven], path.q[:, driven], atol=1e-12)
    (K,) = subject.over(subject.regressor, q, qd, qdd)
    assert np.max(np.abs((K @ truth)[:, passive])) < 1e-9 * np.max(np.abs(K @ truth))


@pytest.mark.slow
@pytest.mark.parametrize("name", DYNAMIC)
def test_a_motion_is_designed_within_all_limits(name: str, tmp_path: Path) -> None:
    answer = CliRunner().invoke(app, ["excite", name, "--search-seconds", "2", "--starts", "2", "--processes", "1",
                                      "-o", str(tmp_path / "out")])
    assert answer.exit_code == 0, answer.output
    assert (tmp_path / "out" / "trajectory.csv").is_file()


@pytest.mark.parametrize(("name", "real"), tiered(
    [(name, real) for name in bundled() for real in ("double", "float")],
    lambda name, real: (name, real) == ("tampere_manipulator", "double")))
def test_generated_c_compiles_without_warnings_and_passes_its_own_test(name: str, real: str, tmp_path: Path) -> None:
    folder = library.write(library.files(library.code(load_machine(name), single=real == "float")), tmp_path / "c")
    made = library.run(["make", "CFLAGS=-O0 -Werror", "check"], folder)
    assert made.returncode == 0, made.stdout + made.stderr
