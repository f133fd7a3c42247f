"""Free runs: the machine simulated from its first states on by commands and supply alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hydroopt.errors import SolverError
from hydroopt.estimation.hydraulic.problem import SUPPLY, HydraulicProblem, Stretch
from hydroopt.estimation.hydraulic.volume_balance import MotionReadings
from hydroopt.estimation.inference.gauss_newton import DenseRows, minimise
from hydroopt.kernels.integrator import IntegrationError, Integrator
from hydroopt.logs.log import Log
from hydroopt.logs.readings import bridged, reading
from hydroopt.model.hydraulics import spool_position
from hydroopt.model.plant import Plant
from hydroopt.simulation.drive_valves import arrived, changes, delays_at
from hydroopt.spatial.inertia import Array

AT_FIRST, REFINED = 0.3, 4
"""Time [s] over which first readings tell first speeds, and steps towards these."""
SLIGHT, SETTLED = 1e-3, 0.01
"""Change of a speed [rad/s or m/s] for derivatives by it, and that in standard deviations that ends the search."""
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
    at, samples = changes(log.t, delays := delays_at(plant, whole))
    inputs = np.column_stack([*(arrived(log.t, reading(plant.machine, log, name), delay, at)
                                for name, delay in zip(plant.inputs, delays, strict=True)),
                              *(np.interp(at, log.t, pressure) for pressure in _supply(plant, log).T)])
    y = np.column_stack([log.channels.get(channel, np.full(log.size, np.nan)) for channel in problem.channels])

    integrator = plant.integrator(plant.model.parameters.nominal, whole, tolerance=ACCURACY)

    def run(first: Array, count: int) -> tuple[Array, Array]:
        """States (count, nx) and outputs (count, ny) of so many samples from first states (nx,) on."""
        end, some = samples[count - 1] + 1, samples[:count]
        states = simulated(integrator, at[:end], inputs[:end], first, log.path or log.name)[some]
        return states, _outputs(problem, states, inputs[some], whole)

    first = _first(plant, stretch, inputs, whole)
    states, outputs = run(_with_speeds(problem, log.t, y, first, run), log.size)
    return Run(log.t, inputs[samples], y, states, outputs)


def simulated(integrator: Integrator, t: Array, u: Array, first: Array, where: str) -> Array:
    """States (N, nx) at the times (N,) from first states (nx,) on; commands are held, the supply is straight between.

    Raises:
        SolverError: no step succeeds, as where the states diverge.
    """
    seconds = np.diff(t)
    slopes = np.diff(u, axis=0) / seconds[:, None]
    slopes[:, :-2] = 0.0
    try:
        return np.vstack([first, integrator.along(first, seconds, u[:-1], slopes=(slopes,))])
    except IntegrationError as error:
        raise SolverError("the free run did not converge", where=where,
                          remedy="correct numbers of the machine file that are far off") from error


def _outputs(problem: HydraulicProblem, states: Array, u: Array, theta: Array) -> Array:
    """Outputs (N, ny) of the problem's channels at states (N, nx), commands and supply (N, a + 2)."""
    plant, count = problem.plant, len(states)
    psi = plant.model.parameters.nominal
    found = plant.outputs.map(count)(states.T, u[:, :-2].T, u[:, -2:].T, np.tile(psi[:, None], count),
                                     np.tile(theta[:, None], count))
    outputs = {name: np.asarray(values).reshape(len(np.asarray(values)), count, -1)
               for name, values in zip(plant.outputs.name_out(), found, strict=True)}
    return np.column_stack([_channel(plant, outputs, channel) for channel in problem.channels])


def _with_speeds(problem: HydraulicProblem, t: Array, y: Array, first: Array,
                 run: Callable[[Array, int], tuple[Array, Array]]) -> Array:
    """First states with those speeds of the joints from which a run follows the first readings best.

    At the end of a stretch the speed of a smoothed motion is hardly known, and moves pressures by tens of bars.
    """
    plant = problem.plant
    count = max(2, int(np.searchsorted(t, t[0] + AT_FIRST)))
    free = [plant.states.index(f"{joint}.qd") for joint in plant.machine.joints
            if joint not in plant.machine.base_joints]

    def missed(speeds: Array) -> Array:
        start = first.copy()
        start[free] = speeds
        return np.nan_to_num((run(start, count)[1] - y[:count]) / problem.sigma).ravel()

    def rows(speeds: Array) -> tuple[Array, Array]:
        here, steps = missed(speeds), SLIGHT * np.eye(len(free))
        return here, np.column_stack([(missed(speeds + step) - here) / SLIGHT for step in steps])

    found = first.copy()
    found[free] = minimise(DenseRows(rows, first[free]), tolerance=SETTLED, steps=REFINED).place.x
    return found


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
