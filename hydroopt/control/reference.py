"""The reference of a controller: lengths, speeds and forces of the actuators, with preview for the valves' delays.

With the checks whether pump and valves suffice for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hydroopt.control.valve_inversion import Valves
from hydroopt.errors import ProblemError, SolverError
from hydroopt.kernels.integrator import IntegrationError
from hydroopt.machine.actuators import Cylinder
from hydroopt.model.hydraulics import demanded_flow
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.simulation.simulate import Trajectory, forces
from hydroopt.spatial.inertia import Array

TOLERANCE = 1e-3
"""Part of the pump's flow by which a motion may exceed it: interpolation between its samples."""
SPARE = 0.02
"""Part of the pump's flow that is reserved for leaks in a steady motion."""


class Reference:
    """A motion to follow, interpolated by polynomials of the fifth degree; after its end it stays at rest.

    A wrench at the tip that goes with it is interpolated linearly.
    """

    def __init__(self, motion: Trajectory) -> None:
        from scipy.interpolate import BPoly  # noqa: PLC0415 — it takes longer to load than C to be written

        self.start, self.end = float(motion.t[0]), float(motion.t[-1])
        spline = BPoly.from_derivatives(motion.t, np.stack([motion.q, motion.qd, motion.qdd], axis=1))
        self._orders = spline, spline.derivative(), spline.derivative(2)
        self._wrench = None if motion.wrench is None else (motion.t, motion.wrench)

    def at(self, t: Array) -> Trajectory:
        """Positions, speeds and accelerations (N, n) at times (N,)."""
        inside = (t <= self.end)[:, None]
        q, qd, qdd = (order(np.minimum(t, self.end)) for order in self._orders)
        wrench = None if self._wrench is None else np.column_stack(
            [np.interp(t, self._wrench[0], column) for column in self._wrench[1].T])
        return Trajectory(t, q, np.where(inside, qd, 0.0), np.where(inside, qdd, 0.0), wrench)


def lead(valves: Valves, period: float) -> Array:
    """Time (a,) [s] from a command to its effect: half a sample, delay of the valve, lag of its spool."""
    plant, place = valves.plant, valves.plant.parameters.positions
    leads = []
    for each in plant.actuators:
        lag = 0.0
        if each.spool_states:
            frequency, damping = (float(valves.theta[place[f"{each.actuator.name}.{key}"]])
                                  for key in ("natural_frequency", "damping"))
            lag = 2 * damping / (2 * np.pi * frequency)
        leads.append(period / 2 + each.valve.delay + lag)
    return np.array(leads)


@dataclass(frozen=True, eq=False)
class Demand:
    """The reference of a controller, in the order of joints (N, n) and actuators (N, a).

    Attributes:
        q: joint positions (N, n) [rad or m].
        length: of the actuators (N, a) [m or rad].
        measured_force: force (N, a) that the transducers measure, offsets included [N or N·m].
        preview: the reference at the time when the command takes effect.
    """

    q: Array
    length: Array
    measured_force: Array
    preview: Preview


class Preview(NamedTuple):
    """Length, speed, force and its rate (N, a), and pressures (N, a, 2), when a command takes effect."""

    length: Array
    speed: Array
    force: Array
    force_rate: Array
    pressure: Array


class Demands:
    """References of one motion, with forces by different models.

    Attributes:
        plant: the machine.
        valves: with the parameters that the controller uses.
        reference: the motion.
        t: times (N,) of the samples.
    """

    def __init__(self, valves: Valves, reference: Reference, t: Array) -> None:
        self.plant, self.valves, self.reference, self.t = valves.plant, valves, reference, t

    def by(self, model: Model, psi: Array, *, static_forces: bool = False, still: bool = False) -> Demand:
        """The reference with forces by a complete or reduced model with parameters ψ (p,).

        Actuators of one joint share its load as `shared_load` states. Pressures are integrated for these forces: p_a'
        follows from the flow through the valve, p_b from force and p_a.

        Args:
            model: complete or reduced.
            psi: its parameters (p,).
            static_forces: forces are those of a machine that stands in every posture.
            still: speeds are zero as well.

        Raises:
            ProblemError: the supply's pressure does not suffice for a force that does not brake.
            SolverError: the pressures could not be integrated.
        """
        leads = lead(self.valves, period := float(self.t[1] - self.t[0]))
        # half a period resolves a jump of dry friction
        times = np.arange(self.t[0], self.t[-1] + np.max(leads) + period, period / 2)
        path = self.reference.at(times)
        moving = path.qd * (not still)
        if static_forces:
            path = Trajectory(times, path.q, 0 * path.q, 0 * path.q, path.wrench)
        length, speed = (part[:, :, 0] for part in self.plant.model.over(self.plant.actuator_motion, path.q, moving))
        names = [each.name for each in model.machine.actuators]
        own = [names.index(each.actuator.name) for each in self.plant.actuators]
        measured = forces(model, path, psi)[:, own]
        force = measured - offset(self.plant, model, psi)
        self._refuse_force(times, force, speed)
        rate = np.diff(force, axis=0, append=force[-1:]) / np.diff(times, append=times[-1] + period)[:, None]
        pressure = self._pressures(times, length, speed, force, rate)
        now = np.zeros_like(leads)
        shifted = [self._at(times, values, leads) for values in (length, speed, force, *pressure)]
        # a command is held for a period, and so must produce the whole change of the force in it
        change = self._at(times, force, leads + period / 2) - self._at(times, force, leads - period / 2)
        preview = Preview(shifted[0], shifted[1], shifted[2], change / period, np.stack(shifted[3:], axis=2))
        return Demand(self.reference.at(self.t).q, self._at(times, length, now), self._at(times, measured, now),
                      preview)

    def _at(self, times: Array, values: Array, leads: Array) -> Array:
        return np.column_stack([np.interp(self.t + leads[k], times, values[:, k]) for k in range(len(leads))])

    def _pressures(self, times: Array, length: Array, speed: Array, force: Array, rate: Array) -> tuple[Array, Array]:
        """Pressures [Pa] of both chambers, (M, a) each, that produce the forces of a motion."""
        supply, (a, b) = self.plant.supply, np.array([each.areas for each in self.plant.actuators]).T
        start = np.asarray(self.valves.steady(speed[0], force[0], supply)).ravel()
        # a load that drags the actuator along would begin with a cavity that takes seconds to fill
        start = np.max([start, np.full_like(a, supply[1]), (force[0] + b * supply[1]) / a], axis=0)

        try:
            later = self.valves.pressures(start, np.diff(times), (speed, length, force), rate[:-1], supply)
        except IntegrationError as error:
            raise SolverError(f"the pressures of the motion cannot be integrated beyond {times[error.pieces]:.2f} s",
                              where="closed loop", remedy="check the numbers of the machine's circuits") from None
        p_a = np.vstack([start, later])
        return p_a, (a * p_a - force) / b

    def _refuse_force(self, times: Array, force: Array, speed: Array) -> None:
        """A force along the motion comes from the pump; one that brakes, from the oil that the valve holds back."""
        (a, b), (pump, tank) = np.array([each.areas for each in self.plant.actuators]).T, self.plant.supply
        beyond = np.maximum(np.where(speed >= 0, force - (a * pump - b * tank), -np.inf),
                            np.where(speed <= 0, (a * tank - b * pump) - force, -np.inf))
        k, i = divmod(int(np.argmax(beyond)), len(a))
        if beyond[k, i] >= 0:
            actuator = self.plant.actuators[i].actuator
            unit = "N" if isinstance(actuator, Cylinder) else self.plant.machine.effort_unit(actuator.joint)
            raise ProblemError(
                f"at {times[k]:.2f} s the motion demands {force[k, i]:.4g} {unit} of '{actuator.name}', which "
                f"{pump / 1e5:.0f} bar cannot produce", where="--motion",
                remedy="choose a motion with smaller loads, or correct masses or pump pressure")


def offset(plant: Plant, model: Model, psi: Array) -> Array:
    """Offsets (a,) of the measured forces [N or N·m], by the parameters ψ (p,) of a model."""
    names = model.parameters.positions
    return np.array([next((float(psi[names[f"{a.name}.{kind}"]]) for kind in ("f_offset", "tau_offset")
                           if f"{a.name}.{kind}" in names), 0.0) for a in (each.actuator for each in plant.actuators)])


def flow_demand(plant: Plant, q: Array, qd: Array) -> Array:
    """Flow (N,) [m³/s] that growing chambers take in states (N, n) of the joints."""
    return demanded_flow(plant.machine, np.einsum("nij,nj->ni", plant.model.over(plant.model.transmission, q)[0], qd))


def steady_speeds(plant: Plant, q: Array, qd: Array, least: Array) -> Array:
    """Joint speeds (n,) near `qd`, none slower than `least` (n,), that the pump sustains in a posture `q` (n,).

    A slower joint gets its least speed, since the loop of a shut valve is open; joints without a valve have a least
    speed of zero. If all joints together then take more than the pump gives, the faster ones are slowed in proportion.
    """
    most = plant.machine.pump.max_flow if plant.machine.pump else None

    def slowed(part: float) -> Array:
        return np.where(qd < 0, -1.0, 1.0) * np.maximum(part * np.abs(qd), least)

    def beyond(part: float) -> float:
        return float(flow_demand(plant, q[None], slowed(part)[None])[0]) - (1 - SPARE) * (most or np.inf)

    if beyond(1.0) <= 0:
        return slowed(1.0)
    from scipy.optimize import brentq  # noqa: PLC0415 — most motions need none of it

    return slowed(float(brentq(beyond, 0.0, 1.0)) if beyond(0.0) < 0 else 0.0)


def refuse_flow(plant: Plant, motion: Trajectory) -> None:
    """Refuse a motion that demands more flow than the pump gives.

    Raises:
        ProblemError: the demand exceeds the pump's flow by more than `TOLERANCE`; the sentence states time and flows.
    """
    machine, t, total = plant.machine, motion.t, flow_demand(plant, motion.q, motion.qd)
    k, most = int(np.argmax(total)), machine.pump.max_flow if machine.pump else None
    if most is not None and total[k] > most * (1 + TOLERANCE):
        raise ProblemError(
            f"at {t[k]:.2f} s the motion demands {total[k] * 6e4:.0f} L/min of a pump that gives "
            f"{most * 6e4:.0f} L/min", where="--motion",
            remedy=f"let it take {np.ceil(100 * (total[k] / most - 1)):.0f} % longer, with a longer --duration of "
                   "excite or simulate, or move fewer joints at a time")


def refuse_opening(plant: Plant, t: Array, demand: Demand, valves: Valves) -> None:
    """Refuse a motion for whose speeds a valve is too small.

    What a change of force takes besides counts only where it saturates a valve in a run: at reversals friction jumps,
    and asks for a moment more than any valve gives.

    Raises:
        ProblemError: a valve would be fully open; the sentence states time and valve.
    """
    preview = demand.preview
    opening = np.array([valves.command(speed, 0 * speed, length, pressure, plant.supply)[1] for speed, length, pressure
                        in zip(preview.speed, preview.length, preview.pressure, strict=True)])
    k, i = divmod(int(np.argmax(np.abs(opening))), opening.shape[1])
    if abs(opening[k, i]) >= 1:
        raise ProblemError(
            f"at {t[k]:.2f} s the motion demands more of '{plant.actuators[i].actuator.name}' than its valve gives "
            "when fully open", where="--motion",
            remedy="design it with the calibrated machine, drive it slower, with a longer --duration of excite or "
                   "simulate, or correct the valve's flow or the pump's pressure in the machine file")
