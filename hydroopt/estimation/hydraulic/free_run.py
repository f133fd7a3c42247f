"""Free runs: the machine simulated from its first states on by commands and supply alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hydroopt.errors import SolverError
from hydroopt.estimation.hydraulic.motion_readings import MotionReadings
from hydroopt.estimation.hydraulic.problem import SUPPLY, HydraulicProblem, Stretch
from hydroopt.logs.log import Log
from hydroopt.logs.readings import bridged, reading
from hydroopt.model.hydraulics import spool_position
from hydroopt.model.plant import Plant
from hydroopt.simulation.drive_valves import arrived
from hydroopt.spatial.inertia import Array

ACCURACY = 1e-6
"""Error of a simulation's step, relative and in units of the states' scales."""


@dataclass(frozen=True, eq=False)
class Run:
    """N samples without a gap beside the free run.

    Attributes:
        t: (N,) times [s].
        u: (N, a + 2) commands as they arrive, and pressures of supply and tank.
        y: (N, ny) readings of the problem's channels, NaN where there is none.
        states, outputs: (N, nx) and (N, ny) of the free run.
    """

    t: Array
    u: Array
    y: Array
    states: Array
    outputs: Array


def free_runs(problem: HydraulicProblem, log: Log, theta: Array) -> Iterator[Run]:
    """A free run for each stretch of a log, with identified θ (p,); bodies and friction are the machine file's.

    Raises:
        SolverError: the states diverge.
    """
    for stretch in problem.stretches_of(log):
        yield free_run(problem, stretch, theta)


def free_run(problem: HydraulicProblem, stretch: Stretch, theta: Array) -> Run:
    """The free run of one stretch, from its first readings on.

    Raises:
        SolverError: the states diverge.
    """
    plant, log, whole = problem.plant, stretch.log, problem.whole(theta)
    u = np.column_stack([*(arrived(log.t, reading(plant.machine, log, name), each.valve.delay)
                           for name, each in zip(plant.inputs, plant.actuators, strict=True)), _supply(plant, log)])
    y = np.column_stack([log.channels.get(channel, np.full(log.size, np.nan)) for channel in problem.channels])
    states = simulated(plant, log.t, u, _first(plant, stretch, u, whole), whole, log.path or log.name)
    psi, count = plant.model.parameters.nominal, log.size
    found = plant.outputs.map(count)(states.T, u[:, :-2].T, u[:, -2:].T, np.tile(psi[:, None], count),
                                     np.tile(whole[:, None], count))
    outputs = {name: np.asarray(values).reshape(len(np.asarray(values)), count, -1)
               for name, values in zip(plant.outputs.name_out(), found, strict=True)}
    return Run(log.t, u, y, states, np.column_stack([_channel(plant, outputs, channel)
                                                     for channel in problem.channels]))


def simulated(plant: Plant, t: Array, u: Array, first: Array, theta: Array, where: str) -> Array:
    """States (N, nx) at the times (N,) from first states (nx,) on; commands are held, the supply is straight between.

    Raises:
        SolverError: CVODES failed, as it does where the states diverge.
    """
    x, given, change, dt, at = (ca.SX.sym(name, size) for name, size in (
        ("x", len(first)), ("u", u.shape[1]), ("change", u.shape[1]), ("dt", 1), ("at", 1)))
    now, scale = given + change * at, ca.DM(plant.scale)
    rate = plant.rates(x * scale, now[:-2], now[-2:], plant.model.parameters.nominal, theta) * dt / scale
    # every interval is integrated anew: inputs may jump there, which a multistep method takes for its own error
    interval = ca.integrator("interval", "cvodes", {"x": x, "p": ca.vertcat(given, change, dt), "t": at, "ode": rate},
                             0.0, 1.0, {"reltol": ACCURACY, "abstol": ACCURACY, "max_num_steps": 100000})
    change = np.diff(u, axis=0)
    change[:, :-2] = 0.0
    try:
        found = interval.mapaccum(len(t) - 1)(x0=first / plant.scale,
                                              p=np.column_stack([u[:-1], change, np.diff(t)]).T)["xf"]
    except RuntimeError as error:
        raise SolverError("the free run did not converge", where=where,
                          remedy="correct numbers of the machine file that are far off") from error
    return np.vstack([first, np.asarray(found).T * plant.scale])


def _supply(plant: Plant, log: Log) -> Array:
    """Pressures of supply and tank (N, 2): as logged, or as stated; what the pump is set to where it feeds a volume."""
    return np.column_stack([
        bridged(reading(plant.machine, log, channel)) if channel in log.channels and channel not in plant.states
        else np.full(log.size, plant.supply[k]) for k, channel in enumerate(SUPPLY)])


def _first(plant: Plant, stretch: Stretch, u: Array, theta: Array) -> Array:
    """States (nx,) by the first readings; spools stand where their first commands want them."""
    motion = MotionReadings(plant, stretch.log).smooth
    first = {f"{joint}.{key}": values[0, k] for k, joint in enumerate(plant.machine.joints)
             for key, values in (("q", motion.q), ("qd", motion.qd))}
    command = ca.SX.sym("u")
    for k, (each, readings) in enumerate(zip(plant.actuators, stretch.actuators, strict=True)):
        wanted = ca.Function("wanted", [command], [spool_position(each.valve, command, plant.value(each, theta))])
        first |= {f"{each.actuator.name}.spool": float(wanted(u[0, k])), f"{each.actuator.name}.spool_rate": 0.0}
        first |= dict(zip((*each.chambers, SUPPLY[0]), readings.values[0, 1:4], strict=True))
    return np.array([first[name] for name in plant.states])


def _channel(plant: Plant, outputs: dict[str, Array], channel: str) -> Array:
    """The plant's output (N,) that a channel measures."""
    owner, _, key = channel.rpartition(".")
    if key == "q":
        return outputs["q"][plant.machine.joints.index(owner), :, 0]
    if channel == SUPPLY[0]:
        return outputs["p_supply"][0, :, 0]
    k = [each.actuator.name for each in plant.actuators].index(owner)
    if key == "length":
        return outputs["length"][k, :, 0]
    return outputs["pressure"][k, :, plant.actuators[k].chambers.index(channel)]
