"""Routines of the generated C for valves: feedforward of commands, feedback of position, estimation of flows."""

from __future__ import annotations

from copy import copy

import casadi as ca

from hydroopt.codegen.symbols import ABOVE, Field, Guard, Kind, Routine, Symbols
from hydroopt.control import cascade, valve_inversion
from hydroopt.control import valve_refit as refit
from hydroopt.control.axes import Axes
from hydroopt.machine.actuators import Cylinder
from hydroopt.model.hydraulics import ActuatorHydraulics, Value
from hydroopt.model.load_sharing import lever_arms
from hydroopt.model.plant import Plant

FACTORS = ("factor_extending", "factor_retracting")
"""Members with the factors on the valves' flows."""
LEAST_FACTOR = 0.1
"""Below which a factor is a mistake, such as a member that was never set."""
LEAST_TIME = 1e-4
"""Integral time [s] below which the feedback could overflow."""


def valve_feedforward(api: Symbols) -> Routine:
    """Valve commands of a motion, see `hydroopt.control.valve_inversion`."""
    plant, machine = Plant(api.complete), api.machine
    guards = api.guards(levers=machine.one_each, gas=True)
    count, places = len(plant.actuators), [machine.actuators.index(each) for each in machine.powered]
    force, measured = api.predicted, "measured force of each actuator in the motion"
    if not machine.one_each:
        force = api.dynamics.actuator_forces(api.inputs["psi"])[places]
        measured += ("; those of a joint share its load with the least sum of (force/capacity)^2, and passive joints "
                     "carry themselves")
        guards += api.arms(lever_arms(machine, api.dynamics.transmission))
    rate, p_a, p_b = (api.symbol(name, count) for name in ("force_rate", "pressure_a", "pressure_b"))
    factors = ca.horzcat(*(api.symbol(name, count) for name in FACTORS))
    supply, speed = api.symbol("supply", 2), api.dynamics.rates[places] + api.symbol("speed_added", count)
    openings, commands = [], []
    for k, each in enumerate(_actuators(api, plant)):
        value = _value(plant, each)
        wide = valve_inversion.opening(each, speed[k], rate[k], _length(api, each), ca.vertcat(p_a[k], p_b[k]), supply,
                                       factors[k, :].T, value)
        openings.append(ca.fmin(ca.fmax(wide, -1.0), 1.0))
        commands.append(valve_inversion.command(each.valve, openings[-1], value))
    motion = api.structs[api.motion()].fields
    takes = api.struct("demand", "A motion to drive, with the pressures at the valves.", *motion,
                       Field("speed_added", (api.valve,), "m/s or rad/s", "speed added by feedback; 0 without"),
                       Field("force_rate", (api.valve,), "N/s or N*m/s", "demanded rate of each force"),
                       *_pressures(api), *_factors(api))
    gives = api.struct("commands", "Commands to the valves.",
                       Field("force", (api.valve,), "N or N*m", measured),
                       Field("opening", (api.valve,), "1", "opening of each valve, -1 to 1, positive from P to A"),
                       Field("command", (api.valve,), "1, V or A", "command to each valve"))
    return Routine("valve_feedforward", "Forces of a motion, and the valve commands that produce it, with the "
                   "valves of the machine file.", takes,
                   ("q", "qd", "qdd", "speed_added", "force_rate", "pressure_a", "pressure_b", "supply", *FACTORS),
                   gives,
                   {"force": force, "opening": ca.vertcat(*openings), "command": ca.vertcat(*commands)},
                   (*guards, *_supplied(api), *(Guard(factor, ">", LEAST_FACTOR, "OUT_OF_RANGE") for factor in
                                                   ca.vertsplit(ca.vec(factors)))), api.lengths)


def valve_refit(api: Symbols) -> Routine:
    """One sample of the estimation of the valves' flows while the machine works, see `hydroopt.control.valve_refit`."""
    plant = Plant(api.complete)
    count, size = len(plant.actuators), len(refit.STATE)
    acting, p_a, p_b = (api.symbol(name, count) for name in ("acting", "pressure_a", "pressure_b"))
    supply, period, state = api.symbol("supply", 2), api.symbol("period", 1), api.symbol("state", count * size)
    std, after = refit.length_std(plant, _lever_arms(api, plant)), []
    for k, each in enumerate(_actuators(api, plant)):
        after.append(refit.next_state(each, state[k * size:(k + 1) * size], acting[k], _length(api, each), std[k],
                                      p_a[k], p_b[k], supply, period, _value(plant, each)))
    factors, deviations = (ca.horzcat(*(found(each) for each in after)).T
                           for found in (refit.factors_in, refit.deviations_in))
    kept = Field("state", (count * size,), "", "what the routine keeps from sample to sample; zeros at first")
    takes = api.struct("valve_sample", "Readings of a sample, and what was kept of those before.",
                       Field("q", ("joint",), "rad or m", "position of each joint"),
                       Field("acting", (api.valve,), "1, V or A",
                             "command that acted on each valve since the last sample, so after its delay"),
                       *_pressures(api), Field("period", (1,), "s", "time since the last sample"), kept)
    gives = api.struct("valve_flows", "Factors on the valves' flows.", *_factors(api),
                       *(Field(f"std_{way}", (api.valve,), "1", f"standard deviation of factor_{way}")
                         for way in ("extending", "retracting")), kept)
    return Routine("valve_refit", "Flows of the valves while the machine works: each sample compares the motion "
                   "with what the valves of the machine file let through; forgotten with a time constant of "
                   f"{refit.FORGETTING:g} s.", takes,
                   ("q", "acting", "pressure_a", "pressure_b", "supply", "period", "state"), gives,
                   {FACTORS[0]: factors[:, 0], FACTORS[1]: factors[:, 1], "std_extending": deviations[:, 0],
                    "std_retracting": deviations[:, 1], "state": ca.vertcat(*after)},
                   (*api.guards(), *_supplied(api), *_periodic(period)), api.lengths)


def position_feedback(api: Symbols) -> Routine:
    """One sample of the cascade's feedback, see `hydroopt.control.cascade`."""
    plant = Plant(api.complete)
    axes, count = Axes(plant), len(plant.actuators)
    q, aim, period = api.coordinates.q, api.symbol("q_demanded", len(api.machine.joints)), api.symbol("period", 1)
    length = ca.vertcat(*(_length(api, each) for each in plant.actuators))
    position = ca.vertcat(q, length)[axes.places]
    wanted, shares = ca.substitute([position, axes.shares(_lever_arms(api, plant))], [q], [aim])
    demanded, measured, opening, before, force_gain = (api.symbol(name, count) for name in (
        "force_demanded", "force_measured", "opening_before", "speed_before", "force_gain"))
    integral, position_gain, integral_time, filter_time = (api.symbol(name, len(axes.names)) for name in (
        "integral", "position_gain", "integral_time", "filter_time"))
    after, further = cascade.feedback(
        axes, wanted - position, shares, demanded - measured, opening, before, integral,
        cascade.Gains(position_gain, force_gain, integral_time, filter_time), period)
    guards = api.guards()
    demands = (guard._replace(value=ca.substitute(guard.value, q, aim)) for guard in guards)
    axis, api.kinds["axis"] = ("axis",), Kind(axes.names, tuple(axes.units(k) for k in range(len(axes.names))))
    kept = Field("integral", axis, "m or rad", "kept from sample to sample; zeros at first")
    takes = api.struct("position_sample", "Readings, demands and gains, and what was kept of the samples before.",
                       Field("q", ("joint",), "rad or m", "position of each joint"),
                       Field("q_demanded", ("joint",), "rad or m", "position that the motion demands now, where all "
                             "loops close"),
                       Field("force_measured", (api.valve,), "N or N*m", "force of each actuator by its pressures"),
                       Field("force_demanded", (api.valve,), "N or N*m", "force that the motion demands now"),
                       Field("speed_before", (api.valve,), "m/s or rad/s", "speed_added a sample ago; zeros at first"),
                       Field("opening_before", (api.valve,), "1", "opening that `valve_feedforward` gave a sample ago; "
                             "integrals wait while a valve is fully open"),
                       Field("position_gain", axis, "1/s", "speed per error of the position"),
                       Field("force_gain", (api.valve,), "m/(s*N) or rad/(s*N*m)", "speed per error of the force"),
                       Field("integral_time", axis, "s", "of the integral action"),
                       Field("filter_time", axis, "s", "time constant of a low pass on the feedback"),
                       Field("period", (1,), "s", "time since the last sample"), kept)
    gives = api.struct("feedback", "Feedback of a sample.",
                       Field("speed_added", (api.valve,), "m/s or rad/s", "for `valve_feedforward`"), kept)
    return Routine("position_feedback", "Feedback of positions and forces in a cascade, as a speed of each actuator "
                   "that `valve_feedforward` adds to that of the motion.", takes,
                   ("q", "q_demanded", "force_measured", "force_demanded", "opening_before", "position_gain",
                    "force_gain", "integral_time", "filter_time", "period", "speed_before", "integral"), gives,
                   {"speed_added": after, "integral": further},
                   (*guards, *demands, *_periodic(period),
                    *(Guard(time, ">", LEAST_TIME, "OUT_OF_RANGE") for time in ca.vertsplit(integral_time))),
                   api.lengths)


def _actuators(api: Symbols, plant: Plant) -> list[ActuatorHydraulics]:
    """The plant's actuators, whose strokes begin at the dead lengths of the parameters."""
    found = [copy(each) for each in plant.actuators]
    for each in found:
        if isinstance(each.actuator, Cylinder):
            each.dead_length = api.dynamics.geometry.value[f"{each.actuator.name}.dead_length"]
    return found


def _length(api: Symbols, each: ActuatorHydraulics) -> ca.SX:
    """Length of a cylinder [m]; angle or place of a motor's joint."""
    if not isinstance(each.actuator, Cylinder):
        return api.coordinates.q[api.machine.joints.index(each.actuator.joint)]
    return api.dynamics.cylinders[each.actuator.name].length


def _lever_arms(api: Symbols, plant: Plant) -> ca.SX:
    """Speeds (a, n) of the actuators per speed of each joint."""
    return api.dynamics.transmission[[api.machine.actuators.index(each.actuator) for each in plant.actuators], :]


def _value(plant: Plant, each: ActuatorHydraulics) -> Value:
    """The numbers of an actuator's circuit, as constants in the code."""
    return plant.value(each, ca.SX(ca.DM(plant.parameters.nominal)))


def _pressures(api: Symbols) -> tuple[Field, ...]:
    return (Field("pressure_a", (api.valve,), "Pa", f"in the head of a cylinder, at port A of a motor, {ABOVE}"),
            Field("pressure_b", (api.valve,), "Pa", f"in the rod side of a cylinder, at port B of a motor, {ABOVE}"),
            Field("supply", (2,), "Pa", f"pressures of supply and tank, {ABOVE}"))


def _factors(api: Symbols) -> tuple[Field, ...]:
    return tuple(Field(f"factor_{way}", (api.valve,), "1", f"by which the flow of an {way} actuator differs from the "
                       "machine file's, from `valve_refit`; 1 without" if way == "extending" else
                       f"the same of a {way} one") for way in ("extending", "retracting"))


def _supplied(api: Symbols) -> tuple[Guard, ...]:
    """Checks of the pressures: none that cannot be, and the supply's above the tank's."""
    supply = api.inputs["supply"]
    return (*api.pressures("pressure_a", "pressure_b", "supply"),
            Guard(supply[0] - supply[1], ">", valve_inversion.DROP, "NO_SUPPLY"))


def _periodic(period: ca.SX) -> tuple[Guard, ...]:
    return Guard(period, ">", 0.0, "OUT_OF_RANGE"), Guard(period, "<=", refit.MEMORY, "OUT_OF_RANGE")
