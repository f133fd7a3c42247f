"""Generated C as a shared library that Python calls, and the machines that the tests of it need.

The members of a generated struct are arrays of one type, so that a numpy record of the same members has its layout;
an array of N records is N structs.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from unittest import mock

import casadi as ca
import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "oracles"))

import subjects

from hydroopt.codegen import folder
from hydroopt.codegen.folder import STATUSES, Code
from hydroopt.codegen.parameter_source import Origin
from hydroopt.machine.machine import Machine
from hydroopt.model.closed_chain import KinematicModel

SUBJECTS = ("cat215b", "cat215b folded", "patu655_lift", "kr300", "panda_mukca", "spatial")

Array = np.ndarray
Values = Mapping[str, Array]

OK, OUT_OF_STROKE, NULL_POINTER, NOT_FINITE, OUT_OF_RANGE, OPEN_TRIANGLE, DEAD_POINT, NO_GAS_VOLUME, NO_SUPPLY = (
    list(STATUSES).index(name) for name in ("OK", "OUT_OF_STROKE", "NULL_POINTER", "NOT_FINITE", "OUT_OF_RANGE",
                                            "OPEN_TRIANGLE", "DEAD_POINT", "NO_GAS_VOLUME", "NO_SUPPLY"))
ORIGIN = Origin("a test", "0" * 64)
CONSTANTS = 1 << 20
"""Bytes that `prepare` may fill: more than any machine here needs."""

_SIGMAS = {"column": ("a", "alpha", "beta", "theta", "d"), "bracket": ("a", "alpha", "theta"),
           "boom": ("a", "alpha", "beta", "d"), "slide": ("theta", "d", "alpha", "beta"),
           "arm": ("a", "alpha", "theta", "compliance"), "probe": ("a", "alpha", "beta"),
           "mast": ("a", "d", "alpha")}

_STROKES = {"boom_cylinder": (1.1, 0.4), "slide_cylinder": (1.9, 0.6), "arm_cylinder": (1.55, 0.85)}

SPATIAL = subjects.MADE_UP | {
    "name": "spatial",
    "cylinders": [{**cylinder, "dead_length": _STROKES[cylinder["name"]][0], "stroke": _STROKES[cylinder["name"]][1]}
                  for cylinder in subjects.MADE_UP["cylinders"]],
    "links": [link if link["name"] != "arm" else {**link, "joint": {**link["joint"], "compliance": 2e-5}}
              for link in subjects.MADE_UP["links"]],
    "calibrator": {"parent": "arm", "tip": (0.1, -0.2, 0.3), "links": [
        {"name": "wrist", "parent": "arm", "joint": {"type": "revolute", "alpha": 1.2, "d": 0.3,
                                                     "lower": -2.0, "upper": 2.0}},
        {"name": "sleeve", "parent": "wrist", "joint": {"type": "locked", "theta": 0.4, "a": 0.2}},
        {"name": "probe", "parent": "sleeve", "body": subjects.BODY,
         "joint": {"type": "revolute", "a": 0.4, "alpha": -0.3, "beta": 0.2, "lower": -1.5, "upper": 1.5}}]},
    "notes": {f"{link}.joint.{key}": {"sigma": 0.01 if key in ("a", "d") else 1e-5 if key == "compliance" else 0.02}
              for link, keys in _SIGMAS.items() for key in keys}
    | {f"{name}_cylinder.{end}.pin": {"sigma": 0.01} for name in ("boom", "slide", "arm") for end in ("barrel", "rod")}
    | {"boom_cylinder.dead_length": {"sigma": 0.01}, "calibrator.tip": {"sigma": 0.02}}}
"""The made-up machine of the oracles with a calibrator, a joint that gives way, and a geometry that is to be found."""


def machine(name: str) -> Machine:
    """A bundled machine, or the made-up one with a parametric geometry."""
    return Machine.model_validate(SPATIAL) if name == "spatial" else subjects.machine(name)


def code(described: Machine, **options: object) -> Code:
    """The generator for a machine; its README does not tell sizes, which would take a compiler seconds."""
    return Code(described, ORIGIN, **options)  # type: ignore[arg-type]


@cache
def subject(name: str, real: str, *routines: str) -> Code:
    """The generator for one of `SUBJECTS`, for ``double`` or ``float``; all routines if none is named."""
    described, _, folded = name.partition(" ")
    return code(machine(described), single=real == "float", fold_geometry=bool(folded), routines=routines)


def files(made: Code) -> dict[str, str]:
    """All files but for the sizes in the README."""
    with mock.patch.object(folder, "sizes", return_value=({}, "Not measured.")):
        return made.files()


def write(texts: Mapping[str, str], directory: Path) -> Path:
    """The files of a folder in an empty directory."""
    directory.mkdir(parents=True)
    for name, text in texts.items():
        (directory / name).write_text(text, encoding="utf-8")
    return directory


def sources(directory: Path) -> list[str]:
    """C files of a folder without the self-test."""
    return sorted(file.name for file in directory.glob("*.c") if not file.name.endswith("_selftest.c"))


def run(command: Sequence[str | Path], directory: Path,
        environment: Mapping[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """A command with its output, however it ends; some of its environment may be set."""
    return subprocess.run([str(word) for word in command], cwd=directory, capture_output=True, text=True,
                          check=False, timeout=300, env=os.environ | dict(environment or {}))


def changed(model: KinematicModel, values: Array) -> Machine:
    """A machine with other numbers in its geometry: those of `KinematicModel.parameters`."""
    described = model.machine
    for name, value in zip(model.parameters.names, values.tolist(), strict=True):
        path, axis = model.paths[name]
        owner, *keys = path.split(".")
        described = _replaced(described, owner, keys, axis, value)
    return described


def _replaced(described: Machine, owner: str, keys: list[str], axis: int | None, value: float) -> Machine:
    if owner == "calibrator":
        return described.model_copy(update={"calibrator": _set(described.calibrator, keys, axis, value)})
    for kind in ("links", "cylinders"):
        parts = getattr(described, kind)
        if any(part.name == owner for part in parts):
            return described.model_copy(update={kind: tuple(
                _set(part, keys, axis, value) if part.name == owner else part for part in parts)})
    assert described.calibrator is not None
    links = tuple(_set(link, keys, axis, value) if link.name == owner else link for link in described.calibrator.links)
    return described.model_copy(update={"calibrator": described.calibrator.model_copy(update={"links": links})})


def _set(part, keys, axis, value):
    key, *rest = keys
    if rest:
        return part.model_copy(update={key: _set(getattr(part, key), rest, axis, value)})
    if axis is not None:
        vector = list(getattr(part, key))
        vector[axis] = value
        value = tuple(vector)
    return part.model_copy(update={key: value})


def held(array: Array) -> Array:
    """Numbers rounded so that single precision can hold them."""
    return np.asarray(array).astype(np.float32).astype(float)


def over(function: ca.Function, *columns: Array) -> list[Array]:
    """Outputs (N, rows, columns) at N states (N, k), or values (k,) that are the same for all, by CasADi itself."""
    count = max(len(column) for column in columns if column.ndim == 2)
    given = [ca.DM(column.T) if column.ndim == 2 else ca.repmat(ca.DM(column), 1, count) for column in columns]
    return [np.array(out).reshape(out.shape[0], count, out.shape[1] // count).transpose(1, 0, 2)
            for out in function.map(count).call(given)]


class Library:
    """A generated folder, compiled by ``cc -std=c99 -shared -fPIC``, with numpy arrays in place of its structs."""

    def __init__(self, made: Code, directory: Path, *flags: str) -> None:
        self.code, self.interface = made, made.interface
        self.real = np.dtype(np.float32 if made.single else np.float64)
        if not directory.exists():
            write(files(made), directory)
        library = f"lib{''.join(flags)}.so"
        done = run(["cc", "-std=c99", "-shared", "-fPIC", *flags, "-o", library, *sources(directory), "-lm"], directory)
        assert done.returncode == 0, done.stderr
        self._c = ctypes.CDLL(str(directory / library))

    def record(self, struct: str) -> np.dtype:
        """The numpy type of a struct."""
        return np.dtype([(field.name, self.real, self.interface.size(field))
                         for field in self.interface.structs[struct].fields])

    def zeros(self, struct: str, count: int = 1) -> Array:
        """Structs full of zeros."""
        return np.zeros(count, self.record(struct))

    def filled(self, struct: str, values: Values, count: int) -> Array:
        """Structs with some of their members given, each (count, ...) or the same for all."""
        made = self.zeros(struct, count)
        for field in self.interface.structs[struct].fields:
            if field.name in values:
                shape = self.interface.size(field)
                given = np.asarray(values[field.name])
                made[field.name] = given.reshape(count, *shape) if given.size > np.prod(shape) else given
        return made

    def routine(self, name: str, *arguments: Array | None) -> int:
        """The status of one call; each argument is an array whose first byte the pointer points to."""
        function = getattr(self._c, f"{self.code.name}_{name}")
        return int(function(*(None if each is None else ctypes.c_void_p(each.ctypes.data) for each in arguments)))

    def prepare(self, values: Values | None = None) -> Array:
        """The constants for the nominal values of the parameters, some of them replaced."""
        params = self.filled("params", {**self.interface.values, **(values or {})}, 1)
        constants = np.zeros(CONSTANTS, np.uint8)
        assert self.routine("prepare", params, constants) == OK
        return constants

    def call(self, name: str, constants: Array, values: Values, count: int) -> tuple[Array, Array]:
        """Statuses (count,) and results (count,) of a routine for `count` inputs."""
        routine = self.interface.routines[name]
        given, results = self.filled(routine.takes, values, count), self.zeros(routine.gives, count)
        function = getattr(self._c, f"{self.code.name}_{name}")
        at = ctypes.c_void_p(constants.ctypes.data)
        status = [function(at, ctypes.c_void_p(given.ctypes.data + k * given.itemsize),
                           ctypes.c_void_p(results.ctypes.data + k * results.itemsize)) for k in range(count)]
        return np.array(status), results

    def load(self, prior: Array, forgetting: float = 1.0) -> Array:
        """A load of which nothing is known but its prior (10,)."""
        load = self.zeros("load")
        assert self.routine("payload_start", np.ascontiguousarray(prior, self.real), load) == OK
        load["forgetting"] = forgetting
        return load

    def update(self, constants: Array, values: Values, load: Array, count: int) -> Array:
        """Statuses (count,) of as many updates of a load."""
        given = self.filled("load_sample", values, count)
        function = getattr(self._c, f"{self.code.name}_payload_update")
        places = ctypes.c_void_p(constants.ctypes.data), ctypes.c_void_p(load.ctypes.data)
        return np.array([function(places[0], ctypes.c_void_p(given.ctypes.data + k * given.itemsize), places[1])
                         for k in range(count)])
