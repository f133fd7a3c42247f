"""Stack and flash that each routine of the generated C needs on a controller, measured with a compiler."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

CORTEX_M4F = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")


class Target(NamedTuple):
    """A compiler with its flags, and the tool that reads section sizes of its object files."""

    command: str
    flags: tuple[str, ...]
    size: str
    name: str


class Size(NamedTuple):
    """Bytes of stack, without calls to the C library, and of flash."""

    stack: int
    flash: int


TARGETS = (Target("arm-none-eabi-gcc", CORTEX_M4F, "arm-none-eabi-size", "Cortex-M4F"),
           Target("gcc", (), "size", "this computer"))


def sizes(files: Mapping[str, str]) -> tuple[dict[str, Size], str]:
    """Size of each function of the sources, and how it was measured; empty if no compiler is found.

    Args:
        files: texts of all files by name; those whose names end in ``.c`` are compiled, the self-test left out.
    """
    for target in TARGETS:
        if shutil.which(target.command) and shutil.which(target.size):
            try:
                return _measured(files, target)
            except (OSError, subprocess.SubprocessError):  # headers of a C library may be missing
                continue
    return {}, "Stack and flash were not measured, as no compiler was found; gcc -fstack-usage and size report them."


def _measured(files: Mapping[str, str], target: Target) -> tuple[dict[str, Size], str]:
    stack: dict[str, int] = {}
    flash: dict[str, int] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, text in files.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        for name in files:
            if not name.endswith(".c") or name.endswith("_selftest.c"):
                continue
            subprocess.run([target.command, "-std=c99", "-O2", *target.flags, "-ffunction-sections", "-fstack-usage",
                            "-c", name], cwd=folder, check=True, capture_output=True)
            for line in (Path(folder) / name).with_suffix(".su").read_text("utf-8").splitlines():
                place, size, _ = line.split("\t")
                stack[place.rpartition(":")[2]] = int(size)
            table = subprocess.run([target.size, "-A", f"{name[:-2]}.o"], cwd=folder, check=True, capture_output=True,
                                   text=True).stdout
            for function, size in re.findall(r"^\.text\.(\w+)\s+(\d+)", table, re.MULTILINE):
                flash[function] = int(size)
    version = subprocess.run([target.command, "-dumpfullversion"], check=True, capture_output=True, text=True).stdout
    return ({name: Size(stack.get(name, 0), size) for name, size in flash.items()},
            f"Stack and flash in bytes, for {target.name} by {target.command} {version.strip()} "
            f"{' '.join(('-O2', *target.flags))}; without the mathematical library.")
