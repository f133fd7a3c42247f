"""The folder of C: everything that a controller's build needs, as texts."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from functools import cached_property
from importlib import metadata

import casadi as ca
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from hydroopt.codegen import golden
from hydroopt.codegen.names import Names, prefix
from hydroopt.codegen.origin import Origin
from hydroopt.codegen.routines import Field, Interface, Routine, Struct
from hydroopt.codegen.sizes import sizes
from hydroopt.inertia import Array
from hydroopt.machine import Machine
from hydroopt.model.ccode import Naming, literal, statements
from hydroopt.model.program import Program, program

LARGE = 1200
"""Lines of statements from which each routine gets a file of its own."""
STATUSES = {
    "OK": "the result is there",
    "NULL_POINTER": "an argument is NULL; nothing was written",
    "NOT_FINITE": "an input is not a number or infinite; nothing was written",
    "NOT_POSITIVE": "an input that must be positive is not; nothing was written",
    "OPEN_TRIANGLE": "pins of a cylinder coincide or cannot be that far apart; do not use the result",
    "DEAD_POINT": "a cylinder has no lever arm here; do not use the result",
    "OUT_OF_STROKE": "a cylinder is shorter or longer than it can be; the result holds for the triangle all the same"}


class Code:
    """C of some routines of a machine; the texts are the same for the same machine, choice and origin."""

    def __init__(self, machine: Machine, origin: Origin, *, routines: Sequence[str] = (), name: str | None = None,
                 single: bool = False, fold_geometry: bool = False) -> None:
        self.interface = Interface(machine, fold_geometry=fold_geometry)
        self.name = prefix(name or machine.name.lower(), where="--prefix" if name else machine.name)
        self.names = Names(self.name)
        self.origin, self.single = origin, single
        self.type = "float" if single else "double"
        self.routines = self.interface.chosen(routines)

    @cached_property
    def function(self) -> ca.Function:
        """All expressions of the routines; outputs in the order of `keys`."""
        outputs = []
        for routine in self.routines.values():
            outputs += [ca.vertcat(*(guard.value for guard in routine.guards)),
                        ca.SX(0, 1) if routine.lengths is None else routine.lengths, *routine.outputs.values()]
        given = self.interface.inputs
        return ca.Function(self.name, list(given.values()), [ca.densify(out) for out in outputs], list(given),
                           [f"out{k}" for k in range(len(outputs))])

    @cached_property
    def keys(self) -> list[tuple[str, str]]:
        """Routine and member that each output of `function` is; ``:guards`` and ``:length`` are for checks."""
        return [(name, key) for name, routine in self.routines.items()
                for key in (":guards", ":length", *routine.outputs)]

    @cached_property
    def programs(self) -> tuple[Program, Program]:
        """What `prepare` reckons once, and all routines, which take its result as ``constants``."""
        return program(self.function).hoisted(self.interface.values, "constants")

    def program(self, routine: Routine) -> Program:
        """What one routine does, its checks first."""
        return self.programs[1].only([f"out{k}" for k, (name, _) in enumerate(self.keys) if name == routine.name])

    @cached_property
    def bodies(self) -> dict[str, list[str]]:
        """Statements of every routine."""
        return {name: self._statements(routine) for name, routine in self.routines.items()}

    @property
    def used(self) -> dict[str, Struct]:
        """The structs that the routines need."""
        names = {"params"}
        for routine in self.routines.values():
            names |= {routine.takes, routine.gives}
            names |= {"load"} if routine.name == "payload_update" else set()
        return {name: struct for name, struct in self.interface.structs.items() if name in names}

    def files(self) -> dict[str, str]:
        """Every file by name."""
        count = sum(len(lines) for lines in self.bodies.values())
        parts = {f"{self.name}.c": list(self.routines)} if count < LARGE else {
            f"{self.name}.c": [], **{f"{self.name}_{name}.c": [name] for name in self.routines}}
        files = {f"{self.name}.h": self._render("header.h"), f"{self.name}_internal.h": self._render("internal.h"),
                 f"{self.name}_params.h": self._render("params.h")}
        for file, names in parts.items():
            files[file] = self._render("source.c", names=names, prepares=file == f"{self.name}.c")
        table, measured = self._table(files)
        sources = sorted(parts)
        return files | {
            f"{self.name}_selftest.c": self._render("selftest.c", **self._golden()),
            "CMakeLists.txt": self._render("CMakeLists.txt", sources=sources),
            "Makefile": self._render("Makefile", sources=sources),
            "README.md": self._render("README.md", table=table, measured=measured)}

    def _table(self, files: Mapping[str, str]) -> tuple[list[list[str]], str]:
        """Rows of the README, one a routine, and how stack and flash were measured."""
        found, measured = sizes(files)
        table = [["`prepare`", "`params`", "`constants`", _operations(self.programs[0])]]
        for routine in self.routines.values():
            writes = "load" if routine.name == "payload_update" else routine.gives
            table.append([f"`{routine.name}`", f"`{routine.takes}`: {', '.join(routine.reads)}", f"`{writes}`",
                          _operations(self.program(routine))])
        taken = [found.get(f"{self.name}_{row[0].strip('`')}") for row in table]
        return [[*row, *map(str, size or ("", ""))] for row, size in zip(table, taken, strict=True)], measured

    def number(self, value: float) -> str:
        """A number in C."""
        return ("-" if value < 0 else "") + literal(abs(value), single=self.single)

    def _statements(self, routine: Routine) -> list[str]:
        shapes = {field.name: self.interface.size(field) for field in self.interface.structs[routine.gives].fields}
        keys = {f"out{k}": key for k, (name, key) in enumerate(self.keys) if name == routine.name}

        def target(name: str, k: int) -> str:
            key = keys[name]
            if key == ":guards":
                guard = routine.guards[k]
                value = f"{self.call('fabs')}({{}})" if guard.absolute else "({})"
                return (f"if (!({value} {guard.relation} {self.number(guard.limit)})) "
                        f"{{{{ return {self.upper}_{guard.status}; }}}}")
            if key == ":length":
                return f"length[{k}] = {{}};"
            place = np.unravel_index(k, shapes[key])
            return f"out->{key}{''.join(f'[{int(i)}]' for i in place)} = {{}};"

        def source(name: str, k: int) -> str:
            return f"constants->value[{k}]" if name == "constants" else f"in->{name}[{k}]"

        return statements(self.program(routine), Naming(source, target, self.type, self.single, self.call))

    def call(self, operation: str) -> str:
        """The C function of an operation."""
        if operation == "sign":
            return f"{self.name}_sign"
        return operation + ("f" if self.single else "")

    @property
    def upper(self) -> str:
        """The prefix of enumerators."""
        return self.name.upper()

    def enumerators(self, kind: str) -> list[tuple[str, str]]:
        """Enumerator and comment of each thing of a kind."""
        names, units = self.interface.kinds[kind]
        return [(self.names.enumerator(kind, name), f"{name} [{units[k]}]" if units else name)
                for k, name in enumerate(names)]

    def kinds_in_use(self) -> dict[str, list[tuple[str, str]]]:
        """Enumerators of all kinds that the structs count in."""
        used = {kind for struct in self.used.values() for field in struct.fields for kind in field.shape}
        return {kind: self.enumerators(kind) for kind in self.interface.kinds if kind in used}

    def declared(self, field: Field) -> str:
        """A member's declaration, or that of a whole struct's array."""
        counts = [str(n) if isinstance(n, int) else f"{self.upper}_{n.upper()}_COUNT" for n in field.shape]
        return f"{self.type} {field.name}{''.join(f'[{n}]' for n in counts)};"

    def prepares(self) -> list[str]:
        """Statements of `prepare`."""
        return statements(self.programs[0], Naming(
            lambda name, k: f"params->{name}[{k}]", lambda _, k: f"constants->value[{k}] = {{}};",
            self.type, self.single, self.call))

    def _golden(self) -> dict[str, object]:
        given = golden.states(self.interface, single=self.single)
        outputs = dict(zip(self.keys, golden.results(self.function, given), strict=True))
        read = {name for routine in self.routines.values() for name in routine.reads}
        inputs = {name: array for name, array in given.items() if name in read}
        return {"inputs": inputs, "outputs": outputs, "states": golden.STATES} | (
            {"load": self._load(outputs)} if "payload_update" in self.routines else {})

    def _load(self, outputs: dict[tuple[str, str], Array]) -> dict[str, Array]:
        """One update of the load by the textbook's formula for a whole block of rows (Ljung, 1999, Section 11.2)."""
        predicted = outputs["payload_update", "predicted"][0, :, 0]
        rows = outputs["payload_update", "rows"][0]
        prior, std = np.diag(np.linspace(50.0, 500.0, rows.shape[1])) ** 2, np.linspace(200.0, 400.0, len(rows))
        force = np.round(predicted + np.linspace(-900.0, 1100.0, len(rows)))
        forgetting = 0.96875  # a float can hold it
        gain = prior @ rows.T @ np.linalg.inv(rows @ prior @ rows.T + np.diag(std**2))
        return {"force": force, "std": std, "prior": np.sqrt(np.diag(prior)), "forgetting": np.array([forgetting]),
                "phi": gain @ (force - predicted), "covariance": (prior - gain @ rows @ prior) / forgetting}

    def _render(self, template: str, **more: object) -> str:
        environment = Environment(loader=PackageLoader("hydroopt.codegen", "templates"), undefined=StrictUndefined,
                                  trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True)
        environment.filters |= {"wrap": _comment, "number": self.number, "numbers": self._numbers}
        return environment.get_template(template).render(
            code=self, p=self.name, P=self.upper, type=self.type, f="f" if self.single else "", statuses=STATUSES,
            version=metadata.version("hydroopt"), **more)

    def _numbers(self, values: Array) -> str:
        text = ", ".join(self.number(value) for value in np.ravel(values))
        return textwrap.fill(text, 116, initial_indent="    ", subsequent_indent="    ", break_long_words=False)


def _operations(made: Program) -> str:
    return ", ".join(f"{times} {kind}" for kind, times in sorted(made.operations.items())) or "none"


def _comment(text: str, indent: int = 0) -> str:
    """A block comment of some lines."""
    margin = " " * indent
    lines = textwrap.wrap(" ".join(text.split()), 112 - indent)
    return "\n".join((f"{margin}/* " if k == 0 else f"{margin} * ") + line for k, line in enumerate(lines)) + " */"
