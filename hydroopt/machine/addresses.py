"""The address of each number of a machine: its name in files, problems, estimates and C, and its place in the file."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from hydroopt.machine.actuators import Actuator, Cylinder, Drive, GasCylinder
from hydroopt.machine.calibration_chain import Fixture
from hydroopt.machine.couplings import Coupling
from hydroopt.machine.datums import Datum
from hydroopt.machine.instruments import Instrument
from hydroopt.machine.links import Body, JointSpring, Link
from hydroopt.machine.loops import Loop
from hydroopt.machine.parameter_kind import INERTIAL_KINDS, ParameterKind
from hydroopt.machine.springs import Pinned, Spring
from hydroopt.machine.targets import Target
from hydroopt.machine.valves import EDGES, Circuit, Oil
from hydroopt.spatial import inertia

DENAVIT_HARTENBERG = {"theta": "rad", "d": "m", "a": "m", "alpha": "rad", "beta": "rad"}
AXES = ("x", "y", "z")
TURNS = ("roll", "pitch", "yaw")
_CYLINDER_UNITS = (dict.fromkeys(("offset", "coulomb", "coulomb_reverse", "stribeck"), "N")
                   | dict.fromkeys(("viscous", "viscous_reverse"), "N*s/m") | {"stribeck_speed": "m/s"})
_FRICTION_KINDS = {"offset": ParameterKind.FORCE_OFFSET, "coulomb": ParameterKind.COULOMB_FRICTION,
                   "coulomb_reverse": ParameterKind.COULOMB_FRICTION, "viscous": ParameterKind.VISCOUS_FRICTION,
                   "viscous_reverse": ParameterKind.VISCOUS_FRICTION, "stribeck": ParameterKind.STRIBECK_FRICTION}
"""Terms of an actuator's friction by their keys in the machine file, in the order of Eq. 4.53, 4.54."""


class Number(NamedTuple):
    """A number that the machine file states.

    Attributes:
        name: its address, ``boom_cylinder.rod.mc_x``.
        kind, unit, value: in SI.
        path: key of its note, ``boom_cylinder.rod.body.mc``.
        axis: place in the vector under that key, if it is one.
    """

    name: str
    kind: ParameterKind
    unit: str
    value: float
    path: str
    axis: int | None = None


def body_numbers(owner: str, body: Body, path: str) -> Iterator[Number]:
    """The ten inertial parameters about the frame's origin, however the file states the body."""
    places = [("m", None), *(("mc", k) for k in range(3)), *(("inertia", k) for k in range(6))]
    for name, kind, unit, value, (key, axis) in zip(inertia.NAMES, INERTIAL_KINDS, inertia.UNITS, body.phi.tolist(),
                                                    places, strict=True):
        yield Number(f"{owner}.{name}", kind, unit, value, f"{path}.{key}", axis)


def cylinder_bodies(cylinder: Cylinder) -> Iterator[Number]:
    """Inertial parameters of a cylinder's rod and barrel."""
    for end, attachment in (("rod", cylinder.rod), ("barrel", cylinder.barrel)):
        if attachment.body is not None:
            yield from body_numbers(f"{cylinder.name}.{end}", attachment.body, f"{cylinder.name}.{end}.body")


def joint_friction(link: Link, units: Mapping[str, str]) -> Iterator[Number]:
    """Friction about or along a joint; `units` by key."""
    for key in ("coulomb", "viscous"):
        if (value := getattr(link.joint.friction, key)) is not None:
            yield Number(f"{link.name}.tau_{key}", _FRICTION_KINDS[key], units[key], value,
                         f"{link.name}.joint.friction.{key}")


def actuator_numbers(actuator: Actuator, units: Mapping[str, str]) -> Iterator[Number]:
    """Offset, friction and rotor of an actuator; `units` of torques by key, which a cylinder does not need."""
    name, friction, path = actuator.name, actuator.friction, f"{actuator.name}.friction"
    units = _CYLINDER_UNITS if isinstance(actuator, Cylinder) else units
    for key, kind in _FRICTION_KINDS.items():
        if (value := getattr(friction, key)) is not None:
            yield Number(f"{name}.{actuator.effort_symbol}_{key}", kind, units[key], value, f"{path}.{key}")
    if friction.stribeck_speed is not None:
        yield Number(f"{name}.v_stribeck", ParameterKind.STRIBECK_SPEED, units["stribeck_speed"],
                     friction.stribeck_speed, f"{path}.stribeck_speed")
    if isinstance(actuator, Cylinder):
        if actuator.friction.seal is not None:
            yield Number(f"{name}.f_seal", ParameterKind.SEAL_FRICTION, "m^2", actuator.friction.seal, f"{path}.seal")
        for end in ("barrel", "rod"):
            if (value := getattr(friction, f"{end}_pin")) is not None:
                yield Number(f"{name}.n_{end}", ParameterKind.PIN_FRICTION, "N*m", value, f"{path}.{end}_pin")
    elif isinstance(actuator, Drive) and actuator.rotor_inertia is not None:
        yield Number(f"{name}.rotor_inertia", ParameterKind.ROTOR_INERTIA, "kg*m^2", actuator.rotor_inertia,
                     f"{name}.rotor_inertia")


def gas_numbers(gas: GasCylinder) -> Iterator[Number]:
    """The pressure of a gas-charged cylinder."""
    yield Number(f"{gas.name}.precharge", ParameterKind.GAS_PRESSURE, "Pa", gas.precharge, f"{gas.name}.precharge")


def spring_numbers(spring: Spring) -> Iterator[Number]:
    """Stiffness and preload of a spring between two pins."""
    return _elastic(spring.name, spring, spring.name, {"stiffness": "N/m", "preload": "N"})


def joint_spring(link: Link, units: Mapping[str, str]) -> Iterator[Number]:
    """Stiffness and preload of the spring at a joint; `units` by key."""
    if link.joint.spring is not None:
        yield from _elastic(link.name, link.joint.spring, f"{link.name}.joint.spring", units)


def _elastic(owner: str, spring: Spring | JointSpring, path: str, units: Mapping[str, str]) -> Iterator[Number]:
    yield Number(f"{owner}.stiffness", ParameterKind.STIFFNESS, units["stiffness"], spring.stiffness,
                 f"{path}.stiffness")
    if spring.preload is not None:
        yield Number(f"{owner}.preload", ParameterKind.PRELOAD, units["preload"], spring.preload, f"{path}.preload")


def oil_numbers(oil: Oil) -> Iterator[Number]:
    """Bulk modulus and air of the oil."""
    yield Number("oil.bulk_modulus", ParameterKind.BULK_MODULUS, "Pa", oil.bulk_modulus, "oil.bulk_modulus")
    yield Number("oil.air", ParameterKind.AIR, "1", oil.air, "oil.air")


def circuit_numbers(owner: str, circuit: Circuit) -> Iterator[Number]:
    """Valve, hoses and leaks of one actuator."""
    valve, kinds = circuit.valve, ParameterKind
    stated = [*((valve, "valve.", key, kinds.RATED_FLOW, "m^3/s") for key in ("rated_flow", *EDGES)),
              *((valve, "valve.", key, kinds.DEAD_BAND, valve.command) for key in ("dead_band", "dead_band_reverse")),
              (valve, "valve.", "overlap", kinds.OVERLAP, "1"),
              (valve, "valve.", "natural_frequency", kinds.SPOOL_FREQUENCY, "Hz"),
              (valve, "valve.", "damping", kinds.SPOOL_DAMPING, "1"),
              (valve, "valve.", "delay", kinds.DELAY, "s"),
              *((circuit, "", key, kinds.VOLUME, "m^3") for key in ("volume_a", "volume_b")),
              (circuit, "", "hose_modulus", kinds.HOSE_MODULUS, "Pa"),
              *((circuit, "", key, kinds.LEAKAGE, "m^3/(s*Pa)") for key in ("leakage", "leakage_a", "leakage_b")),
              *((circuit, "", key, kinds.AIR, "1") for key in ("air_a", "air_b"))]
    for part, under, key, kind, unit in stated:
        value = getattr(part, key)
        if value is not None and not (kind is kinds.DELAY and value == 0):
            yield Number(f"{owner}.{key}", kind, unit, value, f"{owner}.circuit.{under}{key}")


def link_geometry(link: Link) -> Iterator[Number]:
    """Denavit-Hartenberg parameters of a link (Eq. 3.8), and the pin that it turns about if it states one."""
    for key, unit in DENAVIT_HARTENBERG.items():
        yield Number(f"{link.name}.{key}", ParameterKind.ANGLE if unit == "rad" else ParameterKind.LENGTH, unit,
                     getattr(link.joint, key), f"{link.name}.joint.{key}")
    if link.pin is not None:
        yield from point(f"{link.name}.pin", link.pin, f"{link.name}.pin")


def joint_compliance(link: Link) -> Iterator[Number]:
    """How much a moving joint gives way under torque."""
    if link.joint.compliance is not None and link.joint.moving:
        yield Number(f"{link.name}.compliance", ParameterKind.COMPLIANCE,
                     "rad/(N*m)" if link.joint.type == "revolute" else "m/N", link.joint.compliance,
                     f"{link.name}.joint.compliance")


def dead_length(cylinder: Cylinder) -> Iterator[Number]:
    """Distance of a cylinder's pins when it is fully retracted."""
    yield Number(f"{cylinder.name}.dead_length", ParameterKind.DEAD_LENGTH, "m", cylinder.dead_length,
                 f"{cylinder.name}.dead_length")


def pins(cylinder: Pinned) -> Iterator[Number]:
    """Coordinates of a cylinder's pins."""
    for end, attachment in (("barrel", cylinder.barrel), ("rod", cylinder.rod)):
        yield from point(f"{cylinder.name}.{end}", attachment.pin, f"{cylinder.name}.{end}.pin")


def loop_numbers(loop: Loop) -> Iterator[Number]:
    """Coordinates of the pins at which a loop closes, and the length of its rod."""
    yield from point(loop.name, loop.to.pin, f"{loop.name}.to.pin")
    if loop.pin is not None:
        yield from point(f"{loop.name}.pin", loop.pin, f"{loop.name}.pin")
    if loop.length is not None:
        yield Number(f"{loop.name}.length", ParameterKind.LENGTH, "m", loop.length, f"{loop.name}.length")


def coupling_numbers(coupling: Coupling, units: Mapping[str, str]) -> Iterator[Number]:
    """Ratios and offset of a coupling; `units` by their keys."""
    for joint, ratio in coupling.ratios.items():
        yield Number(f"{coupling.name}.ratio.{joint}", ParameterKind.RATIO, units[f"ratio.{joint}"], ratio,
                     f"{coupling.name}.ratios.{joint}")
    yield Number(f"{coupling.name}.offset", ParameterKind.ANGLE if units["offset"] == "rad" else ParameterKind.LENGTH,
                 units["offset"], coupling.offset, f"{coupling.name}.offset")


def fixture_numbers(fixture: Fixture) -> Iterator[Number]:
    """Where a fixture stands, and how unless it is a ball."""
    yield from point(fixture.name, fixture.position, f"{fixture.name}.position")
    if fixture.kind != "ball":
        yield from orientation(fixture.name, fixture.orientation, f"{fixture.name}.orientation")


def target_numbers(target: Target) -> Iterator[Number]:
    """Where a target is on its link."""
    yield from point(target.name, target.position, f"{target.name}.position")
    yield from orientation(target.name, target.orientation, f"{target.name}.orientation")


def instrument_numbers(instrument: Instrument) -> Iterator[Number]:
    """Where an instrument stands, if the file states it."""
    if instrument.position is not None:
        yield from point(instrument.name, instrument.position, f"{instrument.name}.position")
        yield from orientation(instrument.name, instrument.turn, f"{instrument.name}.orientation")


def datum_numbers(datum: Datum) -> Iterator[Number]:
    """How far a datum is shifted and turned against its stated frame, where that changes it."""
    for axis in datum.axes:
        k = AXES.index(axis)
        yield Number(f"{datum.name}.{axis}", ParameterKind.POSITION, "m", datum.offset[k], f"{datum.name}.offset", k)
    for turn in datum.tilts:
        k = TURNS.index(turn)
        yield Number(f"{datum.name}.{turn}", ParameterKind.ORIENTATION, "rad", datum.tilt[k], f"{datum.name}.tilt", k)


def point(owner: str, coordinates: tuple[float, float, float], path: str) -> Iterator[Number]:
    """Coordinates [m] of a point."""
    for k, axis in enumerate(AXES):
        yield Number(f"{owner}.{axis}", ParameterKind.POSITION, "m", coordinates[k], path, k)


def orientation(owner: str, angles: tuple[float, float, float], path: str) -> Iterator[Number]:
    """Roll, pitch and yaw [rad] of a frame."""
    for k, axis in enumerate(TURNS):
        yield Number(f"{owner}.{axis}", ParameterKind.ORIENTATION, "rad", angles[k], path, k)


def rewrite(data: Mapping[str, Any], known: Mapping[str, Number], values: Mapping[str, float]) -> set[str]:
    """Put values, by address, into the tables of a machine's description; returns the paths that are gone.

    A body that changes is stated about its frame's origin from then on.
    """
    changed = {name: number._replace(value=float(values.get(name, number.value))) for name, number in known.items()}
    owners = dict.fromkeys(name.rpartition(".")[0] for name in values if known[name].kind.is_inertial)
    for owner in owners:
        phi = [changed[f"{owner}.{element}"].value for element in inertia.NAMES]
        name, *end, _ = changed[f"{owner}.m"].path.split(".")[:-1]
        _table(data, name, end)["body"] |= {"m": phi[0], "com": None, "mc": phi[1:4], "inertia_com": None,
                                            "inertia": phi[4:]}
    for number in (changed[name] for name in values if not known[name].kind.is_inertial):
        name, *steps, key = number.path.split(".")
        table, k = _table(data, name, steps), number.axis
        table[key] = number.value if k is None else (*table[key][:k], number.value, *table[key][k + 1:])
    return {f"{owner}.body.{key}" for owner in owners for key in ("com", "inertia_com")}


def remove_bodies(data: dict[str, Any], owners: Collection[str]) -> None:
    """Take bodies, and the statements that name them as identical, out of the tables of a machine's description."""
    for owner in owners:
        name, *end = owner.split(".")
        _table(data, name, end)["body"] = None
    for one in data["identical"]:
        one["bodies"] = [owner for owner in one["bodies"] if owner not in owners]
    data["identical"] = [one for one in data["identical"] if one["bodies"] or one["friction"]]


def _table(data: Mapping[str, Any], name: str, steps: Sequence[str]) -> dict[str, Any]:
    """The table that a path leads to: first a part by its name or a key, then keys."""
    lists = [*(value for value in data.values() if isinstance(value, list | tuple)),
             (data["calibrator"] or {}).get("links", ())]
    named = {part["name"]: part for parts in lists for part in parts if isinstance(part, dict) and "name" in part}
    table: dict[str, Any] = named.get(name) or data[name]
    for step in steps:
        table = table[step]
    return table
