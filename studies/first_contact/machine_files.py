"""Machine files whose tables hold values of other types, other tables' keys, huge numbers or nothing.

Bundled machines, the machine files of the guides, files that are based on a bundled machine, and robot files with their
sidecars are spoilt by a seeded generator: in chosen and other parameter sets, oil links, linkages, what is based on
another file. Each is read as `load_machine` reads it, geometry and priors checked; it is a machine, or is refused in
one sentence. Whatever else happens is a traceback, and what takes longer than ten seconds hangs.
"""

from __future__ import annotations

import copy
import os
import random
import signal
import sys
import tempfile
import time
import tomllib
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import tomli_w

from hydroopt.errors import LONGEST, HydrooptError, MachineError
from hydroopt.machine.bundled_files import bundled_files
from hydroopt.machine.file_tables import build_machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.machine.robot_formats.writing import robot_files
from hydroopt.support.input_file import refuse_absurd

COUNT = int(os.environ.get("SPOILT_MACHINE_FILES", "20000"))
HANGS = 10.0
"""Seconds of computing time after which a file counts as one that hangs."""
SLOW = {"level_keeping_lift", "stewart_platform", "backhoe", "scissor_lift", "mini_excavator", "knuckle_boom_crane",
        "cat215b_bucket", "excavator_bucket", "survey", "measure_up", "excavator_imu",
        "cat215b_link4"}
"""Machines whose loops or chains take a second to check: chosen a tenth as often as others."""
BODY = """com = ["1 m", "0 m", "0 m"]
inertia_com = ["1 kg*m^2", "0 kg*m^2", "0 kg*m^2", "9 kg*m^2", "0 kg*m^2", "9 kg*m^2"]
"""
OWN = {"based on": 'based_on = "kr300"\nname = "own"\nparameter_set = "x"\n[[links]]\nname = "axis6"\n'
                   'joint = { theta = { value = "1 deg", sigma = "0.1 deg" } }\n[[drives]]\nname = "axis1_drive"\n',
       "small": f"""name = "small"
total_masses = [{{ name = "both", bodies = ["arm", "jack.rod"], value = {{ value = "150 kg", sigma = "2 kg" }} }}]
identical = [{{ name = "like", bodies = ["arm", "jack.rod"] }}]
faults = {{ delay = "10 ms", gain = "2 %", tilt = "1 deg" }}
tracker = {{ position = ["3 m", "0 m", "0 m"], orientation = ["0 deg", "0 deg", "0 deg"] }}
[[springs]]
name = "coil"
barrel = {{ link = "base", pin = ["0.1 m", "-0.4 m", "0 m"] }}
rod = {{ link = "arm", pin = ["0.5 m", "0 m", "0 m"] }}
stiffness = "100 N/m"
reference_length = "0.4 m"
[[links]]
name = "arm"
joint = {{ type = "revolute", lower = "0 deg", upper = "60 deg", a = "2 m", friction = {{ coulomb = "1 N*m" }} }}
[links.body]
m = "120 kg"
symmetric = "xy"
{BODY}
[[cylinders]]
name = "jack"
bore = "100 mm"
rod_diameter = "56 mm"
dead_length = "0.8 m"
stroke = "1.2 m"
barrel = {{ link = "base", pin = ["0.2 m", "-0.9 m", "0 m"] }}
[cylinders.rod]
link = "arm"
pin = ["0.8 m", "0 m", "0 m"]
[cylinders.rod.body]
m = "120 kg"
{BODY}
[calibrator]
parent = "arm"
tip = ["0.1 m", "0 m", "0 m"]
links = [{{ name = "probe", joint = {{ type = "revolute", a = "0.2 m", lower = "-9 deg", upper = "9 deg" }} }}]
[parameter_sets.light.arm]
m = "80 kg"
{BODY}"""}
"""Files with the tables that no bundled machine has."""
VALUES: tuple[Any, ...] = (
    True, False, 0, -1, 3, 2**62, 2**64, 10**309, 0.5, 1e308, 1e-320, float("nan"), float("inf"), "", " ", "x", "1 m",
    "2 kg", "3 deg", "nan m", "1e400 m", "inf", "true", "base", "arm", "x" * 5000, "\x1b[2J", "m", "-5 %", "é",
    [], {}, [[]], [{}], ["1 m"], ["1 m", "2 m", "3 m"], [1, 2, 3], {"a": 1}, {"value": 1}, {"value": {}}, {"value": []},
    {"value": "1 m", "sigma": []}, {"name": "x"}, {"name": []}, {"name": {"value": 1}, "value": 2}, {"sigma": "1 m"},
    {"value": "1 m", "lower": {}}, {"value": ["1 m"], "sigma": "nan m"}, {"": ""}, {"value": {"value": "1 m"}})


@cache
def sources() -> dict[str, dict[str, Any]]:
    """The tables of good files by name."""
    guides = Path(__file__).parents[2] / "docs" / "how-to"
    files = bundled_files() | {path.stem: path for path in sorted(guides.glob("*.toml"))}
    return {name: tomllib.loads(path.read_text("utf-8")) for name, path in files.items()} | {
        name: tomllib.loads(text) for name, text in OWN.items()}


@cache
def weights() -> list[float]:
    """How often each of `sources` is chosen."""
    return [0.1 if name in SLOW else 3.0 if name in OWN else 1.0
            for name, tables in sources().items()]


@cache
def robots() -> dict[str, tuple[str, dict[str, Any]]]:
    """Robot files by name, each with the tables of its sidecar."""
    found = {}
    for name in ("cat215b.urdf", "kr300.xml"):
        files = robot_files(load_machine(name.partition(".")[0]), name).files
        found[name] = (files[name], tomllib.loads(files[f"{name.partition('.')[0]}.sidecar.toml"]))
    return found


def nodes(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Each node within a tree: what holds it, and its key there."""
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
        yield tree, key
        if isinstance(value, dict | list):
            yield from nodes(value)


def spoilt(rng: random.Random, good: dict[str, Any]) -> dict[str, Any]:
    """The tables with one to three faults."""
    tree = copy.deepcopy(good)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        every = list(nodes(tree))
        if not every:
            break
        holder, key = rng.choice(every)
        rng.choice(FAULTS)(rng, holder, key, rng.choice(every))
    return tree


def _another(rng: random.Random, holder: Any, key: Any, other: tuple[Any, Any]) -> None:
    holder[key] = copy.deepcopy(rng.choice(VALUES))


def _copied(rng: random.Random, holder: Any, key: Any, other: tuple[Any, Any]) -> None:
    holder[key] = copy.deepcopy(other[0][other[1]])


def _deleted(rng: random.Random, holder: Any, key: Any, other: tuple[Any, Any]) -> None:
    del holder[key]


def _key(rng: random.Random, holder: Any, key: Any, other: tuple[Any, Any]) -> None:
    name = other[1] if isinstance(other[1], str) else rng.choice(("value", "name", "based_on", "notes", "x", ""))
    if isinstance(holder, dict):
        holder[name] = copy.deepcopy(other[0][other[1]]) if rng.random() < 0.5 else copy.deepcopy(rng.choice(VALUES))
    else:
        holder.insert(rng.randrange(len(holder) + 1), copy.deepcopy(holder[key]))


def _length(rng: random.Random, holder: Any, key: Any, other: tuple[Any, Any]) -> None:
    value = holder[key]
    if isinstance(value, list):
        holder[key] = value[:-1] if rng.random() < 0.5 else [*value, *copy.deepcopy(value[-1:])]
    else:
        holder[key] = [value] * rng.choice((0, 1, 3))


def _deep(rng: random.Random, holder: Any, key: Any, other: tuple[Any, Any]) -> None:
    for _ in range(rng.choice((1, 2, 29, 200))):
        holder[key] = [holder[key]] if rng.random() < 0.3 else {
            rng.choice(("value", "name", "links", "joint", "x")): holder[key]}


def _number(rng: random.Random, holder: Any, key: Any, other: tuple[Any, Any]) -> None:
    stated = holder[key].get("value") if isinstance(holder[key], dict) else holder[key]
    number, _, unit = str(stated).partition(" ")
    new = rng.choice(("0", "-1", "0.1", "1", "2", "90", "1e-300", "1e5", "1e9", "1e15", "1e308", "nan", "--1", "٣"))
    other_unit = rng.choice(("m", "deg", "kg", "bar", "m^9^9", "%", "N*m", "furlong"))
    holder[key] = f"{number} {other_unit}" if rng.random() < 0.2 else f"{new} {unit}"


def _noted(rng: random.Random, holder: Any, key: Any, other: tuple[Any, Any]) -> None:
    holder[key] = {"value": holder[key], rng.choice(("sigma", "lower", "upper", "source")):
                   copy.deepcopy(rng.choice((*VALUES, holder[key])))}


FAULTS: tuple[Callable[[random.Random, Any, Any, tuple[Any, Any]], None], ...] = (
    _another, _another, _another, _copied, _copied, _deleted, _key, _length, _deep, _number, _number, _number, _number,
    _noted)


def read(seed: int, folder: Path) -> str:
    """How a spoilt file ended: "read", or the sentence of its refusal; what is neither is raised."""
    rng = random.Random(f"machine file {seed}")
    try:
        if rng.random() < 0.03:
            name = rng.choice(list(robots()))
            text, tables = robots()[name]
            (folder / name).write_text(text, "utf-8")
            (folder / name).with_suffix(".sidecar.toml").write_text(tomli_w.dumps(spoilt(rng, tables)), "utf-8")
            load_machine(folder / name)
        else:
            name = rng.choices(list(sources()), weights())[0]
            tables = spoilt(rng, sources()[name])
            refuse_absurd(tables, MachineError, name)  # as the reader of TOML does
            chosen = rng.choice(list(sets)) if isinstance(sets := tables.get("parameter_sets"), dict) and sets else None
            build_machine(tables, name, chosen if rng.random() < 0.3 else None)
    except HydrooptError as error:
        sentence = str(error)
        if len(sentence) > LONGEST or not sentence.isprintable() or "; " not in sentence:
            raise AssertionError(f"is not a sentence: {sentence[:200]!r}") from None
        return sentence
    return "read"


def _expired(number: int, frame: object) -> None:
    raise TimeoutError


def run(count: int = COUNT, first: int = 0) -> dict[str, float]:
    """Spoil and read so many files, each with its own seed from the first one on; tracebacks are printed."""
    found: Counter[str] = Counter()
    signal.signal(signal.SIGVTALRM, _expired)
    with tempfile.TemporaryDirectory() as name:
        for seed in range(first, first + count):
            signal.setitimer(signal.ITIMER_VIRTUAL, HANGS)
            try:
                found["read" if read(seed, Path(name)) == "read" else "refused"] += 1
            except TimeoutError:
                found["hangs"] += 1
                print(f"seed {seed} hangs", file=sys.stderr)
            except (Exception, RecursionError):
                found["tracebacks"] += 1
                print(f"seed {seed}: {traceback.format_exc(limit=-3)}", file=sys.stderr)
            finally:
                signal.setitimer(signal.ITIMER_VIRTUAL, 0)
    return {"machine_files_tried": float(count)} | {
        f"machine_files_{word}": float(found[word]) for word in ("read", "refused", "tracebacks", "hangs")}


if __name__ == "__main__":
    start = time.monotonic()
    print(run(*map(int, sys.argv[1:])), f"{time.monotonic() - start:.0f} s")
