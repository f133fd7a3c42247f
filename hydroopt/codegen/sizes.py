"""Stack, flash and instructions of each routine of the generated C on controllers, by cross compiler and emulator."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

PREFIX = "arm-none-eabi-"
OPTIMISED = ("-std=c99", "-O2")
CORTEX_M4F = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")
SECONDS = 120.0
"""How long a tool may take."""


class Target(NamedTuple):
    """A processor with the compiler's flags for it, and the board that QEMU emulates with it."""

    name: str
    flags: tuple[str, ...]
    board: str


SINGLE = (Target("Cortex-M4F", CORTEX_M4F, "mps2-an386"),
          Target("Cortex-M7", ("-mcpu=cortex-m7", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv5-sp-d16"), "mps2-an500"))
DOUBLE = (Target("Cortex-M4F, whose doubles are computed by software", CORTEX_M4F, "mps2-an386"),
          Target("Cortex-M7", ("-mcpu=cortex-m7", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv5-d16"), "mps2-an500"))


class Size(NamedTuple):
    """Bytes of stack of the whole chain of calls, bytes of flash of the function itself, and instructions of a call.

    `stack` is an upper bound from the compiler's report and, for the C library, from its machine code; `used` is what
    a call wrote in the emulator. None where the emulator is missing.
    """

    stack: int
    flash: int
    instructions: int | None
    used: int | None


class Measured(NamedTuple):
    """What functions need on a target, how it was measured, and what they call of the C library."""

    target: str
    method: str
    functions: Mapping[str, Size]
    library: tuple[str, ...]
    program: int
    """Bytes of flash of the self-test with all that it needs."""
    passed: bool | None
    """Whether the self-test passed in the emulator."""


def sizes(files: Mapping[str, str], *, single: bool) -> list[Measured]:
    """What each function of the sources needs on each target; empty where cross compiler or C library is missing.

    Args:
        files: texts of all files by name, with the self-test and ``bench.c`` and ``cortex_m.ld``, which run it.
        single: whether the code computes in single precision.
    """
    if not all(shutil.which(PREFIX + tool) for tool in ("gcc", "objdump", "size")):
        return []
    try:
        return [_measured(files, target) for target in (SINGLE if single else DOUBLE)]
    except (OSError, subprocess.SubprocessError):  # headers of a C library may be missing
        return []


def _measured(files: Mapping[str, str], target: Target) -> Measured:
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
        sources = [name for name in files if name.endswith(".c") and not name.endswith("_selftest.c")
                   and name != "bench.c"]
        gcc = (PREFIX + "gcc", *OPTIMISED, *target.flags, "-ffunction-sections", "-fstack-usage", "-c")
        _run([*gcc, *sources, "bench.c"], folder)
        objects = [f"{name[:-2]}.o" for name in sources]
        _run([PREFIX + "gcc", *target.flags, "-nostartfiles", "-T", "cortex_m.ld", "-o", "program.elf", "bench.o",
              *objects, "-lm"], folder)
        own, flash = _frames(folder, sources), _flash(_run([PREFIX + "size", "-A", *objects], folder))
        frames, calls = disassembled(_run([PREFIX + "objdump", "-d", "--no-show-raw-insn", "program.elf"], folder))
        program = _run([PREFIX + "size", "program.elf"], folder)
        counted, passed = _emulated(folder, target)
        version = _run([PREFIX + "gcc", "-dumpfullversion"], folder).strip()
    frames |= own
    functions = {name: Size(deepest(name, frames, calls), size, *counted.get(name, (None, None)))
                 for name, size in flash.items() if name in own}
    library = sorted({call for name in own for call in calls.get(name, ())} - own.keys())
    return Measured(target.name, f"{PREFIX}gcc {version} {' '.join(('-O2', *target.flags))}", functions, tuple(library),
                    int(program.splitlines()[1].split()[0]), passed)


def _run(command: Iterable[str], folder: Path) -> str:
    return subprocess.run([*command], cwd=folder, check=True, capture_output=True, text=True, timeout=SECONDS).stdout


def _frames(folder: Path, sources: Iterable[str]) -> dict[str, int]:
    """Bytes of stack of each function itself, as the compiler reports."""
    lines = [line.split("\t") for name in sources
             for line in (folder / name).with_suffix(".su").read_text("utf-8").splitlines()]
    return {place.rpartition(":")[2]: int(size) for place, size, _ in lines}


def _flash(table: str) -> dict[str, int]:
    return {function: int(size) for function, size in re.findall(r"^\.text\.(\w+)\s+(\d+)", table, re.MULTILINE)}


def disassembled(listed: str) -> tuple[dict[str, int], dict[str, set[str]]]:
    """Bytes of stack of each function by what it pushes and reserves, at most, and the functions that it calls.

    Args:
        listed: what objdump lists of Thumb code.
    """
    frames: dict[str, int] = {}
    calls: dict[str, set[str]] = {}
    for name, body in re.findall(r"^[0-9a-f]+ <(\w+)>:\n((?:.+\n?)*)", listed, re.MULTILINE):
        frames[name] = sum(4 * _registers(each) for each in re.findall(
            r"\t(?:push|stmdb)(?:\.w)?\t(?:sp!, )?\{([^}]*)\}", body))
        frames[name] += sum((8 if each.startswith("d") else 4) * _registers(each)
                            for each in re.findall(r"\tvpush\t\{([^}]*)\}", body))
        frames[name] += sum(map(int, re.findall(r"\tsubw?(?:\.w)?\tsp, (?:sp, )?#(\d+)", body)))
        frames[name] += sum(map(int, re.findall(r"\tstr(?:d|\.w)?\t[^\[\n]*\[sp, #-(\d+)\]!", body)))
        calls[name] = {each for each in re.findall(r"\tb(?:l|[a-z]{2})?(?:\.w|\.n)?\t[0-9a-f]+ <(\w+)>", body)
                       if each != name}
    return frames, calls


def _registers(stated: str) -> int:
    """Number of registers in a list such as ``r4, r5, lr`` or ``d8-d9``."""
    count = 0
    for each in stated.split(","):
        first, _, last = (part.strip(" {}srd") for part in each.partition("-"))
        count += int(last) - int(first) + 1 if last else 1
    return count


def deepest(name: str, frames: Mapping[str, int], calls: Mapping[str, set[str]], above: frozenset[str] = frozenset()
            ) -> int:
    """Bytes of stack of a function and the deepest chain of those that it calls.

    Raises:
        RecursionError: a function calls itself, so that no stack suffices.
    """
    if name in above:
        raise RecursionError(f"{name} calls itself")
    chains = (deepest(each, frames, calls, above | {name}) for each in sorted(calls.get(name, ())))
    return frames.get(name, 0) + max(chains, default=0)


def _emulated(folder: Path, target: Target) -> tuple[dict[str, tuple[int, int]], bool | None]:
    """Instructions and written bytes of stack of each function, and whether the self-test passed."""
    if shutil.which("qemu-system-arm") is None:
        return {}, None
    done = subprocess.run(["qemu-system-arm", "-M", target.board, "-display", "none", "-monitor", "none", "-serial",
                           "none", "-semihosting-config", "enable=on,target=native", "-icount", "shift=0", "-kernel",
                           "program.elf"], cwd=folder, check=False, capture_output=True, text=True, timeout=SECONDS)
    rows = re.findall(r"^(\w+) (\d+) (\d+)$", done.stdout + done.stderr, re.MULTILINE)
    return {name: (int(instructions), int(stack)) for name, instructions, stack in rows}, done.returncode == 0
