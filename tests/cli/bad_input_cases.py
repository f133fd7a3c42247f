"""What can be wrong with machine files, logs, maps and options: each case spoils a good input in one way.

A case is a function that writes its input into a folder and returns the arguments of the command, with a pattern of
the place that the sentence must name.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine, load_machine
from hydroopt.model.model import Model
from hydroopt.simulation import simulate as synthetic

UR10E = (Path(__file__).parents[3] / "shared/data/ur10e_mamedov/dataset_ur10e/identification_data"
         / "ur-20_02_19_15harm50secLoad.csv")

DIGGER = """\
name = "digger"
gravity = "9.81 m/s^2"
orientation = ["0 deg", "0 deg", "0 deg"]
default_parameter_set = "guess"

[[links]]
name = "swing"
joint = { type = "revolute", a = "0.34 m", alpha = "-90 deg", lower = "-180 deg", upper = "180 deg" }

[[links]]
name = "boom"
joint = { type = "revolute", a = "5.18 m", d = "-0.11 m", lower = "-60 deg", upper = "25 deg" }
[links.body]
m = { value = "1830 kg", sigma = "20 %", source = "guess" }
com = ["2.3 m", "0.2 m", "0 m"]
inertia_com = ["100 kg*m^2", "0 kg*m^2", "0 kg*m^2", "15400 kg*m^2", "0 kg*m^2", "15400 kg*m^2"]

[[links]]
name = "stick"
parent = "boom"
[links.joint]
type = "revolute"
a = "1.8 m"
lower = "35 deg"
upper = "145 deg"

[[links]]
name = "bucket"
parent = "stick"
joint = { type = "locked" }

[[motors]]
name = "swing_motor"
joint = "swing"
torque_per_pressure = "0.089 N*m/psi"
gear = 307

[[cylinders]]
name = "boom_cylinder"
jacks = 2
head_area = "15.9 in^2"
rod_area = "9.96 in^2"
dead_length = "1.423 m"
stroke = "1.1 m"
barrel = { link = "swing", pin = ["0.80737 m", "-0.11 m", "-0.41495 m"] }
rod = { link = "boom", pin = ["1.59727 m", "-1.20363 m", "0 m"] }

[[cylinders]]
name = "stick_cylinder"
bore = "140 mm"
rod_diameter = "89 mm"
dead_length = "1.799 m"
stroke = "1.35 m"
barrel = { link = "boom", pin = ["2.95961 m", "-1.02128 m", "0 m"] }
rod = { link = "stick", pin = ["-0.58979 m", "-0.41298 m", "0 m"] }
friction = { coulomb = { value = "100 N", sigma = "50 N" } }

[[gas_cylinders]]
name = "balance"
barrel = { link = "swing", pin = ["0.7 m", "-0.11 m", "-0.4 m"] }
rod = { link = "boom", pin = ["1.5 m", "-1 m", "0 m"] }
acts = "push"
area = "50 cm^2"
volume = "10 l"
reference_length = "1.4 m"
precharge = "20 bar"
polytropic = 1.3

[[sensors]]
channels = ["boom.q", "stick.q"]
accuracy = "0.1 deg"

[[sensors]]
channels = ["boom_cylinder.p_head", "boom_cylinder.p_rod"]
accuracy = "25 psi"

[parameter_sets.guess.stick]
m = "688 kg"
com = ["0.9 m", "0.1 m", "0 m"]
inertia_com = ["10 kg*m^2", "0 kg*m^2", "0 kg*m^2", "600 kg*m^2", "0 kg*m^2", "600 kg*m^2"]
"""
"""A good machine file with one of everything."""


@dataclass(frozen=True)
class Case:
    """`spoil` writes into a folder and returns arguments; `place` is a pattern of what the sentence must name."""

    spoil: Callable[[Path], list[str]]
    place: str


def edited(text: str, old: str, new: str) -> str:
    assert text.count(old) == 1, f"{old!r} stands there {text.count(old)} times"
    return text.replace(old, new)


def machine(old: str, new: str, place: str) -> Case:
    """The good machine file with one statement replaced."""
    return Case(lambda folder: show(folder, edited(DIGGER, old, new)), rf"digger\.toml: {place}")


def show(folder: Path, content: str | bytes, name: str = "digger.toml") -> list[str]:
    return ["show", str(written(folder, content, name))]


def written(folder: Path, content: str | bytes, name: str) -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def _directory(folder: Path) -> list[str]:
    (folder / "digger.toml").mkdir()
    return ["show", str(folder / "digger.toml")]


def known(statement: str, place: str) -> Case:
    """The good machine file with a statement about the boom's body."""
    return machine('com = ["2.3 m", "0.2 m", "0 m"]\n', f'com = ["2.3 m", "0.2 m", "0 m"]\n{statement}\n', place)


def weighed(statement: str, place: str, value: str = "2 t") -> Case:
    """The good machine file with a total mass."""
    return machine('[[motors]]\n', f'[[total_masses]]\nname = "ticket"\nvalue = "{value}"\n{statement}\n[[motors]]\n',
                   place)


def alike(statement: str, place: str) -> Case:
    """The good machine file with parts that are said to be alike."""
    return machine('[[motors]]\n', f'[[identical]]\nname = "pair"\n{statement}\n[[motors]]\n', place)


BODY = 'm = "688 kg"\n'
FILES = {
    "machine: not TOML": Case(lambda d: show(d, DIGGER + "pin = [1,\n"), r"digger\.toml: .*end of document"),
    "machine: not TOML, value without quotes": Case(
        lambda d: show(d, edited(DIGGER, '"1.1 m"', "1.1 m")), r"digger\.toml: .*line 44"),
    "machine: empty": Case(lambda d: show(d, ""), r"digger\.toml: .*empty"),
    "machine: comments only": Case(lambda d: show(d, "# to do\n"), r"digger\.toml: .*empty"),
    "machine: no such file": Case(lambda d: ["show", str(d / "digger.toml")], r"digger\.toml: "),
    "machine: a directory": Case(_directory, r"digger\.toml: .*directory"),
    "machine: binary": Case(lambda d: show(d, bytes(range(256)) * 4), r"digger\.toml: .*text"),
    "machine: binary with zeros": Case(lambda d: show(d, b"\x00\x01" * 64), r"digger\.toml: .*text"),
    "machine: misspelt name": Case(lambda d: ["show", "cat215"], r"cat215: .*; .*cat215b"),
    "machine: wrong extension": Case(lambda d: show(d, DIGGER, "digger.yaml"), r"digger\.yaml: .*; .*\.toml"),
    "machine: unknown set asked for": Case(
        lambda d: [*show(d, DIGGER), "--set", "measured"], r"digger\.toml: .*'measured'; .*guess"),
}
MACHINES = {
    # keys
    "no name": machine('name = "digger"\n', "", "name: "),
    "no links": Case(lambda d: show(d, 'name = "digger"\n'), r"digger\.toml: links: "),
    "links not a list": Case(lambda d: show(d, 'name = "digger"\nlinks = 3\n'), r"digger\.toml: links: "),
    "links is a table": Case(lambda d: show(d, 'name = "digger"\n[links]\nname = "boom"\n'), r"digger\.toml: links: "),
    "a link without joint": machine('joint = { type = "locked" }\n', "", r"links\[bucket\]\.joint: "),
    "a link without name": machine('name = "bucket"\n', "", r"links\[3\]\.name: "),
    "no limits": machine(', lower = "-60 deg", upper = "25 deg"', "", r"links\[boom\]\.joint: .*'lower' and 'upper'"),
    "unknown key at the top": machine('gravity =', 'gravitation =', "gravitation: "),
    "unknown key deep": machine('dead_length = "1.799 m"', 'dead_lenght = "1.799 m"',
                                r"cylinders\[stick_cylinder\]\.dead_len"),
    "unknown key in a body": machine('com = ["2.3 m"', 'cog = ["2.3 m"', r"links\[boom\]\.body\.c"),
    "unknown key of a note": machine('sigma = "20 %"', 'std = "20 %"', r"links\[boom\]\.body\.m\.std: "),
    "table for a number": machine('gear = 307', 'gear = { ratio = 307 }', r"motors\[swing_motor\]\.gear: "),
    "missing torque": machine('torque_per_pressure = "0.089 N*m/psi"\n', "",
                              r"motors\[swing_motor\]\.torque_per_pressure: "),
    # units and numbers
    "angle for a length": machine('a = "5.18 m"', 'a = "5.18 deg"', r"links\[boom\]\.joint\.a: 'deg'.*'m'"),
    "length for an angle": machine('lower = "35 deg"', 'lower = "35 mm"', r"links\[stick\]\.joint\.lower: 'mm'"),
    "number without unit": machine('a = "1.8 m"', "a = 1.8", r"links\[stick\]\.joint\.a: .*; .*1\.8 m"),
    "limit without unit": machine('upper = "145 deg"', "upper = 145", r"links\[stick\]\.joint\.upper: .*; .*rad"),
    "text for a number": machine('stroke = "1.1 m"', 'stroke = "about 1 m"',
                                 r"cylinders\[boom_cylinder\]\.stroke: 'about 1 m'"),
    "decimal comma": machine('stroke = "1.1 m"', 'stroke = "1,1 m"', r"cylinders\[boom_cylinder\]\.stroke: '1,1 m'"),
    "unknown unit": machine('"140 mm"', '"140 furlongz"', r"cylinders\[stick_cylinder\]\.bore: 'furlongz'"),
    "unit glued to its number": machine('"140 mm"', '"140mm"', r"cylinders\[stick_cylinder\]\.bore: '140mm'"),
    "orientation in metres": machine('["0 deg", "0 deg", "0 deg"]', '["0 m", "0 deg", "0 deg"]',
                                     r"orientation\[0\]: 'm'"),
    "true for a number": machine("gear = 307", "gear = true", r"motors\[swing_motor\]\.gear: "),
    "jacks not whole": machine("jacks = 2", "jacks = 1.5", r"cylinders\[boom_cylinder\]\.jacks: "),
    "negative area": machine('"15.9 in^2"', '"-15.9 in^2"', r"cylinders\[boom_cylinder\]\.head_area: "),
    "rod area above head area": machine('"9.96 in^2"', '"19.96 in^2"', r"cylinders\[boom_cylinder\]: "),
    "bore and areas": machine('jacks = 2', 'bore = "100 mm"', r"cylinders\[boom_cylinder\]: .*; .*'bore'"),
    "negative mass": machine('value = "1830 kg"', 'value = "-1830 kg"', r"links\[boom\]\.body\.m: "),
    "mass not a number": machine('value = "1830 kg"', 'value = "nan kg"', r"links\[boom\]\.body\.m: "),
    "infinite mass": machine('value = "1830 kg"', 'value = "inf kg"', r"links\[boom\]\.body\.m: "),
    "infinite limit": machine('upper = "145 deg"', 'upper = "inf deg"', r"links\[stick\]\.joint\.upper: "),
    "limit not a number": machine('upper = "145 deg"', 'upper = "nan deg"', r"links\[stick\]\.joint\.upper: "),
    "no inertia": machine(
        'inertia_com = ["100 kg*m^2", "0 kg*m^2", "0 kg*m^2", "15400 kg*m^2", "0 kg*m^2", "15400 kg*m^2"]\n', "",
        r"links\[boom\]\.body: .*inertia_com"),
    "inertia of three numbers": machine(
        '["100 kg*m^2", "0 kg*m^2", "0 kg*m^2", "15400 kg*m^2", "0 kg*m^2", "15400 kg*m^2"]',
        '["100 kg*m^2", "15400 kg*m^2", "15400 kg*m^2"]', r"links\[boom\]\.body\.inertia_com: .*6"),
    "pin of two numbers": machine('["-0.58979 m", "-0.41298 m", "0 m"]', '["-0.58979 m", "-0.41298 m"]',
                                  r"cylinders\[stick_cylinder\]\.rod\.pin: .*3"),
    "pin of four numbers": machine('["-0.58979 m", "-0.41298 m", "0 m"]', '["-0.58979 m", "-0.41298 m", "0 m", "0 m"]',
                                   r"cylinders\[stick_cylinder\]\.rod\.pin: .*3"),
    "pin as text": machine('["-0.58979 m", "-0.41298 m", "0 m"]', '"-0.6 m, -0.4 m, 0 m"',
                           r"cylinders\[stick_cylinder\]\.rod\.pin: "),
    "unit wrong within a pin": machine('"-0.41298 m"', '"-0.41298 bar"',
                                       r"cylinders\[stick_cylinder\]\.rod\.pin\[1\]: 'bar'"),
    "gear of zero": machine("gear = 307", "gear = 0", r"motors\[swing_motor\]\.gear: "),
    "unknown kind of joint": machine('type = "locked"', 'type = "hinge"', r"links\[bucket\]\.joint\.type: .*revolute"),
    "polytropic exponent of 3": machine("polytropic = 1.3", "polytropic = 3",
                                        r"gas_cylinders\[balance\]\.polytropic: "),
    # geometry
    "open triangle": machine('dead_length = "1.799 m"', 'dead_length = "17.99 m"',
                             r"the triangle of 'stick_cylinder' is open.* m"),
    "pin on the joint's axis": machine('"-0.58979 m", "-0.41298 m"', '"-1.8 m", "0 m"', r".*'stick_cylinder'"),
    "stroke too short": machine('"1.35 m"', '"0.9 m"', r".*'stick_cylinder' .*stick = .* deg"),
    "dead point in the range": machine('lower = "35 deg"', 'lower = "-30 deg"', r".*'stick_cylinder' .*stick = .* deg"),
    "limits exchanged": machine('lower = "35 deg"', 'lower = "150 deg"', r"links\[stick\]\.joint: "),
    "locked joint with limits": machine('{ type = "locked" }', '{ type = "locked", lower = "0 deg" }',
                                        r"links\[bucket\]\.joint\.lower: "),
    "gas without room": machine('acts = "push"\narea = "50 cm^2"', 'acts = "pull"\narea = "500 cm^2"',
                                 r".*'balance' .*volume.*boom = .* deg"),
    # structure
    "links in a circle": machine('parent = "boom"', 'parent = "bucket"', ".*'stick'.*'bucket'"),
    "no such parent": machine('parent = "boom"', 'parent = "broom"', ".*'stick'.*'broom'"),
    "two links of one name": machine('name = "bucket"', 'name = "stick"', ".*'stick'"),
    "cylinder named as a link": machine('name = "stick_cylinder"', 'name = "stick"', ".*'stick'"),
    "link named base": machine('name = "bucket"', 'name = "base"', ".*'base'"),
    "name with a blank": machine('name = "bucket"', 'name = "big bucket"', r"links\[.*\]\.name: .*'big bucket'"),
    "name with a dot": machine('name = "swing_motor"', 'name = "swing.motor"', r"motors\[.*\]\.name: .*'swing\.motor'"),
    "joint that nothing drives": machine(
        '{ type = "locked" }', '{ type = "revolute", lower = "0 deg", upper = "1 deg" }', ".*'bucket'"),
    "two actuators on one joint": machine(
        '[[sensors]]\nchannels = ["boom.q"',
        '[[drives]]\nname = "extra"\njoint = "stick"\n[[sensors]]\nchannels = ["boom.q"',
        ".*'stick'.*'stick_cylinder'.*'extra'"),
    "actuator on the wrong joint": machine('joint = "swing"\n', 'joint = "boom"\n', ".*'swing'"),
    "cylinder within one link": machine('link = "stick"', 'link = "boom"', ".*'stick_cylinder'"),
    "cylinder on no link": machine('link = "stick"', 'link = "dipper"', ".*'stick_cylinder'.*'dipper'"),
    "motor on no joint": machine('joint = "swing"\n', 'joint = "slew"\n', ".*'swing_motor'.*'slew'"),
    # what is known about numbers
    "sensor of no channel": machine('"boom.q"', '"bucket.q"', ".*'bucket.q'"),
    "sensor of unknown kind": machine('"boom.q", "stick.q"', '"boom.angle"', r"sensors\[0\]\.channels: .*boom\.angle"),
    "sensor of angles and pressures": machine('"boom.q", "stick.q"', '"boom.q", "boom_cylinder.p_rod"',
                                              r"sensors\[0\]\.channels: "),
    "sensor of no list": machine('["boom.q", "stick.q"]', '"boom.q"', r"sensors\[0\]\.channels: .*list"),
    "two sensors of one channel": machine('"boom_cylinder.p_head", "boom_cylinder.p_rod"]\naccuracy = "25 psi"',
                                          '"boom.q"]\naccuracy = "1 deg"', ".*'boom.q'"),
    "accuracy in the wrong unit": machine('accuracy = "25 psi"', 'accuracy = "25 mm"', r"sensors\[1\].*accuracy: 'mm'"),
    "accuracy of a length for an angle": machine('accuracy = "0.1 deg"', 'accuracy = "1 mm"',
                                                 r"sensors\[0\]\.accuracy: 'mm'"),
    "force as friction of a joint that turns": machine(
        'gear = 307', 'gear = 307\nfriction = { coulomb = "5 kN" }',
        r"motors\[swing_motor\]\.friction\.coulomb: 'kN'.*'N\*m'"),
    # friction
    "Stribeck force without its speed": machine(
        'friction = { coulomb =', 'friction = { stribeck = "50 N", coulomb =',
        r"cylinders\[stick_cylinder\]\.friction\.stribeck_speed: .*; .*'stribeck_speed'"),
    "Stribeck speed without its force": machine(
        'gear = 307', 'gear = 307\nfriction = { stribeck_speed = "1 deg/s" }',
        r"motors\[swing_motor\]\.friction\.stribeck: .*; .*'stribeck'"),
    "Stribeck speed of zero": machine(
        'friction = { coulomb =', 'friction = { stribeck = "50 N", stribeck_speed = "0 m/s", coulomb =',
        r"cylinders\[stick_cylinder\]\.friction\.stribeck_speed: .*greater than 0"),
    "Stribeck speed of a length": machine(
        'friction = { coulomb =', 'friction = { stribeck = "50 N", stribeck_speed = "1 mm", coulomb =',
        r"cylinders\[stick_cylinder\]\.friction\.stribeck_speed: 'mm'"),
    "linear Stribeck speed of a joint that turns": machine(
        'gear = 307', 'gear = 307\nfriction = { stribeck = "5 N*m", stribeck_speed = "1 m/s" }',
        r"motors\[swing_motor\]\.friction\.stribeck_speed: 'm/s'.*'rad/s'"),
    "seals on a motor": machine('gear = 307', 'gear = 307\nfriction = { seal = "1 cm^2" }',
                                r"motors\[swing_motor\]\.friction\.seal: .*no meaning here"),
    "seals that hold the piston": machine(
        'friction = { coulomb =', 'friction = { seal = "100 cm^2", coulomb =',
        r"cylinders\[stick_cylinder\]\.friction\.seal: .*; .*m\^2"),
    "negative friction of seals": machine(
        'friction = { coulomb =', 'friction = { seal = "-1 cm^2", coulomb =',
        r"cylinders\[stick_cylinder\]\.friction\.seal: .*at least 0"),
    "negative Coulomb friction backwards": machine(
        'friction = { coulomb =', 'friction = { coulomb_reverse = "-5 N", coulomb =',
        r"cylinders\[stick_cylinder\]\.friction\.coulomb_reverse: .*at least 0"),
    "dead zone of zero": machine(
        'friction = { coulomb =', 'friction = { dead_zone = "0 m/s", coulomb =',
        r"cylinders\[stick_cylinder\]\.friction\.dead_zone: .*greater than 0"),
    "dead zone of nothing": machine(
        'gear = 307', 'gear = 307\nfriction = { viscous = "5 N*m*s/rad", dead_zone = "1 deg/s" }',
        r"motors\[swing_motor\]\.friction\.dead_zone: .*; .*'coulomb'"),
    "body on a gas cylinder": machine(
        'pin = ["1.5 m", "-1 m", "0 m"] }', 'pin = ["1.5 m", "-1 m", "0 m"], body = { m = "5 kg", mc = ["0 kg*m", '
        '"0 kg*m", "0 kg*m"], inertia = ["1 kg*m^2", "0 kg*m^2", "0 kg*m^2", "1 kg*m^2", "0 kg*m^2", "1 kg*m^2"] } }',
        r"gas_cylinders\[balance\]\.rod\.body: .*no body yet"),
    "negative accuracy": machine('accuracy = "25 psi"', 'accuracy = "-25 psi"', r"sensors\[1\].*accuracy: "),
    "sigma of another kind": machine('sigma = "50 N"', 'sigma = "50 bar"',
                                     r".*stick_cylinder.*friction\.coulomb\.sigma: 'bar'"),
    "sigma of zero": machine('sigma = "50 N"', 'sigma = "0 N"', r".*stick_cylinder.*friction\.coulomb"),
    "negative sigma in percent": machine('sigma = "20 %"', 'sigma = "-20 %"', r".*boom.*body\.m"),
    "sigma without unit": machine('sigma = "50 N"', "sigma = 50", r".*stick_cylinder.*friction\.coulomb\.sigma: "),
    "sigma not a number": machine('sigma = "50 N"', 'sigma = "nan N"', r".*stick_cylinder.*friction\.coulomb"),
    "bounds exchanged": machine('sigma = "50 N"', 'lower = "60 N", upper = "50 N"',
                                r".*stick_cylinder.*friction\.coulomb"),
    "source not text": machine('source = "guess"', "source = 5", r".*boom.*body\.m"),
    "unit of value unknown": machine('"100 N", sigma', '"100 quux", sigma',
                                     r".*stick_cylinder.*friction\.coulomb.*'quux'"),
    # what is known of bodies beyond numbers
    "box inside out": known('shape = { box = { lower = ["9 m", "-1 m", "-1 m"], upper = ["3 m", "1 m", "1 m"] } }',
                            r"links\[boom\]\.body\.shape\.box: along x .*9 m.*3 m"),
    "ellipsoid without extent": known(
        'shape = { ellipsoid = { centre = ["2 m", "0 m", "0 m"], semi_axes = ["2 m", "0 m", "1 m"] } }',
        r"links\[boom\]\.body\.shape\.ellipsoid\.semi_axes: "),
    "cylinder of no radius": known('shape = { cylinder = { radius = "0 m", start = "0 m", end = "3 m" } }',
                                   r"links\[boom\]\.body\.shape\.cylinder\.radius: "),
    "cylinder that ends before it starts": known(
        'shape = { cylinder = { radius = "1 m", start = "4 m", end = "3 m" } }',
        r"links\[boom\]\.body\.shape\.cylinder: .*4 m.*3 m"),
    "cylinder in degrees": known('shape = { cylinder = { radius = "1 deg", start = "0 m", end = "3 m" } }',
                                 r"links\[boom\]\.body\.shape\.cylinder\.radius: 'deg'"),
    "shape of two kinds": known(
        'shape = { cylinder = { radius = "1 m", start = "0 m", end = "5 m" }, ellipsoid = { '
        'centre = ["2 m", "0 m", "0 m"], semi_axes = ["9 m", "9 m", "9 m"] } }',
        r"links\[boom\]\.body\.shape: .*exactly one"),
    "shape of no kind": known("shape = { }", r"links\[boom\]\.body\.shape: .*exactly one"),
    "shape of an unknown kind": known('shape = { cone = { radius = "1 m" } }', r"links\[boom\]\.body\.shape\.cone: "),
    "centre of mass outside its shape": known('shape = { cylinder = { radius = "1 m", start = "0 m", end = "2 m" } }',
                                              r"links\[boom\]\.body\.shape: the centre of mass lies outside"),
    "unknown plane": known('symmetric = "zx"', r"links\[boom\]\.body\.symmetric\[0\]: .*'xy', 'xz' or 'yz'"),
    "symmetric body that is not": known('symmetric = ["xy", "xz"]',
                                         r"links\[boom\]\.body\.symmetric: .*about xz.*mc_y"),
    "total mass of no bodies": weighed("bodies = []", r"total_masses\[ticket\]\.bodies: .*empty"),
    "total mass of an unknown body": weighed('bodies = ["boom", "dipper"]',
                                             r"total_masses\[ticket\]\.bodies: 'dipper'.*boom, stick"),
    "total mass of a body twice": weighed('bodies = ["boom", "boom"]',
                                         r"total_masses\[ticket\]\.bodies: 'boom'.*twice"),
    "total mass of nothing": weighed('bodies = ["boom"]', r"total_masses\[ticket\]\.value: ", "0 kg"),
    "total mass in metres": weighed('bodies = ["boom"]', r"total_masses\[ticket\]\.value: 'm'", "3 m"),
    "total mass with a sigma in metres": weighed('bodies = ["boom"]\nsigma = "2 m"',
                                                r"total_masses\[ticket\].*sigma: 'm'"),
    "total mass with bounds": weighed('bodies = ["boom"]\nlower = "2 kg"', r"total_masses\[ticket\]: .*no bounds"),
    "two statements of one name": weighed(
        'bodies = ["boom"]\n[[identical]]\nname = "ticket"\nbodies = ["boom", "stick"]', r".*'ticket' is used 2 times"),
    "identical alone": alike('bodies = ["boom"]', r"identical\[pair\]\.bodies: 'boom' alone"),
    "identical without bodies": alike("", r"identical\[pair\]\.bodies: nothing"),
    "identical to an unknown body": alike('bodies = ["boom", "boom_cylinder.barrel"]',
                                          r"identical\[pair\]\.bodies: 'boom_cylinder\.barrel'"),
    "identical friction of other terms": alike('friction = ["boom_cylinder", "stick_cylinder"]',
                                               r"identical\[pair\]\.friction: .*same terms"),
    "no such parameter set": machine('set = "guess"', 'set = "measured"', ".*'measured'; .*guess"),
    "set of an unknown part": machine("sets.guess.stick]", "sets.guess.dipper]", ".*'guess'.*'dipper'"),
    "set is a number": machine('[parameter_sets.guess.stick]\n' + BODY, '[parameter_sets.guess]\nstick = 5\n[other]\n',
                               r"parameter_sets\.guess\.stick: "),
    "set with a bad number": machine(BODY, 'm = "688 m"\n', r"parameter_sets\.guess\.stick\.m: 'm'"),
    "set without mass": machine(BODY, "", r"parameter_sets\.guess\.stick\.m: "),
}


def good_log() -> list[str]:
    """Lines of a log of the bundled `patu655_lift` (lift.q, pressures, length), data row k on line k."""
    model = Model(load_machine("patu655_lift"))
    log = synthetic.simulate(model, synthetic.random_trajectory(model, duration=20, rate=20, seed=0))
    header = ["t [s]", *(f"{name} [{unit}]" for name, unit in log.units.items())]
    rows = zip(log.t, *log.channels.values(), strict=True)
    return [",".join(header), *(",".join(f"{x:.9g}" for x in row) for row in rows)]


GOOD_LOG = good_log()
OPEN = GOOD_LOG[0].replace("lift.q", "tilt.q")  # without the angle, it follows from the cylinder's length


def identify(folder: Path, content: str | bytes | list[str], *more: str, name: str = "log.csv") -> list[str]:
    """Arguments that identify the bundled crane from one log."""
    data = "\n".join(content) + "\n" if isinstance(content, list) else content
    return ["identify", "patu655_lift", str(written(folder, data, name)), "-o", str(folder / "out"), *more]


def log(change: Callable[[list[str]], object], place: str, *more: str) -> Case:
    """The good log with its lines changed (returned, or in place)."""
    def spoil(folder: Path) -> list[str]:
        lines = list(GOOD_LOG)
        changed = change(lines)
        return identify(folder, changed if isinstance(changed, list | bytes | str) else lines, *more)
    return Case(spoil, rf"log\.csv.*{place}")


def header(old: str, new: str) -> Callable[[list[str]], list[str]]:
    return lambda lines: [edited(lines[0], old, new), *lines[1:]]


def cell(row: int, column: int, text: str) -> Callable[[list[str]], list[str]]:
    """One cell of data row `row` (from 1) and column `column` (from 0) replaced."""
    def change(lines: list[str]) -> list[str]:
        cells = lines[row].split(",")
        cells[column] = text
        return [*lines[:row], ",".join(cells), *lines[row + 1:]]
    return change


def constant(lines: list[str]) -> list[str]:
    """The arm never moves: angle and length as in the first row."""
    first = lines[1].split(",")
    rows = [line.split(",") for line in lines[1:]]
    return [lines[0], *(",".join([row[0], first[1], *row[2:4], first[4]]) for row in rows)]


def mapped(content: str, place: str, data: list[str] | bytes | None = None, name: str = "log.csv") -> Case:
    """The good log read through a map."""
    def spoil(folder: Path) -> list[str]:
        layout = str(written(folder, content, "map.toml"))
        return identify(folder, GOOD_LOG if data is None else data, "--map", layout, name=name)
    return Case(spoil, place)


MAP = '[columns]\nt = { column = 0, unit = "s" }\n"lift.q" = { column = 1, unit = "rad" }\n'


def huge_parquet() -> bytes:
    buffer = io.BytesIO()
    pq.write_table(pa.table({"t [s]": pa.nulls(100_000_000, pa.int8()), **{
        f"lift{k}.q [rad]": pa.nulls(100_000_000, pa.int8()) for k in range(13)}}), buffer)
    return buffer.getvalue()


def huge_mat() -> bytes:
    buffer = io.BytesIO()
    savemat(buffer, {"t": [[0.0, 1.0]], "q": [[0.0, 1.0]]})
    data = bytearray(buffer.getvalue())
    at = data.index(struct.pack("<ii", 1, 2))
    data[at:at + 8] = struct.pack("<ii", 50_000, 50_000)
    return bytes(data)


def _ur10e(folder: Path) -> list[str]:
    if not UR10E.exists():
        pytest.skip(f"measured data absent: {UR10E}")
    layout = Path(__file__).parents[2] / "studies/ur10e_mamedov/map.toml"
    return ["identify", "ur10e", str(UR10E), "-o", str(folder / "out"), "--map", str(layout)]


MAT_MAP = '[columns]\nt = { variable = "t", unit = "s" }\n"lift.q" = { variable = "q", unit = "rad" }\n'
LOGS = {
    "no such log": Case(lambda d: ["identify", "patu655_lift", str(d / "log.csv"), "-o", str(d / "out")],
                        r"log\.csv: "),
    "log is a directory": Case(lambda d: ["identify", "patu655_lift", str(d), "-o", str(d / "out")], "directory"),
    "empty log": log(lambda lines: "", "empty"),
    "log with a header only": log(lambda lines: lines[:1], "header"),
    "log of one row": log(lambda lines: lines[:2], "one data row"),
    "binary log": log(lambda lines: bytes(range(256)) * 9, "binary"),
    "log of another format": Case(lambda d: identify(d, GOOD_LOG, name="log.xlsx"), r"log\.xlsx: .*; .*\.csv"),
    "CSV called Parquet": Case(lambda d: identify(d, GOOD_LOG, name="log.parquet"), r"log\.parquet: "),
    "MATLAB file without map": Case(lambda d: identify(d, GOOD_LOG, name="log.mat"), r"log\.mat: .*; .*--map"),
    "no angle and no length": log(lambda lines: [line.rpartition(",")[0] for line in header("lift.q", "tilt.q")(lines)],
                                  r"'lift\.q'"),
    "no pressure": log(header(
        "lift_cylinder.p_head [Pa]", "head pressure"), r"'lift_cylinder\.p_head'"),
    "header without unit": log(header("lift.q [rad]", "lift.q"), r"column 2 'lift\.q'.*; .*\[rad\]"),
    "unit of the wrong kind": log(header("[rad]", "[bar]"), "column 2 .*'bar'"),
    "angle in metres": log(header("lift.q [rad]", "lift.q [m]"), r"'lift\.q' .*'m'.*'lift' is revolute.*'rad'"),
    "unknown unit in a header": log(header("[rad]", "[radd]"), "column 2 .*'radd'"),
    "unknown channel": log(header("lift.q", "lift.angle"), r"column 2 .*'lift\.angle'"),
    "column twice": log(header("lift_cylinder.p_rod", "lift_cylinder.p_head"), r"column 4 .*'lift_cylinder\.p_head'"),
    "no time": log(header("t [s]", "time [s]"), r"'t \[s\]'"),
    "text among numbers": log(cell(7, 2, "n/a?"), "data row 7, column 3 .*'n/a\\?'"),
    "NaN": log(cell(7, 1, "nan"), r"lift\.q: sample 7 .*; .*--treat nan="),
    "infinite": log(cell(7, 1, "inf"), r"lift\.q: sample 7 .*; .*--treat nan="),
    "empty cell": log(cell(7, 1, ""), r"lift\.q: sample 7 .*; .*--treat nan="),
    "NaN as time": log(cell(7, 0, "nan"), r"t: sample 7 "),
    "time runs back": log(cell(50, 0, "0.01"), r"t: sample 50 .*; .*--treat non-monotonic="),
    "time stamp twice": log(cell(7, 0, "0.25"), r"t: sample 7 .*; .*--treat duplicate="),
    "ragged row": log(cell(7, 4, "1,2,3"), "data row 7 .*7 of 5 columns"),
    "last row cut": log(lambda lines: [*lines[:-1], lines[-1][:20]], "data row 400 "),
    "number beyond all measure": log(cell(7, 1, "1e200"), "data row 7 "),
    "too short to differentiate": log(lambda lines: lines[:5], "4 samples"),
    "arm that never moves": log(constant, "no joint moves"),
    "length beyond the triangle": log(lambda lines: cell(7, 4, "9.9")([OPEN, *lines[1:]]),
                                      r"sample 7,.*triangle"),
    "lines without end": log(lambda lines: "t [s]," + "x" * 5_000_000, "5000006 characters"),
    "Parquet that declares 11 GB": Case(
        lambda d: ["simulate", "patu655_lift", "--motion", str(written(d, huge_parquet(), "log.parquet")), "-o",
                   str(d / "out")], r"log\.parquet: .*GB"),
    "MATLAB that declares 20 GB": mapped(MAT_MAP, r"log\.mat: .*GB", huge_mat(), "log.mat"),
    "MATLAB cut short": mapped(MAT_MAP, r"log\.mat: ", huge_mat()[:150], "log.mat"),
    "damaged UR10e recording": Case(_ur10e, r"15harm50secLoad\.csv: data rows 2–10, 6107 .*; .*rows = \[11, 6106\]"),
    "no such map": Case(lambda d: identify(d, GOOD_LOG, "--map", str(d / "map.toml")), r"map\.toml: "),
    "map is not TOML": mapped("columns = [", r"map\.toml: "),
    "map is binary": mapped("\0\1", r"map\.toml: "),
    "map without columns": mapped("header = true\n", r"map\.toml: .*columns"),
    "map without time": mapped('[columns]\n"lift.q" = { column = 1, unit = "rad" }\n', r"map\.toml: .*'t'"),
    "map with an unknown key": mapped(MAP.replace("column = 1", "colum = 1"), r"map\.toml: .*colum"),
    "map with a unit of the wrong kind": mapped(MAP.replace('"rad"', '"bar"'), r"map\.toml: .*lift\.q.*'bar'"),
    "map of an absent column": mapped(MAP.replace("column = 1", 'column = "angle"'), r"log\.csv: .*'angle'"),
    "map of a column beyond the last": mapped(MAP.replace("column = 1", "column = 55"), r"log\.csv: .*55"),
    "map of a joint that the machine lacks": mapped(MAP.replace("lift.q", "stick.q"), r"log\.csv: .*'lift\.q'"),
    "map of rows beyond the last": mapped("rows = [1, 9999]\n" + MAP, r"log\.csv: .*9999"),
    "unknown finding to treat": log(list, "", "--treat", "dirt=drop"),
    "unknown treatment": log(list, "", "--treat", "nan=guess"),
    "treatment without action": log(list, "", "--treat", "nan"),
    "holdout leaves nothing": log(lambda lines: lines[:9], "samples", "--holdout", "0.9"),
    "validation log missing": log(list, "", "--validate", "none.csv"),
}
for name, place in {"unknown finding to treat": "treatment: 'dirt'", "unknown treatment": "treatment: 'guess'",
                    "treatment without action": "--treat: 'nan'", "validation log missing": r"none\.csv: "}.items():
    LOGS[name] = Case(LOGS[name].spoil, place)


def _in_the_way(folder: Path) -> list[str]:
    written(folder, "a file", "out")
    return identify(folder, GOOD_LOG, "--method", "wls")


def _log_in_the_way(folder: Path) -> list[str]:
    (folder / "out" / "log.csv").mkdir(parents=True)
    return ["simulate", "patu655_lift", "-o", str(folder / "out"), "--duration", "5"]


def option(*more: str, place: str) -> Case:
    return Case(lambda d: identify(d, GOOD_LOG, *more), place)


def simulate(*more: str, place: str) -> Case:
    return Case(lambda d: ["simulate", "patu655_lift", "-o", str(d / "out"), *more], place)


def sealed(folder: Path, *arguments: str) -> list[str]:
    """Arguments with the bundled crane, but with seals, for MACHINE."""
    data = load_machine("patu655_lift").model_dump()
    data["cylinders"][0]["friction"]["seal"] = 1e-4
    file = written(folder, dump_machine(Machine.model_validate(data)), "sealed.toml")
    return [str(file) if word == "MACHINE" else word for word in arguments]


def _no_pressures(folder: Path) -> list[str]:
    lines = [f"{line.rpartition(',')[0]}" for line in header("lift_cylinder.p_head [Pa]", "lift_cylinder.force [N]")(
        GOOD_LOG)]
    return sealed(folder, "identify", "MACHINE", str(written(folder, "\n".join(lines), "log.csv")),
                  "-o", str(folder / "out"))


OPTIONS = {
    "seals without pressures": Case(_no_pressures, r"log\.csv: .*'lift_cylinder\.p_head'"),
    "seals on a controller": Case(lambda d: sealed(d, "codegen", "MACHINE", "-o", str(d / "out")),
                                  r"codegen: .*lift_cylinder.*; remove 'seal'"),
    "seals in an excitation": Case(lambda d: sealed(d, "excite", "MACHINE", "-o", str(d / "out")),
                                   r"excitation: .*lift_cylinder.*; remove 'seal'"),
    "unknown friction term": option("--friction", "coulomb+sticky", place="friction 'coulomb\\+sticky': 'sticky' .*; "
                                    ".*stribeck"),
    "no friction term": option("--friction", "", place="friction '': "),
    "friction backwards of nothing": option("--friction", "auto,reverse", place="friction '.*'"),
    "dead zone of no friction": option("--friction", "viscous+dead_zone", place="friction 'viscous\\+dead_zone': "),
    "friction chosen by nothing": option("--friction", "auto", place="friction: .*; .*--validate"),
    "one of several frictions by nothing": option("--friction", "coulomb,viscous", place="friction: .*; .*--holdout"),
    "seals of a machine without cylinders": Case(
        lambda d: ["identify", "ur10", *identify(d, GOOD_LOG, "--friction", "coulomb+seal")[2:]],
        "friction 'coulomb\\+seal': .*no cylinders"),
    "unknown command": Case(lambda d: ["calibrat", "patu655_lift"], "'calibrat'"),
    "unknown option": option("--metod", "wls", place="identify: .*--metod"),
    "missing argument": Case(lambda d: ["identify", "-o", str(d / "out")], "identify: .*'MACHINE'"),
    "missing log": Case(lambda d: ["identify", "patu655_lift", "-o", str(d / "out")], r"identify: .*LOG"),
    "missing output": Case(lambda d: ["simulate", "patu655_lift"], "simulate: .*'--output'"),
    "one argument too many": Case(lambda d: ["show", "patu655_lift", "cat215b"], "show: .*cat215b"),
    "option without value": Case(lambda d: ["show", "patu655_lift", "--set"], "'--set'"),
    "text for a number's option": simulate("--rate", "fast", place="simulate: .*'--rate'"),
    "unknown method": option("--method", "magic", place="--method: 'magic'"),
    "unknown loss": option("--loss", "cubes", place="--loss: 'cubes'"),
    "unknown smoothing": option("--smoothing", "magic", place="--smoothing: 'magic'"),
    "smoothing without numbers": option("--smoothing", "fourier:x:y", place="--smoothing: 'fourier:x:y'"),
    "period longer than the log": option("--smoothing", "fourier:99:3", place=r"log\.csv: .*99 s"),
    "period not a number": option("--smoothing", "fourier:nan:3", place=r"log\.csv: .*nan"),
    "more harmonics than samples can show": option("--smoothing", "fourier:19:300",
                                                   place=r"log\.csv: harmonic 300 .*sampling"),
    "cutoff above Nyquist": option("--smoothing", "butterworth:15", place=r"log\.csv.*: .*15 Hz.*; .*10 Hz"),
    "cutoff not a number": option("--smoothing", "butterworth:nan", place=r"log\.csv.*: .*nan"),
    "unknown way to the motion": option("--motion", "guessed", place="--motion: 'guessed'"),
    "fitted motion with instruments": option("--motion", "fitted", "--instruments", "lengths",
                                             place="motion: .*choose"),
    "no such instruments": option("--instruments", "nowhere.csv", place=r"nowhere\.csv"),
    "negative bandwidth": option("--bandwidth", "-1", place="--bandwidth"),
    "bandwidth not a number": option("--bandwidth", "nan", place="--bandwidth"),
    "bandwidth far below the motion": option("--bandwidth", "1e-9", place=r"log\.csv: .*1e-09 Hz.*; .*0\.05 Hz"),
    "bandwidth for a filter": option("--bandwidth", "2", "--smoothing", "butterworth:2",
                                     place="--bandwidth: .*'butterworth:2'"),
    "bandwidth for a series": option("--bandwidth", "2", "--smoothing", "fourier:10:3",
                                     place="--bandwidth: .*'fourier:10:3'"),
    "unknown distance": option("--distance", "euclid", place="--distance: 'euclid'"),
    "log-det distance of another method": option("--distance", "log-det", "--method", "wls",
                                                 place="identification: .*'wls'"),
    "ridge of another method": option("--ridge", "1", place="--ridge: .*'sdp'"),
    "motion with a duration": simulate("--motion", "log.csv", "--duration", "5", place="--motion: .*; .*--duration"),
    "motion with a rate": simulate("--motion", "log.csv", "--rate", "5", place="--motion: .*; .*--rate"),
    "motion in the wrong unit": Case(
        lambda d: ["simulate", "patu655_lift", "-o", str(d / "out"), "--motion",
                   str(written(d, "\n".join(header("lift.q [rad]", "lift.q [m]")(GOOD_LOG)), "log.csv"))],
        r"log\.csv: 'lift\.q' "),
    "negative tolerance": option("--tolerance", "-1", place="identify: .*'--tolerance'"),
    "tolerance not a number": option("--tolerance", "nan", place="--tolerance"),
    "ridge not a number": option("--method", "ridge", "--ridge", "nan", place="--ridge"),
    "holdout of everything": option("--holdout", "1", place="identify: .*'--holdout'"),
    "holdout not a number": option("--holdout", "nan", place="--holdout"),
    "output is a file": Case(_in_the_way, "out: "),
    "directory where the log goes": Case(_log_in_the_way, "out"),
    "negative duration": simulate("--duration", "-5", place="simulate: .*-5"),
    "duration not a number": simulate("--duration", "nan", place="simulate: .*nan"),
    "endless duration": simulate("--duration", "inf", place="simulate: .*inf"),
    "rate of zero": simulate("--rate", "0", place="simulate: "),
    "more samples than memory": simulate("--duration", "1e9", place="simulate: .*samples"),
    "unknown truth": simulate("--truth", "maybe", place="--truth: 'maybe'"),
    "motion beyond the limits": Case(
        lambda d: ["simulate", "patu655_lift", "-o", str(d / "out"),
                   "--motion", str(written(d, "\n".join(cell(7, 1, "3")(GOOD_LOG)), "log.csv"))],
        r"log\.csv: lift\.q .*sample 7"),
    "unknown set of a bundled machine": Case(lambda d: ["show", "cat215b", "--set", "magic"], "cat215b: .*'magic'"),
}
CASES = FILES | {f"machine: {name}": case for name, case in MACHINES.items()} | LOGS | OPTIONS
