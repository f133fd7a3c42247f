"""Robot files as they are found: without inertials, with some of them, with placeholders, without friction."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from typer.testing import CliRunner

import hydroopt as ho
from hydroopt.cli import app
from hydroopt.errors import HydrooptError
from hydroopt.machine.machine_file import dump_machine
from hydroopt.machine.robot_formats.writing import robot_files

CRANE = """
name = "crane"
[[links]]
name = "slew"
joint = {{ type = "revolute", d = "1.2 m", a = "{0:.3f} m", alpha = "90 deg", lower = "-1 rad", upper = "1 rad" }}
body = {{ m = "{9:.1f} kg", com = ["0.1 m", "-0.2 m", "0.02 m"], inertia_com = ["{4} kg*m^2", "0 kg*m^2",
          "0 kg*m^2", "{5} kg*m^2", "0 kg*m^2", "{6} kg*m^2"] }}
[[links]]
name = "lift"
joint = {{ type = "revolute", a = "{1:.3f} m", lower = "-0.2 rad", upper = "0.9 rad" }}
body = {{ m = "{7:.1f} kg", com = ["{2:.3f} m", "0.1 m", "0 m"], inertia_com = ["{4} kg*m^2", "0 kg*m^2",
          "0 kg*m^2", "{6} kg*m^2", "0 kg*m^2", "{5} kg*m^2"] }}
[[links]]
name = "reach"
joint = {{ type = "revolute", a = "{3:.3f} m", lower = "-2 rad", upper = "-0.4 rad" }}
body = {{ m = "{8:.1f} kg", com = ["0.4 m", "0.1 m", "0 m"], inertia_com = ["1 kg*m^2", "0 kg*m^2", "0 kg*m^2",
          "9 kg*m^2", "0 kg*m^2", "8 kg*m^2"] }}
[[drives]]
name = "slew_drive"
joint = "slew"
friction = {{ coulomb = "30 N*m", viscous = "90 N*m*s/rad" }}
[[drives]]
name = "lift_drive"
joint = "lift"
friction = {{ coulomb = "60 N*m", viscous = "70 N*m*s/rad" }}
[[drives]]
name = "reach_drive"
joint = "reach"
friction = {{ coulomb = "20 N*m", viscous = "50 N*m*s/rad" }}
"""
"""A crane of random sizes, of which robot files are made."""
Spoil = Callable[[ElementTree.Element], None]


class Case(NamedTuple):
    """A robot file.

    Attributes:
        name: of the file.
        text: of it.
        lacks: what it lacks: bodies, friction, both or neither.
        truth: the machine that it is of.
    """

    name: str
    text: str
    lacks: set[str]
    truth: ho.Machine


def _without(*tags: str, of: str = "*") -> Spoil:
    """Leave elements of these tags out, in the last element of a kind alone if it is given."""
    def spoil(root: ElementTree.Element) -> None:
        found = [(parent, child) for parent in root.iter() for child in parent if child.tag in tags]
        for parent, child in found[-1:] if of == "last" else found:
            parent.remove(child)

    return spoil


def _placeholders(mass: float | None = None, moments: tuple[float, float, float] | None = None) -> Spoil:
    """Other masses and principal moments of inertia of every body, as the format of the file states them."""
    def spoil(root: ElementTree.Element) -> None:
        values = ({} if mass is None else {"mass": mass}) | ({} if moments is None else dict(
            zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), (*moments, 0.0, 0.0, 0.0), strict=True)))
        for inertial in root.iter("inertial"):
            if "mass" in inertial.attrib:  # MJCF
                if mass is not None:
                    inertial.set("mass", str(mass))
                if moments is not None:
                    inertial.attrib.pop("fullinertia", None)
                    inertial.set("diaginertia", " ".join(map(str, moments)))
            for key, value in values.items():
                for part in (*inertial.findall("mass"), *inertial.findall("inertia")):
                    own = part.find(key)
                    if own is not None or (part.tag == key and part.text):  # SDF
                        (part if own is None else own).text = str(value)
                    elif key in part.attrib or part.tag == key:  # URDF
                        part.set("value" if part.tag == key else key, str(value))

    return spoil


def _frictionless(root: ElementTree.Element) -> None:
    _without("dynamics")(root)
    for joint in root.iter("joint"):
        for key in ("damping", "frictionloss"):  # MJCF
            joint.attrib.pop(key, None)


SPOILS: dict[str, tuple[Spoil, str]] = {
    "whole": (_without(), ""),
    "no_inertials": (_without("inertial"), "bodies"),
    "one_less": (_without("inertial", of="last"), "bodies"),
    "unit_masses": (_placeholders(1.0), "bodies"),
    "zero_masses": (_placeholders(0.0, (0.0, 0.0, 0.0)), "bodies"),
    "identity": (_placeholders(moments=(1.0, 1.0, 1.0)), "bodies"),
    "small_identity": (_placeholders(moments=(1e-3, 1e-3, 1e-3)), "bodies"),
    "light_identity": (_placeholders(0.03, (1.0, 1.0, 1.0)), "bodies"),
    "far_gyration": (_placeholders(moments=(9e5, 8e5, 7e5)), "bodies"),
    "no_friction": (_frictionless, "friction")}
"""What is done to a file, and what it lacks then."""
NEITHER = "states neither bodies nor friction"
ARM = "ur10"
"""A machine of which nobody states the friction."""
WORDS = {"bodies": ("Bodies are missing or placeholders", NEITHER), "friction": ("No friction is stated", NEITHER)}
"""What commands say of what a file lacks."""


def sensors(machine: ho.Machine) -> str:
    """Tables of sensors at all joints, which no robot file has."""
    return "".join(f'[[sensors]]\nchannels = {[f"{joint}.{key}" for joint in machine.joints]}\naccuracy = "{error}"\n'
                   for key, error in (("q", "0.05 deg"), ("tau", "10 N*m")))


def crane(seed: int) -> ho.Machine:
    """A crane of random sizes."""
    a, b, c, d, *rest = np.random.default_rng(seed).uniform(0.5, 1.0, 8)
    made = ho.read_machine(CRANE.format(0.4 * a, 3 * b, b, 2 * c, 20 * rest[0], 25 * rest[1], 30 * rest[1],
                                        200 * rest[2], 120 * rest[3], 300 * d))
    return ho.read_machine(dump_machine(made.model_copy(update={"name": f"crane{seed}"})) + sensors(made))


def cases(machine: ho.Machine, suffix: str) -> Iterator[Case]:
    """The robot file of a machine, spoilt in each way."""
    text = robot_files(machine, f"x{suffix}").files[f"x{suffix}"]
    for what, (spoil, lacks) in SPOILS.items():
        root = ElementTree.fromstring(text)
        spoil(root)
        known = {lacks} - {""} | ({"friction"} if machine.name == ARM else set())
        yield Case(f"{machine.name}_{what}{suffix}", ElementTree.tostring(root, encoding="unicode"), known, machine)


def found_robots() -> list[Path]:
    """The URDFs of the package example-robot-data, if it is installed."""
    try:
        return sorted(Path(str(file.locate())) for file in files("example-robot-data") or () if file.suffix == ".urdf")
    except PackageNotFoundError:
        return []


class Outcome(NamedTuple):
    """What a command made of a file: its output or its refusal, and whether it ended in a traceback."""

    said: str
    traceback: bool


def outcome(*arguments: str | Path) -> Outcome:
    """Of one command."""
    result = CliRunner().invoke(app, [str(each) for each in arguments])
    wrong = result.exception
    return Outcome(result.output + (str(wrong) if isinstance(wrong, HydrooptError) else ""),
                   wrong is not None and not isinstance(wrong, HydrooptError | SystemExit))


def outcomes(file: Path, truth: ho.Machine | None = None, log: Path | None = None, *,
             whole: bool = False) -> dict[str, Outcome]:
    """Of the commands that a newcomer gives: convert, show and, with a log, check; of the `whole` way identify and
    excite, too."""
    machine, out = file.with_suffix(".toml"), file.with_suffix("")
    done = {"convert": outcome("convert", file, machine)}
    if not machine.exists():  # refused
        return done
    if truth is not None:
        machine.write_text(machine.read_text() + sensors(truth))
    done["show"] = outcome("show", machine)
    done["frames"] = outcome("show", file, "--frames")
    if log is not None:
        done["check"] = outcome("check", machine, log, "-o", out / "check")
    if log is not None and whole:
        done["identify"] = outcome("identify", machine, log, "-o", out / "identify")
        done["excite"] = outcome("excite", machine, "--duration", "10", "--starts", "1", "--search-seconds", "1",
                                 "--processes", "1", "-o", out / "excite")
    return done


def recorded(machine: ho.Machine, folder: Path) -> Path:
    """A simulated log of a machine: angles and torques or forces of all joints."""
    model = ho.Model(machine)
    path = folder / f"{machine.name}.csv"
    log = ho.simulate(model, ho.random_trajectory(model, duration=20.0, rate=25.0, seed=1), seed=1)
    path.write_bytes(log.encoded())
    return path


def run() -> dict[str, float]:
    """A random crane and the arm UR10 as URDF, MJCF and SDF, whole and spoilt in nine ways, and the URDFs of the
    package example-robot-data if it is installed (69 in version 6.0), by convert and show; those two by check with a
    sound log of the whole machine, too, and the crane's URDFs by identify and excite.

    `robot_made` are files of which it is known what they lack; `robot_made_said` those of which show, check, identify
    and excite say this and no more; `robot_blamed_units` commands that call the sound log misread.
    """
    figures = dict.fromkeys(("robot_files", "robot_commands", "robot_tracebacks", "robot_blamed_units", "robot_made",
                             "robot_made_said"), 0.0)

    def count(done: dict[str, Outcome], lacks: set[str] | None) -> None:
        figures["robot_files"] += 1
        figures["robot_commands"] += len(done)
        figures["robot_tracebacks"] += sum(each.traceback for each in done.values())
        figures["robot_blamed_units"] += sum("Read with" in each.said for each in done.values())
        if lacks is not None:
            named = [{lack for lack, words in WORDS.items() if any(word in each.said for word in words)}
                     for command, each in done.items() if command not in ("convert", "frames")]
            figures["robot_made"] += 1
            figures["robot_made_said"] += bool(named) and all(each == lacks for each in named)

    with TemporaryDirectory() as folder:
        for machine in (crane(0), ho.load_machine(ARM)):
            log = recorded(machine, Path(folder))
            for suffix in (".urdf", ".xml", ".sdf"):
                for case in cases(machine, suffix):
                    file = Path(folder, case.name)
                    file.write_text(case.text)
                    count(outcomes(file, machine, log, whole=machine.name != ARM and suffix == ".urdf"), case.lacks)
        for found in found_robots():
            file = Path(folder, f"found_{found.name}")
            file.write_bytes(found.read_bytes())
            count(outcomes(file), None)
    return figures
