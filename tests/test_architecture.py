"""Imports go downwards only, foreign libraries stay where they belong, and files stay short."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "hydroopt"
FILES = sorted(PACKAGE.rglob("*.py"))

LEVELS = {"errors": 0, "files": 0, "interrupt": 0, "units": 0,
          "inertia": 1, "parameters": 1, "quantity": 1, "spatial": 1,
          "circuit": 2, "description": 2, "dynamic_parameters": 2, "geometry": 2, "hydraulic_parameters": 2,
          "linkage": 2, "machine": 2, "parts": 2,
          "site": 2, "statements": 2, "strokes": 2, "urdf": 2,
          "model": 3, "signals": 3,
          "driving": 4, "identifiability": 4, "postures": 4, "solvers": 4, "synthetic": 4,
          "codegen": 5, "control": 5, "estimation": 5, "excitation": 5,
          "__init__": 6, "__main__": 6, "cli": 6, "report": 6, "study": 6}

QUARANTINE = {
    "casadi": ("spatial", "geometry", "strokes", "model", "codegen", "solvers", "estimation", "excitation",
               "control"),
    "control": ("control",),
    "cvxpy": ("estimation.feasible", "solvers"),
    "clarabel": ("solvers",),
    "piqp": ("excitation.solver",),
    "matplotlib": ("report",),
    "jinja2": ("model.compiled", "codegen.folder", "report"),
    "pyarrow": ("signals",),
    "typer": ("cli",),
    "rich": ("cli",),
    "pint": ("units",),
    "pydantic": ("quantity", "circuit", "parts", "linkage", "machine", "site", "statements", "description",
                 "signals.mapping"),
    "tomlkit": ("description",),
    "dask": ("study.workers",),
    "distributed": ("study.workers",),
    "pandas": (),
}


def name_of(file: Path) -> str:
    return ".".join(file.relative_to(PACKAGE).with_suffix("").parts)


MODULES = {name_of(file): ast.parse(file.read_text("utf-8")) for file in FILES}


def imports(node: ast.AST, *, run_time: bool = False) -> set[str]:
    """Dotted names imported anywhere in a module, or only those needed to import it."""
    found: set[str] = set()
    for child in ast.iter_child_nodes(node):
        if run_time and (isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
                         or (isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test))):
            continue
        if isinstance(child, ast.Import):
            found |= {alias.name for alias in child.names}
        elif isinstance(child, ast.ImportFrom):
            assert child.level == 0, "imports are absolute here"
            found |= {f"{child.module}.{alias.name}" for alias in child.names}
        found |= imports(child, run_time=run_time)
    return found


def inside(module: str, *, run_time: bool = False) -> set[str]:
    """Modules of hydroopt that a module imports."""
    found = set()
    for name in imports(MODULES[module], run_time=run_time):
        parts = name.split(".")
        if parts[0] == "hydroopt":
            inner = parts[1:]
            while inner and ".".join(inner) not in MODULES and ".".join([*inner, "__init__"]) not in MODULES:
                inner = inner[:-1]
            known = ".".join(inner)
            found.add(known if known in MODULES else f"{known}.__init__".lstrip("."))
    return found - {module}


def level(module: str) -> int:
    return LEVELS[module.split(".", maxsplit=1)[0]]


@pytest.mark.parametrize("module", MODULES)
def test_imports_go_down(module: str) -> None:
    upwards = {other for other in inside(module) if level(other) > level(module)}
    assert not upwards


def test_no_module_needs_itself() -> None:
    graph = {module: inside(module, run_time=True) for module in MODULES}
    while free := [module for module, needs in graph.items() if not needs & graph.keys()]:
        for module in free:
            del graph[module]
    assert not graph, f"in or above a cycle: {sorted(graph)}"


@pytest.mark.parametrize("library", QUARANTINE)
def test_foreign_libraries_stay_in_quarantine(library: str) -> None:
    users = {module for module, tree in MODULES.items() if library in {name.split(".")[0] for name in imports(tree)}}
    allowed = {module for module in users for home in QUARANTINE[library] if f"{module}.".startswith(f"{home}.")}
    assert users == allowed
    assert bool(users) == (library not in ("pandas", "clarabel")), "the list is out of date"


@pytest.mark.parametrize("file", FILES, ids=name_of)
def test_files_are_short_and_finished(file: Path) -> None:
    text = file.read_text("utf-8")
    assert text.count("\n") <= 450
    assert not re.search(r"\b(TODO|FIXME|XXX|HACK)\b", text)
