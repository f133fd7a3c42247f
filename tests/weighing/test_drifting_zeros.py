"""Zeros of pressures drift since the calibration: each actuator's force then has an unknown offset, stated or not."""

from __future__ import annotations

import numpy as np
import pytest

import hydroopt as ho
from fixtures.tiers import tiered
from hydroopt.logs.forces_from_pressures import forces
from hydroopt.model.carried_load import carried_load
from hydroopt.results.json_file import MachineId
from hydroopt.weighing.calibrated_scale import drifts, scale, with_offsets
from hydroopt.weighing.equations import Equations, equations
from hydroopt.weighing.recursion import Recursion, expected, load_prior
from hydroopt.weighing.scale import CarriedLoad, Scale, Uncertain
from hydroopt.weighing.smoothed_log import smoothed_log
from hydroopt.weighing.weighing import weigh

DRIFT = 35e3
MACHINES = ("cat215b", "backhoe", "patu655_lift", "excavator_bucket", "forestry_crane")
LOADS = {"patu655_lift": CarriedLoad("lift", (3.0, 0.0, 0.0), (0.05, 0.05, 0.05), 1000.0),
         "excavator_bucket": CarriedLoad("bucket", (0.85, 0.4, 0.0), (0.1, 0.1, 0.1), 2500.0),
         "forestry_crane": CarriedLoad("rotator", (0.0, 0.0, 0.8), (0.1, 0.1, 0.1), 600.0)}


def drifted(log: ho.Log, *channels: str) -> ho.Log:
    """The same log with other zeros of some pressures."""
    return ho.Log(log.name, log.t, {each: log.channel(each) + DRIFT * (each in channels) for each in log.channels},
                  units=log.units)


def test_offsets_that_the_file_states_stay_as_they_are() -> None:
    stated, unstated = ho.Model("backhoe"), ho.Model("excavator_bucket")
    assert with_offsets(stated) is stated
    made = with_offsets(unstated)
    assert set(made.parameters.names) - set(unstated.parameters.names) == {"swing_motor.tau_offset"}
    assert made.parameters.nominal[made.parameters.index("swing_motor.tau_offset")] == 0.0


@pytest.mark.parametrize("name", MACHINES)
def test_drifts_move_forces_as_pressures_with_wrong_zeros_do(name: str) -> None:
    """Each pressure of a log is read wrong by the drift, and forces are computed from them anew."""
    model = with_offsets(ho.Model(name))
    motion = ho.random_trajectory(model, duration=2.0, rate=10.0, seed=1)
    log = ho.simulate(model, motion, seed=1)
    read, before = model.machine.measured_actuators, forces(model, log, motion.q)
    columns = model.over(model.linearised, motion.q, motion.qd, motion.qdd, model.parameters.nominal)[0] @ drifts(
        model, DRIFT)
    assert columns.shape == (len(motion.t), len(model.machine.balances), len(read))
    for k, actuator in enumerate(read):
        square = np.zeros_like(before)
        for channel in actuator.chambers:
            square += (forces(model, drifted(log, channel), motion.q) - before) ** 2
        assert np.max(square) > 0
        assert np.allclose(np.sqrt(square), np.abs(columns[:, :, k]), rtol=1e-6, atol=1e-3)


@pytest.mark.parametrize("name", tiered(tuple(LOADS), lambda name: name == "patu655_lift"))
def test_a_drift_counts_as_an_error_that_all_samples_share(name: str) -> None:
    """Least squares at once, without unknowns for drifts, but with their covariance among the errors of the forces."""
    model, load, mass = ho.Model(name), LOADS[name], 0.4 * LOADS[name].full_scale
    truth = ho.random_truth(model, seed=3)
    known, work = (ho.random_trajectory(model, duration=duration, rate=50, seed=seed)
                   for seed, duration in ((1, 60.0), (2, 8.0)))
    calibration = ho.simulate(model, known, truth, seed=1)
    with_drift, without = (scale(model, calibration, load, uncertain=Uncertain(zero_drift=drift))
                           for drift in (DRIFT, 0.0))
    log = ho.simulate(model, work, truth + mass * carried_load(model, load.link, load.centre)[:, 0], seed=2)
    smoothed = smoothed_log(model, drifted(log, *(each.chambers[0] for each in model.machine.measured_actuators)))
    lines, plain = equations(with_drift, smoothed), equations(without, smoothed)
    phi, some = expected(load, mass), range(4, 28)
    sought = Recursion(lines, with_drift.own, mass)
    for i in some:
        sought.own, sought.phi = with_drift.own.mean, phi
        sought.take(i)
    found = sought.solved()
    own, c = without.own.mean, len(without.own.mean)
    at = [(i, a) for i in some for a in np.flatnonzero(plain.moving[i])]
    V, J, right = _errors(without, plain, at, phi), np.zeros((len(at), c + 10)), np.zeros(len(at))
    for x, (i, a) in enumerate(at):
        rest, rows = plain.linearised(i, own, phi)
        J[x], right[x] = rows[a], rest[a] + rows[a] @ np.concatenate([own, phi])
    spread = np.array([DRIFT * np.linalg.norm(balance.actuators[0].areas) if balance.actuators else 0.0
                       for balance in model.machine.balances])
    of = np.array([a for _, a in at])
    shared = np.where(of[:, None] == of, spread[of] ** 2, 0.0)
    masses = []
    for errors in (V, V + shared):
        information = J.T @ np.linalg.solve(errors, J)
        before = np.linalg.inv(without.own.covariance)
        information[:c, :c] += before
        prior = load_prior(load, found.mass)
        information[c:, c:] += prior[:, :10].T @ prior[:, :10]
        shown = J.T @ np.linalg.solve(errors, right)
        shown[:c] += before @ without.own.mean
        masses.append((np.linalg.solve(information, shown)[c], np.sqrt(np.linalg.inv(information)[c, c])))
    (_, too_narrow), (by_hand, std) = masses
    assert found.load.covariance[0, 0] == pytest.approx(std**2, rel=5e-3)
    assert abs(found.mass - by_hand) < 0.02 * std
    assert too_narrow < 0.98 * std
    # answers are about the machine as its file describes it
    assert weigh(with_drift, log, tare=0.0).machine_id == MachineId.of(model.machine)


def _errors(made: Scale, lines: Equations, at: list[tuple[int, int]], phi: np.ndarray) -> np.ndarray:
    """Covariance of the errors of some equations by angles and pressures alone."""
    known, V = lines.smoothed.kernel.covariance, np.zeros((len(at), len(at)))
    for x, (i, a) in enumerate(at):
        for y, (j, b) in enumerate(at):
            if 0 <= j - i < len(known):
                V[x, y] = V[y, x] = np.einsum(
                    "an,ac,cn->", lines.noise_by_motion(i, phi)[a], known[j - i],
                    lines.noise_by_motion(j, phi)[b]) + known[j - i, 0, 0] * made.force_std[a] ** 2 * (a == b)
    return V
