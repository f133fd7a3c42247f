"""Rooms import only rooms above them, third-party libraries stay where they belong, and files stay short."""

from __future__ import annotations

import ast
import re
from functools import cache
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import pytest

PACKAGE = Path(__file__).parents[1] / "hydroopt"

ROOMS = (
    ("errors",),
    ("units",),
    ("support",),
    ("spatial",),
    ("kernels",),
    ("machine",),
    ("parameters",),
    ("model",),
    ("logs",),
    ("simulation",),
    ("limits",),
    ("results",),
    ("checks",),
    ("estimation.inference",),
    ("estimation.motion",),
    ("estimation.dynamic", "estimation.kinematic", "estimation.hydraulic"),
    ("estimation.combined",),
    ("weighing",),
    ("excitation.criteria",),
    ("excitation.motion",),
    ("excitation.selection",),
    ("control",),
    ("codegen",),
    ("study",),
    ("report",),
    ("guided",),
    ("solving", "viewing", "plots"),
    ("cli",),
    ("__init__", "__main__"),
)
"""From the foundation upwards; rooms of one line never import each other."""

QUARANTINE = {
    "casadi": ("spatial", "machine", "kernels", "model", "limits", "codegen", "estimation", "excitation", "control"),
    "control": ("control",),
    "cvxpy": ("estimation.inference",),
    "piqp": ("excitation.motion.sqp",),
    "matplotlib": ("plots",),
    "jinja2": ("kernels", "codegen", "report"),
    "pint": ("units",),
    "pyarrow": ("logs",),
    "typer": ("cli",),
    "filelock": ("support.files",),
    "rich": ("cli",),
    "plotext": ("guided.drawing",),
    "pandas": ("logs", "results", "support.notebook_card"),
    "pydantic": ("machine", "logs.column_map", "results.json_file"),
    "mujoco": ("machine.robot_formats.mjcf_in",),
    "dask": ("study.scheduler",),
    "distributed": ("study.scheduler",),
    "h5py": ("logs.formats.decoders.hdf5",),
    "asammdf": ("logs.formats.decoders.mdf",),
    "nptdms": ("logs.formats.decoders.tdms",),
    "python_calamine": ("logs.formats.decoders.xlsx",),
    "rosbags": ("logs.formats.decoders.bags",),
    "mcap": ("logs.formats.decoders.bags",),
}


def name_of(file: Path) -> str:
    return ".".join(file.relative_to(PACKAGE).with_suffix("").parts)


class Source(NamedTuple):
    """What a module's syntax tree says; the trees themselves are millions of objects, which each collection walks.

    Attributes:
        imports: dotted names imported anywhere, inside functions too.
        at_run_time: those imported when it runs, not for the type checker alone.
        names: of all it defines, calls or reads.
    """

    imports: set[str]
    at_run_time: set[str]
    names: set[str]


@cache
def modules() -> dict[str, Source]:
    return {name_of(file): source(ast.parse(file.read_text("utf-8"))) for file in sorted(PACKAGE.rglob("*.py"))}


def source(tree: ast.Module) -> Source:
    """What a tree says."""
    nodes = list(ast.walk(tree))
    checked = [node for node in nodes if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    named = {getattr(node, key, None) for node in nodes for key in ("attr", "id", "name")}
    return Source(imports(tree), imports(tree) - set(chain.from_iterable(map(imports, checked))),
                  {name for name in named if isinstance(name, str)})


def imports(tree: ast.AST) -> set[str]:
    """Dotted names imported anywhere below a node, inside functions too."""
    found = [[f"{node.module}.{alias.name}" for alias in node.names] if isinstance(node, ast.ImportFrom) else
             [alias.name for alias in node.names] for node in ast.walk(tree)
             if isinstance(node, ast.Import | ast.ImportFrom)]
    return set(chain.from_iterable(found))


def inside(module: str) -> set[str]:
    """Modules of hydroopt that a module imports."""
    found = set()
    for name in modules()[module].imports:
        parts = name.split(".")
        while parts[0] == "hydroopt" and len(parts) > 1 and ".".join(parts[1:]) not in modules():
            if ".".join([*parts[1:], "__init__"]) in modules():
                parts.append("__init__")
                break
            parts.pop()
        if parts[0] == "hydroopt":
            found.add(".".join(parts[1:]) or "__init__")
    return found - {module}


def room(module: str) -> str:
    held = [name for name in chain.from_iterable(ROOMS) if f"{module}.".startswith(f"{name}.")]
    return max(held, key=len, default="")


def floor(module: str) -> int:
    return next((k for k, names in enumerate(ROOMS) if room(module) in names), -1)


def test_every_module_stands_in_a_room() -> None:
    assert {module for module in modules() if not room(module)} <= {"estimation.__init__", "excitation.__init__"}


def test_rooms_import_only_rooms_above_them() -> None:
    wrong = {f"{module} imports {other}" for module in modules() for other in inside(module)
             if room(module) and room(other) != room(module) and floor(other) >= floor(module)}
    assert not wrong


def test_no_module_needs_itself() -> None:
    graph = {module: inside(module) for module in modules()}
    while free := [module for module, needs in graph.items() if not needs & graph.keys()]:
        for module in free:
            del graph[module]
    assert not graph, f"in or above a cycle: {sorted(graph)}"


def test_third_party_libraries_stay_in_quarantine() -> None:
    foreign = {module: {name.split(".")[0] for name in said.imports} for module, said in modules().items()}
    users = {library: {module for module, names in foreign.items() if library in names} for library in QUARANTINE}
    strays = {f"{module} imports {library}" for library, found in users.items() for module in found
              if not any(f"{module}.".startswith(f"{home}.") for home in QUARANTINE[library])}
    assert not strays
    assert all(users.values()), "the list is out of date"


SOLE_CALLERS = {
    "nlpsol": "estimation.inference.ipopt",  # whose options keep IPOPT from reading ipopt.opt in the working directory
}
"""Calls that stand in one module alone, because it makes them safe."""


@pytest.mark.parametrize(("call", "home"), SOLE_CALLERS.items())
def test_dangerous_calls_stand_in_one_module(call: str, home: str) -> None:
    assert {module for module, said in modules().items() if call in said.names} == {home}


COMPUTING = ("estimation", "excitation", "control", "model", "simulation", "codegen", "kernels", "parameters")
"""Rooms that compute: a page may name their types for the type checker, but imports none of them when it runs."""


def test_pages_compute_nothing() -> None:
    found = {module: {name.removeprefix("hydroopt.") for name in said.at_run_time
                      if name.startswith("scipy") or name.split(".")[:2] in [["hydroopt", room] for room in COMPUTING]}
             for module, said in modules().items() if module.startswith("report.")}
    assert not {module: names for module, names in found.items() if names}


def test_files_are_short_and_finished() -> None:
    texts = {str(file.relative_to(PACKAGE)): file.read_text("utf-8") for file in PACKAGE.rglob("*.py")}
    assert not {name for name, text in texts.items() if text.count("\n") > 600}
    assert not {name for name, text in texts.items() if re.search(r"\b(TODO|FIXME|XXX|HACK)\b", text)}
