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

from hydroopt import synthetic
from hydroopt.description import load_machine
from hydroopt.model.build import Model

UR10E = (Path(__file__).parents[2] / "shared/data/ur10e_mamedov/dataset_ur10e/identification_data"
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


BODY = 'm = "688 kg"\n'
FILES = {
    "machine: not TOML": Case(lambda d: show(d, DIGGER + "pin = [1,\n"), r"digger\.toml: .*line \d+"),
    "machine: not TOML, value without quotes": Case(
        lambda d: show(d, edited(DIGGER, '"1.1 m"', "1.1 m")), r"digger\.toml: .*line 46"),
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
    "unknown key deep": machine('dead_length = "1.799 m"', 'dead_lenght = "1.799 m"', r"cylinders\[stick_cylinder\]\.dead_len"),
    "unknown key in a body": machine('com = ["2.3 m"', 'cog = ["2.3 m"', r"links\[boom\]\.body\.c"),
    "unknown key of a note": machine('sigma = "20 %"', 'std = "20 %"', r"links\[boom\]\.body\.m: .*std"),
    "table for a number": machine('gear = 307', 'gear = { ratio = 307 }', r"motors\[swing_motor\]\.gear: "),
    "missing torque": machine('torque_per_pressure = "0.089 N*m/psi"\n', "", r"motors\[swing_motor\]\.torque_per_pressure: "),
    # units and numbers
    "angle for a length": machine('a = "5.18 m"', 'a = "5.18 deg"', r"links\[boom\]\.joint\.a: 'deg'.*'m'"),
    "length for an angle": machine('lower = "35 deg"', 'lower = "35 mm"', r"links\[stick\]\.joint\.lower: 'mm'"),
    "number without unit": machine('a = "1.8 m"', "a = 1.8", r"links\[stick\]\.joint\.a: .*; .*1\.8 m"),
    "limit without unit": machine('upper = "145 deg"', "upper = 145", r"links\[stick\]\.joint\.upper: .*; .*rad"),
    "text for a number": machine('stroke = "1.1 m"', 'stroke = "about 1 m"', r"cylinders\[boom_cylinder\]\.stroke: 'about 1 m'"),
    "decimal comma": machine('stroke = "1.1 m"', 'stroke = "1,1 m"', r"cylinders\[boom_cylinder\]\.stroke: '1,1 m'"),
    "unknown unit": machine('"140 mm"', '"140 furlongz"', r"cylinders\[stick_cylinder\]\.bore: 'furlongz'"),
    "unit glued to its number": machine('"140 mm"', '"140mm"', r"cylinders\[stick_cylinder\]\.bore: '140mm'"),
    "orientation in metres": machine('["0 deg", "0 deg", "0 deg"]', '["0 m", "0 deg", "0 deg"]', r"orientation\[0\]: 'm'"),
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
    "unit wrong within a pin": machine('"-0.41298 m"', '"-0.41298 bar"', r"cylinders\[stick_cylinder\]\.rod\.pin\[1\]: 'bar'"),
    "gear of zero": machine("gear = 307", "gear = 0", r"motors\[swing_motor\]\.gear: "),
    "unknown kind of joint": machine('type = "locked"', 'type = "hinge"', r"links\[bucket\]\.joint\.type: .*revolute"),
    "polytropic exponent of 3": machine("polytropic = 1.3", "polytropic = 3", r"gas_cylinders\[balance\]\.polytropic: "),
    # geometry
    "open triangle": machine('"-0.58979 m", "-0.41298 m"', '"-0.1 m", "-0.1 m"', r".*'stick_cylinder'.* m"),
    "stroke too short": machine('"1.35 m"', '"0.9 m"', r".*'stick_cylinder' .*stick = .* deg"),
    "dead point in the range": machine('lower = "35 deg"', 'lower = "-30 deg"', r".*'stick_cylinder' .*stick = .* deg"),
    "limits exchanged": machine('lower = "35 deg"', 'lower = "150 deg"', r"links\[stick\]\.joint: "),
    "locked joint with limits": machine('{ type = "locked" }', '{ type = "locked", lower = "0 deg" }', r"links\[bucket\]\.joint: "),
    # structure
    "links in a circle": machine('parent = "boom"', 'parent = "bucket"', ".*'stick'.*'bucket'"),
    "no such parent": machine('parent = "boom"', 'parent = "broom"', ".*'stick'.*'broom'"),
    "two links of one name": machine('name = "bucket"', 'name = "stick"', ".*'stick'"),
    "cylinder named as a link": machine('name = "stick_cylinder"', 'name = "stick"', ".*'stick'"),
    "link named base": machine('name = "bucket"', 'name = "base"', ".*'base'"),
    "name with a blank": machine('name = "bucket"', 'name = "big bucket"', r"links\[.*\]\.name: .*'big bucket'"),
    "name with a dot": machine('name = "swing_motor"', 'name = "swing.motor"', r"motors\[.*\]\.name: .*'swing\.motor'"),
    "joint that nothing drives": machine('{ type = "locked" }', '{ type = "revolute", lower = "0 deg", upper = "1 deg" }', ".*'bucket'"),
    "two actuators on one joint": machine('joint = "swing"\n', 'joint = "boom"\n', ".*'(swing|boom)'"),
    "cylinder within one link": machine('link = "stick"', 'link = "boom"', ".*'stick_cylinder'"),
    "cylinder on no link": machine('link = "stick"', 'link = "dipper"', ".*'stick_cylinder'.*'dipper'"),
    "motor on no joint": machine('joint = "swing"\n', 'joint = "slew"\n', ".*'swing_motor'.*'slew'"),
    # what is known about numbers
    "sensor of no channel": machine('"boom.q"', '"bucket.q"', ".*'bucket.q'"),
    "sensor of unknown kind": machine('"boom.q", "stick.q"', '"boom.angle"', r"sensors\[0\].*'boom.angle'"),
    "two sensors of one channel": machine('"boom_cylinder.p_head", "boom_cylinder.p_rod"]\naccuracy = "25 psi"',
                                          '"boom.q"]\naccuracy = "1 deg"', ".*'boom.q'"),
    "accuracy in the wrong unit": machine('accuracy = "25 psi"', 'accuracy = "25 mm"', r"sensors\[1\].*accuracy: 'mm'"),
    "negative accuracy": machine('accuracy = "25 psi"', 'accuracy = "-25 psi"', r"sensors\[1\].*accuracy: "),
    "sigma of another kind": machine('sigma = "50 N"', 'sigma = "50 bar"', r".*stick_cylinder.*friction\.coulomb\.sigma: 'bar'"),
    "sigma of zero": machine('sigma = "50 N"', 'sigma = "0 N"', r".*stick_cylinder.*friction\.coulomb"),
    "negative sigma in percent": machine('sigma = "20 %"', 'sigma = "-20 %"', r".*boom.*body\.m"),
    "sigma without unit": machine('sigma = "50 N"', "sigma = 50", r".*stick_cylinder.*friction\.coulomb\.sigma: "),
    "sigma not a number": machine('sigma = "50 N"', 'sigma = "nan N"', r".*stick_cylinder.*friction\.coulomb"),
    "bounds exchanged": machine('sigma = "50 N"', 'lower = "60 N", upper = "50 N"', r".*stick_cylinder.*friction\.coulomb"),
    "value outside its bounds": machine('sigma = "50 N"', 'upper = "50 N"', r".*stick_cylinder.*friction\.coulomb"),
    "source not text": machine('source = "guess"', "source = 5", r".*boom.*body\.m"),
    "unit of value unknown": machine('"100 N", sigma', '"100 quux", sigma', r".*stick_cylinder.*friction\.coulomb.*'quux'"),
    "no such parameter set": machine('set = "guess"', 'set = "measured"', ".*'measured'; .*guess"),
    "set of an unknown part": machine("sets.guess.stick]", "sets.guess.dipper]", ".*'guess'.*'dipper'"),
    "set is a number": machine('[parameter_sets.guess.stick]\n' + BODY, '[parameter_sets.guess]\nstick = 5\n[other]\n',
                               ".*'guess'.*'stick'"),
    "set with a bad number": machine(BODY, 'm = "688 m"\n', r"links\[stick\]\.body\.m: 'm'"),
    "set without mass": machine(BODY, "", ".*stick"),
}


def good_log() -> list[str]:
    """Lines of a log of the bundled `patu655_lift` (lift.q, pressures, length), data row k on line k."""
    model = Model(load_machine("patu655_lift"))
    log = synthetic.simulate(model, synthetic.random_trajectory(model, duration=20, rate=20, seed=0))
    header = ["t [s]", *(f"{name} [{unit}]" for name, unit in log.units.items())]
    rows = zip(log.t, *log.channels.values(), strict=True)
    return [",".join(header), *(",".join(f"{x:.9g}" for x in row) for row in rows)]
