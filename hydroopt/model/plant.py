"""The complete machine, driven by its valves: links, barrels and rods coupled to oil pressures and spools."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.kernels.expression_graph import program
from hydroopt.kernels.integrator import Integrator
from hydroopt.kernels.virtual_machine import OneSample
from hydroopt.machine.actuators import Cylinder, Drive
from hydroopt.machine.machine_file import GivenMachine
from hydroopt.model.hydraulics import (
    AMBIENT,
    ActuatorHydraulics,
    Flows,
    Value,
    compressibility,
    conductance,
    pump_flow,
    spool_position,
)
from hydroopt.model.load_sharing import shared_load
from hydroopt.model.model import Model, model_of
from hydroopt.parameters import hydraulic as hydraulic_parameters
from hydroopt.parameters.parameter_set import ParameterKind, ParameterSet
from hydroopt.spatial.inertia import Array
from hydroopt.support.notebook_card import Shown

SLIDING = 0.01
"""Sliding speed [m/s] over which dry friction on a wall is smoothed: v/|v| becomes v/√(v² + SLIDING²)."""


@dataclass(frozen=True)
class Wall:
    """A flat wall that pushes on the tip where the tip has pressed into it, and never pulls.

    The normal force is k·δ·(1 + 3/2·α·δ̇) at a depth δ (Hunt and Crossley 1975, with the exponent of flat contact): it
    starts at zero on impact, unlike a damper beside the spring, and α is how much less than one the coefficient of
    restitution is per speed of the impact. Dry friction opposes sliding.

    Attributes:
        point: of its surface (3,) [m] in the base frame.
        normal: (3,) out of the wall, of any length.
        stiffness: k [N/m].
        damping: α [s/m].
        friction: coefficient of dry friction.

    Raises:
        ProblemError: a number cannot be that of a wall.

    >>> floor = Wall((0.0, 0.0, -1.0), (0.0, 0.0, 1.0), stiffness=1e6)
    >>> floor.force(ca.SX([5.0, 0.0, -1.01]), ca.SX([0.0, 0.0, 0.0]))
    SX(@1=0, [@1, @1, 10000])
    """

    point: tuple[float, float, float]
    normal: tuple[float, float, float]
    stiffness: float
    damping: float = 0.0
    friction: float = 0.0

    def __post_init__(self) -> None:
        if not (self.stiffness > 0 and self.damping >= 0 and self.friction >= 0 and any(self.normal)):
            raise ProblemError("a wall needs a normal, a positive stiffness, and damping and friction that are not "
                               "negative", where="wall", remedy="correct its numbers")

    def force(self, place: ca.SX, velocity: ca.SX) -> ca.SX:
        """Force (3,) [N] on a tip at a place (3,) [m] with a velocity (3,) [m/s] in the base frame."""
        normal = ca.DM(self.normal) / ca.norm_2(ca.DM(self.normal))
        depth, speed = ca.dot(normal, ca.DM(self.point) - place), -ca.dot(normal, velocity)
        push = ca.fmax(self.stiffness * ca.fmax(depth, 0) * (1 + 1.5 * self.damping * speed), 0)
        sliding = velocity + normal * speed
        return push * (normal - self.friction * sliding / ca.sqrt(ca.sumsqr(sliding) + SLIDING**2))


SIGN_WIDTH = 1e-3
"""Speed [m/s or rad/s] over which the sign of dry friction is smoothed in the plant: sign(v) becomes
tanh(v/SIGN_WIDTH)."""
PRESSURE = 1e7
"""Typical pressure [Pa] of states."""


class Steady(NamedTuple):
    """States (nx,) and commands (n,) of a machine that moves steadily."""

    x: Array
    u: Array


class Plant(Shown):
    """A machine with a valve on each actuator, as ẋ = f(x, u, supply, ψ, θ).

    The state holds q and q̇ of all joints, then for every actuator its spool's place (−1 to 1) and speed, if the file
    states how the spool follows, and the pressures of both chambers, and last the supply's pressure if the pump states
    a volume. Commands u (a,) are in the unit of each valve, without its delay. `supply` (2,) are the pressures [Pa] of
    supply and tank; where the pump states a volume, the first is what the pump is set to.

    Offsets of transducers in ψ have no effect here. The sign of dry friction is smoothed over the speed `SIGN_WIDTH`.
    Passive joints swing. The ground holds the joints of a moving base at their speeds: the base does not accelerate.

    A `Machine` may be given instead of its model. A `wall` pushes on the tip, the far end of the machine's last link,
    where it has pressed into it; `steady` knows no wall.

    Raises:
        ProblemError: an actuator states no circuit or is not hydraulic.

    Example:
        >>> import hydroopt as ho
        >>> plant = ho.Plant(ho.Model(ho.load_machine("patu655_lift")))
        >>> plant.inputs
        ('lift_cylinder.u',)
        >>> plant.states[:2]
        ('lift.q', 'lift.qd')
        >>> at_rest = plant.steady([0.3], [0.0], plant.model.parameters.nominal, plant.parameters.nominal)
        >>> at_rest.x.shape == (len(plant.states),)
        True
    """

    def __repr__(self) -> str:
        return f"Plant('{self.machine.name}': {len(self.states)} states, {len(self.machine.actuators)} valves)"

    def __init__(self, model: Model | GivenMachine, wall: Wall | None = None) -> None:
        model = model_of(model, "Plant")
        self.model, self.machine, self.wall = model, model.machine, wall
        machine = model.machine
        self.actuators: list[ActuatorHydraulics] = []
        if not machine.powered:
            raise ProblemError("no joint moves", where=machine.name, remedy="hydraulics need cylinders or hydraulic "
                               "motors on all joints")
        lacking = [f"'{each.name}'" for each in machine.powered if not isinstance(each, Drive) and each.circuit is None]
        for actuator in machine.powered:
            if isinstance(actuator, Drive):
                raise ProblemError(f"'{actuator.name}' is driven directly, not by oil", where=machine.name,
                                   remedy="hydraulics need cylinders or hydraulic motors on all joints")
            if actuator.circuit is None:
                raise ProblemError(f"no circuit is stated for {', '.join(lacking)}", where=machine.name, remedy=(
                    "state 'circuit' with a valve and hoses for each of them in the machine file, and 'oil'"))
            assert machine.oil is not None
            self.actuators.append(ActuatorHydraulics(actuator, actuator.circuit, machine.oil))

    def __reduce__(self) -> tuple[type[Plant], tuple[Model, Wall | None]]:
        return Plant, (self.model, self.wall)

    @cached_property
    def parameters(self) -> ParameterSet:
        """Names, units, nominal values, bounds and prior of θ."""
        return hydraulic_parameters.parameter_set(self.machine)

    @cached_property
    def drivers(self) -> dict[str, tuple[int, ...]]:
        """For each joint that oil moves, the places of the actuators that are there to move it."""
        names = [each.actuator.name for each in self.actuators]
        found = {joint: tuple(names.index(each.name) for each in drivers if each.name in names)
                 for joint, drivers in self.machine.drivers.items()}
        return {joint: places for joint, places in found.items() if places}

    @cached_property
    def _places(self) -> list[int]:
        """Places of the actuators among those of the machine."""
        return [self.machine.actuators.index(each.actuator) for each in self.actuators]

    @cached_property
    def transmission(self) -> ca.Function:
        """q → lever arms (a, n) of the actuators [m, m/rad or 1]: their speeds per speed of each joint."""
        q = ca.SX.sym("q", len(self.machine.joints))
        return ca.Function("transmission", [q], [self.model.transmission(q)[self._places, :]], ["q"], ["transmission"])

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""
        joints = self.machine.joints
        names = [*(f"{joint}.q" for joint in joints), *(f"{joint}.qd" for joint in joints)]
        for each in self.actuators:
            owner = each.actuator.name
            names += [f"{owner}.{key}" for key in ("spool", "spool_rate")[:each.spool_states]]
            names += each.chambers
        return (*names, *(["pump.p_supply"] if self._line else []))

    @property
    def _line(self) -> tuple[float, float] | None:
        """Volume of the supply's line and the greatest flow into it, where its pressure is a state."""
        pump = self.machine.pump
        return (pump.volume, pump.max_flow) if pump and pump.volume and pump.max_flow else None

    @cached_property
    def _chambers(self) -> NDArray[np.intp]:
        """Places (a, 2) of both chambers' pressures among the states."""
        return np.array([[self.states.index(name) for name in each.chambers] for each in self.actuators])

    def chamber_pressures(self, x: Array) -> Array:
        """Pressures (..., a, 2) [Pa] of both chambers in states (..., nx)."""
        return np.asarray(x[..., self._chambers])

    def supply_pressure(self, x: Array) -> Array:
        """The supply's pressure (...,) [Pa] in states (..., nx): a state, or what the pump is set to."""
        return np.asarray(x[..., -1] if self._line else self.supply[0])

    @cached_property
    def delays(self) -> Array:
        """Of the valves (a,) [s], as the machine file states them."""
        return np.array([each.valve.delay for each in self.actuators])

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the commands."""
        return tuple(f"{each.actuator.name}.u" for each in self.actuators)

    @cached_property
    def scale(self) -> Array:
        """Typical size (nx,) of each state."""
        omega = {f"{each.actuator.name}.spool_rate": 2 * np.pi * (each.valve.natural_frequency or 0)
                 for each in self.actuators}
        return np.array([omega.get(name) or (PRESSURE if ".p_" in name else 1.0) for name in self.states])

    @property
    def supply(self) -> Array:
        """Pressures (2,) [Pa] of supply and tank as the machine file states them.

        Raises:
            ProblemError: it states no supply pressure.
        """
        pump = self.machine.pump
        if pump is None or pump.pressure is None:
            raise ProblemError("the supply's pressure is not known", where=f"{self.machine.name}: pump",
                               remedy="state 'pressure' of the pump in the machine file, or log pump.p_supply")
        return np.array([pump.pressure, pump.tank_pressure])

    @cached_property
    def _symbols(self) -> dict[str, ca.SX]:
        sizes = {"x": len(self.states), "u": len(self.inputs), "supply": 2, "psi": len(self.model.parameters),
                 "theta": len(self.parameters)}
        return {name: ca.SX.sym(name, size) for name, size in sizes.items()}

    @cached_property
    def _parts(self) -> dict[str, ca.SX]:
        """Rates of all states, and the outputs, in the symbols."""
        x, u, given, psi, theta = self._symbols.values()
        n, at = len(self.machine.joints), dict(zip(self.states, ca.vertsplit(x), strict=True))
        q, qd = x[:n], x[n:2 * n]
        supply = ca.vertcat(at["pump.p_supply"], given[1]) if self._line else given
        length, speed = self.actuator_motion(q, qd)
        spools: list[ca.SX] = []
        rates: list[ca.SX] = []
        chambers: list[ca.SX] = []
        flows: list[Flows] = []
        for k, each in enumerate(self.actuators):
            value = self.value(each, theta)
            p_a, p_b = (at[name] for name in each.chambers)
            spool = spool_position(each.valve, u[k], value)
            if each.spool_states:
                wanted, spool = spool, at[f"{each.actuator.name}.spool"]
                rates += each.spool_rates(spool, at[f"{each.actuator.name}.spool_rate"], wanted, value)
            flows.append(each.flows(spool, p_a, p_b, supply, value))
            rates += each.pressure_rates(flows[-1], p_a, p_b, length[k], speed[k], value)
            spools.append(spool)
            chambers += [p_a, p_b]
        pressure = ca.reshape(ca.vertcat(*chambers), 2, len(self.actuators)).T
        areas = ca.DM([each.areas for each in self.actuators])
        force = areas[:, 0] * pressure[:, 0] - areas[:, 1] * pressure[:, 1]
        flow = ca.vertcat(*(each.supply for each in flows))
        if self._line:
            volume, most = self._line
            value = self.value(self.actuators[0], theta)
            capacity = volume * compressibility(self.actuators[0].oil, supply[0], value)
            rates.append((pump_flow(most, given[0], supply[0]) - ca.sum1(flow)) / capacity)
        contact = self.contact(q, qd) if self.wall else ca.SX(3, 1)
        pushed = self.model.tip_jacobian(q)[:3, :].T @ contact if self.wall else ca.SX.zeros(n)
        qdd = self._acceleration(q, qd, force, pushed, pressure, psi)
        return {"rates": ca.vertcat(qd, qdd, *rates), "q": q, "qd": qd, "qdd": qdd, "length": length, "speed": speed,
                "spool": ca.vertcat(*spools), "pressure": pressure, "force": force, "flow": flow,
                "p_supply": supply[0], "contact": contact}

    @cached_property
    def contact(self) -> ca.Function:
        """(q, qd) → force (3,) [N] of the wall on the tip, in the base frame."""
        symbols, dynamics = self.model.coordinates, self.model.dynamics
        force = self.wall.force(dynamics.tip.origin, dynamics.tip_jacobian[:3, :] @ symbols.qd) if self.wall else (
            ca.SX(3, 1))
        return ca.Function("contact", [symbols.q, symbols.qd], [ca.densify(force)], ["q", "qd"], ["force"])

    def value(self, each: ActuatorHydraulics, theta: ca.SX | Array) -> Value:
        """The numbers of an actuator's hydraulics, and of the oil, out of θ."""
        place, owner = self.parameters.positions, each.actuator.name
        return lambda key: theta[place[key if key.startswith("oil.") else f"{owner}.{key}"]]

    @cached_property
    def actuator_motion(self) -> ca.Function:
        """(q, qd) → length and speed (a,) of every actuator; of a motor, angle and speed of its joint."""
        dynamics, symbols = self.model.dynamics, self.model.coordinates
        lengths = [dynamics.cylinders[each.actuator.name].length if isinstance(each.actuator, Cylinder)
                   else symbols.q[self.machine.joints.index(each.actuator.joint)] for each in self.actuators]
        return ca.Function("actuator_motion", [symbols.q, symbols.qd],
                           [ca.vertcat(*lengths), ca.densify(dynamics.rates[self._places])],
                           ["q", "qd"], ["length", "speed"])

    @cached_property
    def _efforts(self) -> ca.Function:
        """`Model.efforts` with rounded dry friction and without offsets of transducers."""
        smooth = program(self.model.efforts).function(lambda speed, _: ca.tanh(speed / SIGN_WIDTH))
        given = [ca.SX.sym(name, *smooth.size_in(name)) for name in smooth.name_in()]
        acting = ca.DM([kind is not ParameterKind.FORCE_OFFSET for kind in self.model.parameters.kinds])
        return ca.Function("efforts", given, [*smooth(*given[:-1], given[-1] * acting)], smooth.name_in(),
                           smooth.name_out())

    def _demanded(self, q: ca.SX, qd: ca.SX, qdd: ca.SX, pressure: ca.SX, psi: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Generalised forces (n,) that a motion demands of the actuators, and what each takes for its own friction,
        that of seals at `pressure` (a, 2)."""
        both = ca.SX.zeros(len(self.machine.actuators))
        both[self._places] = pressure[:, 0] + pressure[:, 1]
        torque, own = self._efforts(q, qd, qdd, *([both] if self.model.needs_pressure else []), psi)
        return torque, own[self._places]

    def _steady_forces(self, q: ca.SX, qd: ca.SX, pressure: ca.SX, psi: ca.SX) -> ca.SX:
        """Forces (a,) of the actuators, as `shared_load` allots them, while joints keep their speeds."""
        torque, own = self._demanded(q, qd, ca.SX.zeros(q.numel()), pressure, psi)
        return shared_load(self.machine, self.model.transmission(q), torque)[self._places] + own

    def _acceleration(self, q: ca.SX, qd: ca.SX, force: ca.SX, pushed: ca.SX, pressure: ca.SX, psi: ca.SX) -> ca.SX:
        """Joint accelerations (n,) under forces (a,) of the actuators, and generalised ones (n,)."""
        rest, own = self._demanded(q, qd, ca.SX.zeros(q.numel()), pressure, psi)
        load = self.transmission(q).T @ (force - own) + pushed - rest
        free = [k for k, joint in enumerate(self.machine.joints) if joint not in self.machine.base_joints]
        found = ca.SX.zeros(q.numel())
        found[free] = ca.solve(self.mass(q, psi)[free, free], load[free])
        return found

    @cached_property
    def mass(self) -> ca.Function:
        """(q, psi) → generalised forces (n, n) per acceleration of the joints."""
        n, psi = len(self.machine.joints), self._symbols["psi"]
        q, qd, qdd = ca.SX.sym("q", n), ca.SX.zeros(n), ca.SX.sym("qdd", n)
        torque, _ = self._demanded(q, qd, qdd, ca.SX.zeros(len(self.actuators), 2), psi)
        return ca.Function("mass", [q, psi], [ca.densify(ca.jacobian(torque, qdd))], ["q", "psi"], ["mass"])

    def _function(self, name: str, *outputs: str) -> ca.Function:
        return ca.Function(name, list(self._symbols.values()), [ca.densify(self._parts[key]) for key in outputs],
                           list(self._symbols), list(outputs))

    @cached_property
    def rates(self) -> ca.Function:
        """(x, u, supply, psi, theta) → ẋ (nx,)."""
        return self._function("rates", "rates")

    @cached_property
    def outputs(self) -> ca.Function:
        """(x, u, supply, psi, theta) → outputs.

        q, qd, qdd (n,) of the joints; length, speed, spool, force (a,) and pressure (a, 2) of the actuators; their flow
        (a,) [m³/s] from the supply, and its pressure; the force (3,) [N] of the wall on the tip.
        """
        return self._function("outputs", *(key for key in self._parts if key != "rates"))

    def flow_and_contact(self, x: Array, u: Array, psi: Array, theta: Array) -> tuple[Array, Array]:
        """Flow (a,) [m³/s] of the actuators from the supply, and force (3,) [N] of the wall on the tip, in a state."""
        flow, contact = self._flow_and_contact(x, u, self.supply, psi, theta)
        return flow, contact

    @cached_property
    def _flow_and_contact(self) -> OneSample:
        return OneSample(self._function("flow_and_contact", "flow", "contact"))

    @cached_property
    def jacobians(self) -> ca.Function:
        """(x, u, supply, psi, theta) → A (nx, nx) and B (nx, a) of δẋ = A·δx + B·δu."""
        given, rates = list(self._symbols.values()), self._parts["rates"]
        return ca.Function("jacobians", given, [ca.densify(ca.jacobian(rates, by)) for by in given[:2]],
                           list(self._symbols), ["A", "B"])

    def integrator(self, psi: Array, theta: Array, *, tolerance: float = 1e-7) -> Integrator:
        """(x, seconds, u, supply) → x after as many seconds of constant commands; see `Integrator`.

        `tolerance` is the relative error tolerance of its steps.
        """
        return Integrator(self.rates, (psi, theta), self.scale, tolerance=tolerance)

    def steady(self, q: Array, qd: Array, psi: Array, theta: Array, supply: Array | None = None) -> Steady:
        """State and commands at which the machine moves through a posture with constant joint speeds.

        Args:
            q: posture (n,) [rad or m].
            qd: speeds (n,).
            psi: dynamic parameters (p,).
            theta: hydraulic ones.
            supply: pressures (2,) of supply and tank; those of the machine file if None.

        Raises:
            ProblemError: the supply cannot move the machine at these speeds, a chamber would fall below vacuum, or
                the file states no supply pressure.
        """
        supply = self.supply if supply is None else supply
        names = [each.actuator.name for each in self.actuators]
        opening, p_a, p_b = self._ideal(q, qd, supply, psi, theta)
        for name, part in zip(names, opening, strict=True):
            if not abs(part) < 1:
                raise ProblemError(f"a supply of {supply[0] / 1e5:.0f} bar cannot move '{name}' at this speed against "
                                   "its load", where=self.machine.name,
                                   remedy="ask for a slower motion, or state a higher pressure or larger valve")

        from scipy.optimize import root  # noqa: PLC0415 — it takes longer to load than C to be written

        def balance(z: Array) -> tuple[Array, Array]:
            gap, slope = self._balance(z, q, qd, supply, psi, theta)
            return gap, slope

        start = np.concatenate([opening, *(p / PRESSURE for p in (p_a, p_b, supply[:1]))])
        found = root(balance, start, jac=True)
        opening, p_a, p_b = found.x[:-1].reshape(3, len(names)) * np.array([[1.0], [PRESSURE], [PRESSURE]])
        if not (found.success and np.all(np.abs(opening) <= 1)):
            raise ProblemError("no steady state of valves, chambers and pump was found", where=self.machine.name,
                               remedy="ask for a slower motion, or check the numbers of its circuits")
        for k, each in enumerate(self.actuators):
            for side, pressure in zip(each.chambers, (p_a[k], p_b[k]), strict=True):
                if pressure < -AMBIENT:
                    raise ProblemError(f"the load would pull '{names[k]}' ahead of its oil: {side} would be "
                                       f"{pressure / 1e5:.0f} bar, below vacuum", where=self.machine.name,
                                       remedy="state 'anticavitation' in its circuit, or let less oil out by its edges")
        u = np.array([self._command_for(k, float(opening[k]), theta) for k in range(len(names))])
        x = dict.fromkeys(self.states, 0.0)
        x |= dict(zip(self.states, [*q, *qd], strict=False))
        for k, each in enumerate(self.actuators):
            x |= dict(zip(each.chambers, (p_a[k], p_b[k]), strict=True))
            if each.spool_states:
                x[f"{names[k]}.spool"] = opening[k]
        if self._line:
            x["pump.p_supply"] = PRESSURE * found.x[-1]
        return Steady(np.array(list(x.values())), u)

    @cached_property
    def _ideal(self) -> OneSample:
        """(q, qd, supply, psi, theta) → spools and pressures of both chambers by sharp edges without leaks."""
        _, _, supply, psi, theta = self._symbols.values()
        n, none = len(self.machine.joints), ca.SX.zeros(len(self.actuators), 2)
        q, qd = ca.SX.sym("q", n), ca.SX.sym("qd", n)
        force, speed = self._steady_forces(q, qd, none, psi), self.actuator_motion(q, qd)[1]
        found = []
        for k, each in enumerate(self.actuators):
            value = self.value(each, theta)
            opening, *pressures = each.opening_for(force[k], speed[k], supply, value)
            overlap = value("overlap")
            spool = ca.sign(opening) * ca.fmax(0.0, overlap + (1 - overlap) * ca.fabs(opening))
            found.append([spool, *pressures])
        return OneSample(ca.Function("ideal", [q, qd, supply, psi, theta],
                                     [ca.vertcat(*(one[k] for one in found)) for k in range(3)]))

    @cached_property
    def _balance(self) -> OneSample:
        """(z, q, qd, supply, psi, theta) → residuals of flows and forces, and their Jacobian.

        z are the openings, the pressures of chambers a and b, and the supply's.
        """
        _, _, given, psi, theta = self._symbols.values()
        n, a = len(self.machine.joints), len(self.actuators)
        z, q, qd = ca.SX.sym("z", 3 * a + 1), ca.SX.sym("q", n), ca.SX.sym("qd", n)
        opening, p_a, p_b, p_supply = z[:a], PRESSURE * z[a:2 * a], PRESSURE * z[2 * a:3 * a], PRESSURE * z[-1]
        force, speed = self._steady_forces(q, qd, ca.horzcat(p_a, p_b), psi), self.actuator_motion(q, qd)[1]
        gaps, drawn = [], ca.SX(0.0)
        for k, each in enumerate(self.actuators):
            value, (head, rod) = self.value(each, theta), each.areas
            flows = each.flows(opening[k], p_a[k], p_b[k], ca.vertcat(p_supply, given[1]), value)
            full = conductance(each.valve, "flow_pa", value) * PRESSURE**0.5
            gaps += [(flows.into_a - head * speed[k]) / full, (flows.into_b + rod * speed[k]) / full,
                     (head * p_a[k] - rod * p_b[k] - force[k]) / (head * PRESSURE)]
            drawn += flows.supply
        gaps.append(pump_flow(1.0, given[0], p_supply) - drawn / self._line[1] if self._line
                    else (p_supply - given[0]) / PRESSURE)
        gap = ca.vertcat(*gaps)
        return OneSample(ca.Function("balance", [z, q, qd, given, psi, theta], [gap, ca.jacobian(gap, z)]))

    def _command_for(self, k: int, opening: float, theta: Array) -> float:
        """Command that holds a spool at a position, −1 to 1."""
        from scipy.optimize import brentq  # noqa: PLC0415 (as above)

        each, valve = self.actuators[k], self.actuators[k].valve

        def excess(u: float) -> float:
            return float(self._spool_positions[k](np.array([u]), theta)[0][0]) - opening

        ends = valve.neutral - valve.span, valve.full
        if not excess(ends[0]) <= 0 <= excess(ends[1]):
            raise ProblemError(f"no command moves the spool of '{each.actuator.name}' to {100 * opening:.0f} %",
                               where=self.machine.name, remedy="ask for a slower motion, or correct its dead bands")
        return float(brentq(excess, *ends, xtol=1e-12, rtol=1e-14))

    @cached_property
    def _spool_positions(self) -> list[OneSample]:
        """Of each actuator (command, θ) → the position that its valve's spool is to take."""
        command, theta = ca.SX.sym("command"), self._symbols["theta"]
        return [OneSample(ca.Function("spool_position", [command, theta], [
            spool_position(each.valve, command, self.value(each, theta))])) for each in self.actuators]
