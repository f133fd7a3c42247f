"""The address of each number of a machine: its name in files, problems, estimates and C, and its place in the file."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from hydroopt.machine.links import Body
from hydroopt.machine.parameter_kind import INERTIAL_KINDS
from hydroopt.machine.parameter_kind import ParameterKind as Kind
from hydroopt.machine.quantity import Noun
from hydroopt.machine.sensors import Rangefinder
from hydroopt.machine.survey import Datum
from hydroopt.machine.valves import EDGES
from hydroopt.spatial import inertia

AXES = ("x", "y", "z")
TURNS = ("roll", "pitch", "yaw")
Row = tuple[str, Kind] | tuple[str, Kind, str]
"""A key of a part, by the steps to it; the kind of its number; and the end of its address, the key itself if left out.

The address of a vector ends with its axes behind that, of a table of numbers with its keys; ``{}`` stands for what
parameters of an actuator's effort begin with.
"""
FRAME: tuple[Row, ...] = (("position", Kind.POSITION, ""), ("orientation", Kind.ORIENTATION, ""))
DATUM: tuple[Row, ...] = (("offset", Kind.POSITION, ""), ("tilt", Kind.ORIENTATION, ""))
BEAM: tuple[Row, ...] = (("position", Kind.POSITION, ""), ("direction", Kind.ORIENTATION, "direction."))
ENDS: tuple[Row, ...] = tuple((f"{end}.pin", Kind.POSITION, f"{end}.") for end in ("barrel", "rod"))
MEASURING = {"imus": FRAME, "targets": FRAME, "instruments": FRAME, "datums": DATUM, "rangefinders": BEAM}
"""What measures poses, and its targets: the key of its table, and its rows."""
DENAVIT_HARTENBERG: tuple[Row, ...] = (
    ("joint.theta", Kind.ANGLE), ("joint.d", Kind.LENGTH), ("joint.a", Kind.LENGTH), ("joint.alpha", Kind.ANGLE),
    ("joint.beta", Kind.ANGLE), ("pin", Kind.POSITION, "pin."))
LOOP: tuple[Row, ...] = (("to.pin", Kind.POSITION, ""), ("pin", Kind.POSITION, "pin."), ("length", Kind.LENGTH))
COUPLING: tuple[Row, ...] = (("ratios", Kind.RATIO, "ratio."), ("offset", Kind.LENGTH))
ELASTIC: tuple[Row, ...] = (("stiffness", Kind.STIFFNESS), ("preload", Kind.PRELOAD))
JOINT: tuple[Row, ...] = (
    ("joint.friction.coulomb", Kind.COULOMB_FRICTION, "tau_coulomb"),
    ("joint.friction.viscous", Kind.VISCOUS_FRICTION, "tau_viscous"),
    ("joint.spring.stiffness", Kind.STIFFNESS), ("joint.spring.preload", Kind.PRELOAD))
ACTUATOR: tuple[Row, ...] = (
    ("friction.offset", Kind.FORCE_OFFSET, "{}_offset"), ("friction.coulomb", Kind.COULOMB_FRICTION, "{}_coulomb"),
    ("friction.coulomb_reverse", Kind.COULOMB_FRICTION, "{}_coulomb_reverse"),
    ("friction.viscous", Kind.VISCOUS_FRICTION, "{}_viscous"),
    ("friction.viscous_reverse", Kind.VISCOUS_FRICTION, "{}_viscous_reverse"),
    ("friction.stribeck", Kind.STRIBECK_FRICTION, "{}_stribeck"),
    ("friction.stribeck_speed", Kind.STRIBECK_SPEED, "v_stribeck"), ("friction.seal", Kind.SEAL_FRICTION, "f_seal"),
    ("friction.barrel_pin", Kind.PIN_FRICTION, "n_barrel"), ("friction.rod_pin", Kind.PIN_FRICTION, "n_rod"),
    ("rotor_inertia", Kind.ROTOR_INERTIA))
"""In the order of Eq. 4.53, 4.54."""
OIL: tuple[Row, ...] = (("bulk_modulus", Kind.BULK_MODULUS), ("air", Kind.AIR))
CIRCUIT: tuple[Row, ...] = (
    *((f"valve.{key}", Kind.RATED_FLOW) for key in ("rated_flow", *EDGES)), ("valve.dead_band", Kind.DEAD_BAND),
    ("valve.dead_band_reverse", Kind.DEAD_BAND), ("valve.overlap", Kind.OVERLAP),
    ("valve.natural_frequency", Kind.SPOOL_FREQUENCY), ("valve.damping", Kind.SPOOL_DAMPING),
    ("valve.delay", Kind.DELAY), ("volume_a", Kind.VOLUME), ("volume_b", Kind.VOLUME),
    ("hose_modulus", Kind.HOSE_MODULUS), ("leakage", Kind.LEAKAGE), ("leakage_a", Kind.LEAKAGE),
    ("leakage_b", Kind.LEAKAGE), ("air_a", Kind.AIR), ("air_b", Kind.AIR))


class Number(NamedTuple):
    """A number that the machine file states.

    Attributes:
        name: its address, ``boom_cylinder.rod.mc_x``.
        kind, unit, value: in SI.
        path: key of its note, ``boom_cylinder.rod.body.mc``.
        axis: place in the vector under that key, if it is one.
    """

    name: str
    kind: Kind
    unit: str
    value: float
    path: str
    axis: int | None = None


Unit = Callable[[Noun, str, str], str | None]
"""SI unit of a key of a part, which belongs to the part or joint of a name."""


def stated(part: Noun, rows: Sequence[Row], unit: Unit, owner: str, path: str | None = None) -> Iterator[Number]:
    """Numbers that a part states under the keys of a table; `owner` begins their addresses, `path` their places."""
    for key, kind, *end in rows:
        *steps, last = key.split(".")
        node: Any = part
        for step in steps:
            node = getattr(node, step, None)
        value = getattr(node, last, None)
        if kind is Kind.ORIENTATION and value is None and getattr(part, "position", None) is not None:
            value = (0.0, 0.0, 0.0)  # of an instrument
        if value is None or (kind is Kind.DELAY and value == 0):
            continue
        si = None if isinstance(value, dict) else unit(node, last, owner)
        name, at = f"{owner}.{(*end, last)[0]}", f"{path or owner}.{key}"
        if isinstance(value, tuple):
            axes = TURNS if si == "rad" else AXES
            free = (*part.axes, *part.tilts) if isinstance(part, Datum) else (
                part.across if isinstance(part, Rangefinder) and key == "direction" else axes)
            for k, axis in enumerate(axes):
                if axis in free:
                    yield Number(f"{name}{axis}", kind, si or "1", value[k], at, k)
        elif isinstance(value, dict):
            for each, one in value.items():
                yield Number(f"{name}{each}", kind, unit(node, last, each) or "1", one, f"{at}.{each}")
        else:
            name = name.format(getattr(part, "effort_symbol", ""))
            yield Number(name, Kind.ANGLE if kind is Kind.LENGTH and si == "rad" else kind, si or "1", value, at)


def body_numbers(owner: str, body: Body, path: str) -> Iterator[Number]:
    """The ten inertial parameters about the frame's origin, however the file states the body."""
    places = [("m", None), *(("mc", k) for k in range(3)), *(("inertia", k) for k in range(6))]
    for name, kind, unit, value, (key, axis) in zip(inertia.NAMES, INERTIAL_KINDS, inertia.UNITS, body.phi.tolist(),
                                                    places, strict=True):
        yield Number(f"{owner}.{name}", kind, unit, value, f"{path}.{key}", axis)


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
