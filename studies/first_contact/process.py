"""What imports and jobs change in the process, and what files in the working directory do to commands.

One process imports the libraries first, then every module and public name of hydroopt, then identifies a simulated
machine, writes its page and its C. Of the process is compared what belongs to all that run in it. Commands run in a
folder of files that would be imported or obeyed if the working directory counted.
"""

from __future__ import annotations

import ast
import gc
import importlib
import json
import locale
import logging
import os
import pkgutil
import signal
import subprocess
import sys
import tempfile
import threading
import warnings
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}
MODULES = ("ast", "casadi", "control", "cvxpy", "lazy_loader", "matplotlib", "numpy", "pandas", "pickle", "scipy",
           "selectors", "signal", "sitecustomize", "socket", "struct", "tempfile", "threading", "typer", "typing")
"""Names under which foreign modules lie in the folder: of libraries, and of what Python imports to start a process."""
SETTINGS = {"matplotlibrc": b"text.usetex: True\nbackend: module://casadi\nno such setting\n\xff\n",
            **dict.fromkeys(("pyproject.toml", "hydroopt.toml", "patu655_lift", "patu655_lift.toml", "dask.yaml"),
                            b"nothing that can be read [")}
COMMANDS = (("show", "patu655_lift", "-o", "{}/shown"),
            ("simulate", "patu655_lift", "--duration", "10", "-o", "{}/run"),
            ("identify", "patu655_lift", "{}/run/log.csv", "-o", "{}/out"), ("codegen", "{}/out", "-o", "{}/c"),
            ("plan-poses", "panda_mukca", "-n", "6", "-o", "{}/poses"),
            ("study", "montecarlo", "patu655_lift", "--cells", "1", "--processes", "1", "--method", "nlp", "--duration",
             "6", "-o", "{}/study"))


def run() -> dict[str, float]:
    """How many modules and commands were tried, and how many changes and effects were found."""
    modules, changes = changed()
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as results:
        hostile(Path(folder))
        effects = [effect for command in COMMANDS for effect in effects_on(command, Path(folder), Path(results))]
    print(*changes, *effects, sep="\n")
    return {"process_modules_imported": modules, "process_changes": len(changes),
            "process_hostile_files": len(MODULES) + len(SETTINGS) + 1, "process_hostile_commands": len(COMMANDS),
            "process_hostile_effects": len(effects)}


def changed() -> tuple[int, list[str]]:
    """The number of modules that a process of its own has imported, and what it found changed afterwards."""
    done = subprocess.run([sys.executable, "-P", __file__], env=ENVIRONMENT, capture_output=True, text=True, check=True)
    modules, changes = json.loads(done.stdout.splitlines()[-1])
    return modules, changes


def hostile(folder: Path) -> None:
    """Write files that each leave `marker` in the folder, should anything run or obey them."""
    for name in MODULES:
        (folder / f"{name}.py").write_text(f"open({str(folder / 'marker')!r}, 'a').write('{name} ')\n")
    for name, content in SETTINGS.items():
        (folder / name).write_bytes(content)
    (folder / "ipopt.opt").write_text(f"output_file {folder / 'marker'}\n")


def effects_on(command: tuple[str, ...], folder: Path, results: Path) -> list[str]:
    """What differs from a command that runs elsewhere: it fails, says something, or leaves something in the folder."""
    before = set(folder.iterdir())
    done = subprocess.run([sys.executable, "-m", "hydroopt", *(word.format(results) for word in command)], cwd=folder,
                          capture_output=True, text=True, check=False, env=ENVIRONMENT)
    found = [f"{command[0]}: {done.returncode} {done.stderr[-2000:]}"] * bool(done.returncode or done.stderr)
    return found + [f"{command[0]}: {each.name} is new" for each in set(folder.iterdir()) - before]


def _own_process() -> tuple[int, list[str]]:
    for name in _libraries():
        with suppress(ImportError, AttributeError):
            importlib.import_module(name)
    happened: list[str] = []
    before = _state()
    sys.addaudithook(lambda event, _: happened.append(event) if event in (
        "os.chdir", "os.fchdir", "os.putenv", "os.unsetenv") else None)
    import hydroopt as ho  # noqa: PLC0415 (what is watched)

    modules = [each.name for each in pkgutil.walk_packages(ho.__path__, "hydroopt.") if "__main__" not in each.name]
    for name in modules:
        importlib.import_module(name)
    for name in ho.__all__:
        getattr(ho, name)
    model = ho.Model(ho.load_machine("patu655_lift"))
    log = ho.simulate(model, ho.random_trajectory(model, duration=10.0, rate=50, seed=1), seed=1)
    estimate = ho.solve(ho.identification_problem(model, [log]), seed=1)
    with tempfile.TemporaryDirectory() as folder:
        estimate.save(folder)
        ho.load(folder)
    after = _state()
    return len(modules), sorted(set(happened)) + [
        f"{key}: {before[key]} became {after[key]}"[:500] for key in before if before[key] != after[key]]


def _libraries() -> Iterator[str]:
    """What hydroopt's sources import from elsewhere, and what such a name may stand for."""
    for file in sorted((ROOT / "hydroopt").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                yield from (each.name for each in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module and not node.module.startswith("hydroopt"):
                yield node.module
                yield from (f"{node.module}.{each.name}" for each in node.names)
            elif isinstance(node, ast.Call) and ast.unparse(node.func) in ("needed", "Lazy"):
                yield from (each.value for each in node.args[:1] if isinstance(each, ast.Constant))


def _state() -> dict[str, Any]:
    foreign = {name: module for name, module in sys.modules.items() if name.partition(".")[0] != "hydroopt"}
    return {
        "working directory": os.getcwd(), "sys.path": list(sys.path), "environment": dict(os.environ),
        "finders": [*map(repr, sys.meta_path)], "temporary files": tempfile.gettempdir(),
        "modules without a specification of their own": sorted(
            name for name, module in foreign.items()
            if getattr(module, "__spec__", None) is None or module.__spec__.name != name),
        "signals": {number: signal.getsignal(number) for number in signal.valid_signals()},
        "blocked signals": signal.pthread_sigmask(signal.SIG_BLOCK, ()),
        "garbage collector": (gc.get_threshold(), gc.isenabled(), gc.get_freeze_count()),
        "warnings": [*map(repr, warnings.filters)],
        "loggers": {name: (logger.level, logger.disabled, list(logger.handlers)) for name, logger in (
            ("", logging.root), *logging.root.manager.loggerDict.items()) if isinstance(logger, logging.Logger)},
        "hooks": (sys.excepthook, sys.unraisablehook, sys.displayhook, threading.excepthook),
        "streams": (sys.stdin, sys.stdout, sys.stderr), "locale": locale.setlocale(locale.LC_ALL),
        "recursion": sys.getrecursionlimit(), "settings of NumPy": importlib.import_module("numpy").geterr(),
        "settings of matplotlib": dict(importlib.import_module("matplotlib").rcParams)}


if __name__ == "__main__":
    print(json.dumps(_own_process()))
