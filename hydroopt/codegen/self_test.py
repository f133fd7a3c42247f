"""The values of the C self-test: states of a machine much like the one described, and what the model computes of them.

The program that compares them is ``templates/selftest.c``.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.codegen.inverse_kinematics import arm
from hydroopt.codegen.routines import Interface
from hydroopt.codegen.symbols import Guard
from hydroopt.codegen.valves import FACTORS
from hydroopt.control.valve_refit import STATE
from hydroopt.machine.parameter_kind import ParameterKind
from hydroopt.model.plant import Plant
from hydroopt.spatial.inertia import Array, from_pseudo_inertia

STATES = 4
MARGIN = 0.1
"""Part of a joint's range at each end that is left out, so that rounding exceeds no stroke."""
TRIES = 64
"""How often states are drawn anew, each time on a machine more like the one described, where linkages do not close or
rounding decides."""
CLEAR, CLEAR_SINGLE = 1e-4, 1e-2
"""How well a posture determines the wrench at the tip, see `Dynamics.tip_wrench`, where rounding does not decide it in
double and in single precision."""
ROUNDED = 2e-6
"""By which inputs that are rounded to single precision may change a result, as a part of the largest beside it: a tenth
of what the comparison allows."""
ADDED, REACH = 0.1, 0.5
"""Mass that is fixed to every body, as a part of the bodies' mean, and how far from its frame [m]."""
BENT = 0.05
"""How far from stretched an arm must be, so that rounding does not decide its angles."""


class Vectors(NamedTuple):
    """States of the self-test: inputs (`STATES`, size), results (`STATES`, rows, columns) by routine and member, and
    parameters (size,); and the routines that are left out, since no try found states that determine their results."""

    inputs: dict[str, Array]
    outputs: dict[tuple[str, str], Array]
    params: dict[str, Array]
    untested: tuple[str, ...] = ()


def vectors(interface: Interface, function: ca.Function, keys: list[tuple[str, str]], *,
            single: bool = False) -> Vectors:
    """States in which the results of all routines are determined, or of as many as possible.

    Args:
        interface: what the routines read.
        function: all their expressions; output k is member ``keys[k][1]`` of routine ``keys[k][0]``.
        keys: those pairs.
        single: whether the code computes in single precision.
    """
    best, least = None, (len(keys), np.inf)
    for seed in range(TRIES):
        inputs = states(interface, seed=seed, single=single, share=4 / (4 + seed))
        outputs = dict(zip(keys, results(function, inputs), strict=True))
        untested = _undetermined(interface, outputs, single=single)
        change = _change_by_rounding(interface, function, inputs, outputs) if single else 0.0
        if best is None or (len(untested), change) < least:
            best, least = Vectors(inputs, outputs, {name: inputs[name] for name in inputs if name in interface.values},
                                  untested), (len(untested), change)
        if not untested and change < ROUNDED:
            break
    assert best is not None
    tested = {name for name, _ in keys} - {*best.untested}
    read = {name for routine in tested for name in interface.routines[routine].reads}
    return best._replace(inputs={name: array for name, array in best.inputs.items() if name in read},
                         outputs={key: array for key, array in best.outputs.items() if key[0] in tested})


def _undetermined(interface: Interface, outputs: dict[tuple[str, str], Array], *, single: bool) -> tuple[str, ...]:
    """Routines of which a result is no number or a check does not hold, that of the wrench at the tip clearly."""
    found, clear = {}, CLEAR_SINGLE if single else CLEAR
    for (routine, key), values in outputs.items():
        guards = enumerate(interface.routines[routine].guards) if key == ":guards" else ()
        if not np.all(np.isfinite(values)) or not all(
                _holds(guard._replace(limit=clear) if (routine, guard.status) == ("tip_wrench", "SINGULAR") else guard,
                       values[:, k, 0]) for k, guard in guards):
            found[routine] = True
    return tuple(found)


def _change_by_rounding(interface: Interface, function: ca.Function, inputs: dict[str, Array],
                        outputs: dict[tuple[str, str], Array]) -> float:
    """By which results change at most if all inputs do by half a digit of single precision, as a part of the largest
    of their state and member; infinite where one is no number."""
    rng, half = np.random.default_rng(0), np.finfo(np.float32).eps / 2
    moved = results(function, {name: array * (1 + half * rng.choice([-1.0, 1.0], array.shape))
                               for name, array in inputs.items()})
    change = 0.0
    for ((routine, key), values), others in zip(outputs.items(), moved, strict=True):
        if key != ":guards" and values.size and not (routine == "closure" and interface.together):
            greatest = np.maximum(np.max(np.abs(values), axis=(1, 2)), np.finfo(np.float32).tiny)
            change = max(change, float(np.nan_to_num(np.max(np.max(np.abs(others - values), axis=(1, 2)) / greatest),
                                                     nan=np.inf)))
    return change


def _holds(guard: Guard, values: Array) -> bool:
    compare = {">": np.greater, ">=": np.greater_equal, "<": np.less, "<=": np.less_equal}[guard.relation]
    return bool(np.all(compare(np.abs(values) if guard.absolute else values, guard.limit)))


def states(interface: Interface, count: int = STATES, seed: int = 0, *, single: bool = False,
           share: float = 1.0) -> dict[str, Array]:
    """Random inputs of all routines, (count, size) each, and parameters (size,); rounded to float if `single`.

    The geometry is off that of the machine file by a `share` of what it is usually.
    """
    rng = np.random.default_rng(seed)
    machine, chain = interface.machine, interface.chain

    def between(links: dict[str, tuple[float, float]]) -> Array:
        lower, upper = np.array(list(links.values()), dtype=float).reshape(-1, 2).T
        drawn: Array = lower + (upper - lower) * rng.uniform(MARGIN, 1 - MARGIN, (count, len(links)))
        return drawn

    ranges = {link.name: link.joint.range for link in chain.links if link.joint.independent}
    q = between({joint: ranges[joint] for joint in machine.joints})
    n = len(machine.joints)
    model = interface.complete
    inputs = {
        "q": q, "qd": rng.uniform(-1, 1, (count, n)), "qdd": rng.uniform(-1, 1, (count, n)),
        "length": np.array([np.asarray(model.cylinder_kinematics(each, 0 * each, 0 * each)[0]).ravel()
                            [:len(machine.cylinders)] for each in q]),
        "speed": rng.uniform(-0.3, 0.3, (count, len(machine.cylinders))),
        "reading": rng.uniform(1e5, 2e7, (count, len(interface.kinds["reading"].names))),
        "chain_q": between({joint: ranges[joint] for joint in chain.joints}), "fixture": rng.uniform(-3, 3, (count, 3))}
    inputs["stroke"] = inputs["length"] - np.array([c.dead_length for c in machine.cylinders])
    inputs |= {name: _generic(name, array, rng, share) for name, array in interface.values.items()}
    if "psi" in inputs:
        inputs["psi"] = _possible(inputs["psi"], interface, rng)
    if interface.together:
        # lengths that give a joint together must not contradict one another
        geometry = interface.inputs.get("geometry", ca.SX(0, 1))
        lengths = ca.Function("lengths", [interface.inputs["q"], geometry], [interface.lengths])
        inputs["length"] = np.array([np.asarray(lengths(each, inputs.get("geometry", np.zeros(0)))).ravel()
                                     for each in q])
    if "wrench" in interface.inputs:
        inputs["wrench"] = rng.uniform(-1e4, 1e4, (count, 6))
    if "tilted_regressor" in interface.routines:
        psi = inputs["psi"]
        inputs |= {"gravity": rng.uniform(-10, 10, (count, 3)),
                   "loaded_psi": psi + rng.uniform(-0.1, 0.1, (count, len(psi))) * np.maximum(np.abs(psi), 10.0)}
    if "forward_dynamics" in interface.routines:
        inputs["actuator_force"] = rng.uniform(-1e5, 1e5, (count, len(machine.actuators)))
    if "valve_feedforward" in interface.routines:
        valves = (count, len(machine.powered))
        inputs |= {"speed_added": rng.uniform(-0.1, 0.1, valves), "force_rate": rng.uniform(-1e5, 1e5, valves),
                  "pressure_a": rng.uniform(1e6, 2e7, valves), "pressure_b": rng.uniform(1e6, 2e7, valves),
                  "supply": np.tile([2.5e7, 3e5], (count, 1))}
        inputs |= _samples_of_control(interface, count, rng)
    if interface.designed_motion is not None:
        inputs["t"] = rng.uniform(0, interface.designed_motion.duration, (count, 1))
    if "inverse_kinematics" in interface.routines:
        inputs |= _targets(interface, inputs)
    if "q_demanded" in inputs:
        inputs["q_demanded"] += q
    inputs = {name: inputs[name] for name in interface.inputs}
    return {name: array.astype(np.float32).astype(float) if single else array for name, array in inputs.items()}


def _samples_of_control(interface: Interface, count: int, rng: np.random.Generator) -> dict[str, Array]:
    """Readings, gains and what was kept before, of the routines that run in a loop; the valves' estimate has begun."""
    valves, axes = (count, len(interface.machine.powered)), (count, len(interface.kinds["axis"].names))
    made = {name: rng.uniform(0.9, 1.1, valves) for name in FACTORS}
    made |= {"acting": np.tile([each.valve.neutral + 0.5 * each.valve.span
                                for each in Plant(interface.complete).actuators], (count, 1)),
             "period": np.full((count, 1), 0.0625), "state": np.zeros((count, len(STATE) * valves[1])),
             "q_demanded": rng.uniform(-0.01, 0.01, (count, len(interface.machine.joints)))}
    made["state"][:, [k for k in range(made["state"].shape[1]) if STATE[k % len(STATE)] in ("started", "variance")]] = 1
    made |= {name: rng.uniform(-1e4, 1e4, valves) for name in ("force_measured", "force_demanded")}
    made |= {"opening_before": rng.uniform(-0.5, 0.5, valves), "speed_before": rng.uniform(-0.1, 0.1, valves),
             "force_gain": rng.uniform(1e-8, 1e-6, valves), "integral": rng.uniform(-0.01, 0.01, axes)}
    return made | {name: rng.uniform(0.5, 2.0, axes) for name in ("position_gain", "integral_time", "filter_time")}


def _targets(interface: Interface, inputs: dict[str, Array]) -> dict[str, Array]:
    """Where the tip is in each state, and a branch that leads there."""
    routine, (_, held) = interface.routines["inverse_kinematics"], arm(interface)
    q, rows = inputs["q"], [interface.machine.joints.index(joint) for joint in held]
    geometry = interface.inputs.get("geometry", ca.SX(0, 1))
    values = inputs.get("geometry", np.zeros(0))
    tip = ca.Function("tip", [interface.inputs["q"], geometry], [interface.dynamics.tip.origin])
    made = {"position": np.array([np.asarray(tip(each, values)).ravel() for each in q]), "held": q[:, rows]}
    signs = [name for name in ("reach", "elbow") if name in routine.reads]
    given = [interface.inputs[name] for name in (*routine.reads, "geometry") if name in interface.inputs]
    sizes = [ca.fabs(guard.value) if guard.absolute else guard.value for guard in routine.guards]
    holds = [size < guard.limit if guard.relation == "<"
             else size > max(guard.limit, BENT if guard.status == "SINGULAR" else 0.0)
             for size, guard in zip(sizes, routine.guards, strict=True)]
    usable = ca.Function("usable", given, [ca.vertcat(*holds)])
    branches = list(itertools.product((1.0, -1.0), repeat=len(signs)))
    chosen = np.ones((len(q), len(signs)))
    for k in range(len(q)):
        for branch in (branches[(k + i) % len(branches)] for i in range(len(branches))):
            at = {name: array[k] for name, array in made.items()} | dict(zip(signs, branch, strict=True))
            state = (*(at[name] for name in routine.reads), *([values] if len(values) else []))
            if np.all(np.asarray(usable(*state)) == 1):
                chosen[k] = branch
                break
    return {name: array for name, array in made.items() if name in routine.reads} | {
        name: chosen[:, [k]] for k, name in enumerate(signs)}


def _generic(name: str, array: Array, rng: np.random.Generator, share: float) -> Array:
    """Parameters without the zeros and right angles of a machine file, which would hide errors."""
    if name in ("shortest", "longest"):
        return np.full(len(array), 0.0 if name == "shortest" else 100.0)
    if name == "psi":
        return np.asarray(array + rng.uniform(-0.3, 0.3, len(array)) * np.maximum(np.abs(array), 100.0))
    return np.asarray(array + rng.uniform(-0.05, 0.05, len(array)) * (share if name == "geometry" else array))


def _possible(psi: Array, interface: Interface, rng: np.random.Generator) -> Array:
    """Parameters (p,) with bodies and rotors that can exist, since forward dynamics has no answer without.

    Each body is the described one with a random one of `ADDED` of the bodies' mean mass fixed to it.
    """
    parameters, nominal, made = interface.complete.parameters, interface.values["psi"], psi.copy()
    columns = list(parameters.bodies.values())
    typical = np.mean([nominal[body.start] for body in columns]) if columns else 0.0
    for body in columns:
        root = np.diag([REACH, REACH, REACH, 1.0]) @ rng.uniform(-1, 1, (4, 4))
        made[body] = nominal[body] + from_pseudo_inertia(ADDED * (typical or 1.0) * root @ root.T)
    rotors = list(parameters.places(ParameterKind.ROTOR_INERTIA))
    made[rotors] = np.abs(psi[rotors])
    return made


def results(function: ca.Function, inputs: dict[str, Array]) -> list[Array]:
    """Outputs (count, rows, columns) of a function, evaluated by CasADi state by state."""
    count = max(len(array) for array in inputs.values() if array.ndim == 2)
    rows = [function.call([ca.DM(array[k] if array.ndim == 2 else array) for array in inputs.values()])
            for k in range(count)]
    return [np.array([np.asarray(row[i].full()) for row in rows]) for i in range(function.n_out())]
