"""Functional Mock-up Units (FMI 3.0) of a machine: its plant for simulation, and its inverse dynamics."""

from __future__ import annotations

import hashlib
import io
import platform
import subprocess
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import casadi as ca

from hydroopt.codegen.routines import Interface
from hydroopt.kernels import integrator
from hydroopt.kernels.compiler import compiler, notice, reason
from hydroopt.kernels.expression_graph import program
from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.machine import Machine
from hydroopt.model.plant import Plant, Steady
from hydroopt.simulation.drive_valves import ACCURACY
from hydroopt.spatial.inertia import Array
from hydroopt.units import base

BASE_UNITS = {"kilogram": "kg", "meter": "m", "second": "s", "ampere": "A", "kelvin": "K", "radian": "rad"}
"""What FMI calls base units."""
SYSTEMS = {"Linux": ("linux", "so"), "Darwin": ("darwin", "dylib"), "Windows": ("windows", "dll")}
PROCESSORS = {"x86_64": "x86_64", "AMD64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}
"""What FMI calls platforms."""
FLAGS = ("-std=c99", "-O2", "-shared", "-fPIC", "-fvisibility=hidden")


class Variable(NamedTuple):
    """A variable of type Float64; `start` is None where it is computed."""

    name: str
    unit: str
    text: str
    causality: str
    variability: str = "continuous"
    start: float | None = None
    range: tuple[float, float] | None = None
    nominal: float | None = None
    derivative_of: str = ""


class Fmu(NamedTuple):
    """What an FMU says and computes.

    Attributes:
        name: of the model and its files.
        text: what it is.
        variables: in the order of their value references, which begin at 1; time has 0.
        places: in C, the name of each group of variables with the place of its first.
        states: names of the continuous states.
        template: what computes, in the folder of templates.
        context: what that template needs.
        sources: further files by name.
    """

    name: str
    text: str
    variables: tuple[Variable, ...]
    places: Mapping[str, int]
    states: tuple[str, ...]
    template: str
    context: Mapping[str, object]
    sources: Mapping[str, str] = {}

    @property
    def parameters(self) -> list[str]:
        """Groups of parameters."""
        return [name.lower() for name, place in self.places.items()
                if self.variables[place - 1].causality == "parameter"]

    @property
    def reference(self) -> dict[str, int]:
        """Value references by name."""
        return {each.name: k for k, each in enumerate(self.variables, 1)}

    @property
    def units(self) -> dict[str, tuple[float, dict[str, int]]]:
        """Every unit with its factor and powers of base units."""
        found = {}
        for unit in dict.fromkeys(("s", *(each.unit for each in self.variables))):
            number, powers = base(unit)
            found[unit] = number, {BASE_UNITS[name]: int(power) for name, power in powers.items()}
        return found


def at_rest(made: Plant, psi: Array) -> Steady:
    """States and commands of a machine with dynamic parameters psi (p,) that rests in the middle of all ranges.

    Raises:
        ProblemError: it cannot rest there, or the file states no supply pressure.
    """
    middle = made.machine.ranges.mean(axis=1)
    return made.steady(middle, 0 * middle, psi, made.parameters.nominal)


def _ranges(machine: Machine) -> dict[str, tuple[float, float]]:
    return {joint: machine.link(joint).joint.range for joint in machine.joints}


def plant(made: Plant, name: str, psi: Array) -> Fmu:
    """A machine with dynamic parameters psi (p,), driven by its valves."""
    machine, known, theta = made.machine, made.model.parameters, made.parameters.nominal
    ranges, rest = _ranges(machine), at_rest(made, psi)
    names = [each.actuator.name for each in made.actuators]
    units, meant = _state_units(made), {
        "q": "position of the joint", "qd": "its speed", "spool": "place of the spool, -1 to 1", "spool_rate":
        "its rate"}
    groups = {"PSI": _parameters(known.names, known.units, psi),
              "THETA": _parameters(made.parameters.names, made.parameters.units, theta)}
    groups["INPUT"] = [Variable(
        channel, machine.channel_units[channel], f"command at the valve, {each.valve.delay:g} s after the controller's",
        "input", start=float(u)) for channel, each, u in zip(made.inputs, made.actuators, rest.u, strict=True)]
    groups["INPUT"] += [Variable(f"pump.{key}", "Pa", text, "input", start=float(value)) for key, text, value in zip(
        ("pressure", "tank_pressure"), ("pressure that the supply is set to", "pressure of the tank"), made.supply,
        strict=True)]
    groups["STATE"] = [Variable(
        each, unit, meant.get(each.rpartition(".")[2], "pressure"), "output", start=float(value), nominal=float(scale),
        range=ranges.get(each.removesuffix(".q"))) for each, unit, value, scale in zip(
            made.states, units, rest.x, made.scale, strict=True)]
    groups["DERIVATIVE"] = [Variable(f"der({each})", _rate(unit), f"rate of {each}", "local", derivative_of=each)
                            for each, unit in zip(made.states, units, strict=True)]
    outputs, groups["OUTPUT"] = [], []
    for key in ("length", "speed", "force", "flow"):
        for k, (each, owner) in enumerate(zip(made.actuators, names, strict=True)):
            lengthwise = isinstance(each.actuator, Cylinder)
            if key == "length" and not lengthwise:
                continue
            unit, text = {"length": ("m", "distance between the pins"),
                          "speed": ("m/s" if lengthwise else "rad/s", "speed of the actuator"),
                          "force": ("N" if lengthwise else "N*m", "force of the oil, without the actuator's friction"),
                          "flow": ("m^3/s", "flow from the supply")}[key]
            groups["OUTPUT"].append(Variable(f"{owner}.{key}", unit, text, "output"))
            outputs.append((key, k))
    given = [ca.SX.sym(each, size) for each, size in zip(("x", "u", "supply", "psi", "theta"), (
        len(made.states), len(names), 2, len(known), len(theta)), strict=True)]
    computed = dict(zip(made.outputs.name_out(), made.outputs(*given), strict=True))
    function = ca.Function("plant", given, [made.rates(*given), ca.densify(ca.vertcat(
        *(computed[key][k] for key, k in outputs)))], ["x", "u", "supply", "psi", "theta"], ["rates", "outputs"])
    compiled = program(function)
    return Fmu(f"{name}_plant", f"{machine.name} driven by its valves", *_placed(groups), made.states, "plant.c", {
        "equations": integrator.source(compiled, parameters=2), "typical": _row(made.scale), "ranges": ranges,
        "constants": compiled.hoisted(["psi", "theta"], "c")[0].outputs[0].rows})


def inverse_dynamics(interface: Interface, name: str, sources: Mapping[str, str]) -> Fmu:
    """Forces of a motion by the generated C.

    Args:
        interface: of the machine.
        name: prefix of the C.
        sources: its files by name, in double precision.
    """
    machine, routine = interface.machine, interface.routines["inverse_dynamics"]
    ranges = _ranges(machine)
    groups: dict[str, list[Variable]] = {}
    for key in ("geometry", "psi"):
        if key in interface.values:
            kind = interface.kinds[key]
            groups[key.upper()] = _parameters(kind.names, kind.units, interface.values[key])
    for key, text in (("q", "position"), ("qd", "speed"), ("qdd", "acceleration")):
        groups[key.upper()] = [Variable(
            f"{joint}.{key}", machine.channel_units[f"{joint}.{key}"], text, "input",
            start=sum(ranges[joint]) / 2 if key == "q" else 0.0, range=ranges[joint] if key == "q" else None)
            for joint in machine.joints]
    for field in interface.structs[routine.gives].fields:
        counted = str(field.shape[0])
        groups[field.name.upper()] = [
            Variable(f"{each}.{field.name}", unit, field.text, "output") for each, unit in zip(
                interface.kinds[counted].names, interface.force_units(counted), strict=True)]
    return Fmu(f"{name}_inverse_dynamics", f"forces of the actuators of {machine.name} in a motion",
               *_placed(groups), (), "inverse_dynamics.c", {"routine": routine}, sources)


def archive(made: Fmu, render: Callable[..., str]) -> bytes:
    """The FMU with its sources, and with a binary for this platform where there is a compiler.

    Args:
        made: the FMU.
        render: (template, values...) → text.
    """
    token = "{" + hashlib.sha256(repr(made).encode()).hexdigest()[:32] + "}"
    sources = dict(made.sources)
    compiled = ["fmi3.c", *(name for name in sources if name.endswith(".c"))]
    given = {"fmu": made, "token": token, "tolerance": repr(ACCURACY), "places": made.places, **made.context}
    sources["fmi3.c"] = render(
        "fmu/fmi3.c", **given, start=_row((0.0, *(each.start or 0.0 for each in made.variables))),
        settable=", ".join(str(_settable(each)) for each in (None, *made.variables)))
    sources["buildDescription.xml"] = render("fmu/buildDescription.xml", fmu=made, compiled=compiled)
    files: dict[str, str | bytes] = {
        "documentation/licenses/license.txt": render("fmu/license.txt", fmu=made),
        "modelDescription.xml": render("fmu/modelDescription.xml", **given, units=made.units, reference=made.reference)}
    files |= {f"sources/{name}": text for name, text in sources.items()}
    system, suffix = SYSTEMS.get(platform.system(), ("", ""))
    binary = _built(sources, compiled)
    if system and binary:
        processor = PROCESSORS.get(platform.machine(), platform.machine())
        files[f"binaries/{processor}-{system}/{made.name}.{suffix}"] = binary
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archived:
        for k, (name, content) in enumerate(files.items()):
            entry = zipfile.ZipInfo(name)  # dated 1980, so that the bytes depend on the content alone
            entry.compress_type = zipfile.ZIP_DEFLATED if k else zipfile.ZIP_STORED  # the mark is to be read
            archived.writestr(entry, content)
    return packed.getvalue()


def _settable(each: Variable | None) -> int:
    """What setting a variable makes necessary: 0 it cannot be set, 1 to prepare, 2 to compute."""
    if each is None or each.start is None:
        return 0
    return 1 if each.causality == "parameter" else 2


def _built(sources: Mapping[str, str], compiled: Sequence[str]) -> bytes | None:
    """The shared library; None, with a notice, where there is no compiler or it fails."""
    found = compiler()
    if found is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        for name, text in sources.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        try:
            subprocess.run([*found.command, *FLAGS, *found.options, "-o", "built", *compiled, "-lm"], cwd=folder,
                           check=True, capture_output=True)
        except (OSError, subprocess.SubprocessError) as error:
            notice(f"the FMU cannot be compiled ({reason(error)})", "it contains its sources alone")
            return None
        return (Path(folder) / "built").read_bytes()


def _state_units(made: Plant) -> list[str]:
    """Units of the states, those of channels where they have one."""
    own = {"spool": "1", "spool_rate": "1/s"}
    channels = made.machine.channel_units
    return [own.get(name.rpartition(".")[2]) or channels[name] for name in made.states]


def _rate(unit: str) -> str:
    number, _, below = unit.partition("/")
    return f"{number}/s" if not below else f"{number}/s^2" if below == "s" else f"{number}/({below}*s)"


def _parameters(names: Sequence[str], units: Sequence[str], values: Array) -> list[Variable]:
    return [Variable(name, unit, "parameter", "parameter", "tunable", float(value))
            for name, unit, value in zip(names, units, values, strict=True)]


def _placed(groups: Mapping[str, Sequence[Variable]]) -> tuple[tuple[Variable, ...], dict[str, int]]:
    """All variables in a row, and where each group begins."""
    places, row = {}, list[Variable]()
    for name, group in groups.items():
        places[name] = len(row) + 1
        row += group
    return tuple(row), places


def _row(values: Iterable[float]) -> str:
    return ", ".join(repr(float(value)) for value in values)
