"""The system's C compiler, and shared libraries that it makes: once, kept under the hash of all that they depend on.

It is called so that it cannot hang this process.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import logging
import os
import platform
import shlex
import signal
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydroopt.support import cache

LEVEL = "-O1"
"""Level of optimisation of what is written for a machine, whose expressions are simple already: `-O3` takes 1.4 times
as long to compile for the same results to the last bit, which gcc's code computes as fast; clang's code at this level
is 0.65 times as fast as at `-O3`, which takes it up to five times as long."""


def flags(system: str, processor: str) -> tuple[str, ...]:
    """Options for the processor at hand, as ``platform.system()`` and ``platform.machine()`` name it.

    No fast-math: only that sqrt need not set errno. Products and sums may be fused, as the compiler does by itself.
    Tests run on Linux alone; elsewhere a compiler that refuses these options leaves the work to CasADi.

    >>> " ".join(flags("Darwin", "arm64"))
    '-O1 -mcpu=native -fno-math-errno -ftree-vectorize -fexpensive-optimizations -fPIC -shared -w'
    """
    own = "-mcpu=native" if (system, processor) == ("Darwin", "arm64") else "-march=native"
    place = () if system == "Windows" else ("-fPIC",)  # all code there can be moved, and clang refuses the option
    # beside that level: the C library's vectors of sines begin as loops, and gcc fuses products and sums
    always = ("-ftree-vectorize", "-fexpensive-optimizations")
    return (LEVEL, own, "-fno-math-errno", *always, *place, "-shared", "-w")


FLAGS = flags(platform.system(), platform.machine())
INSTALLED = {"Darwin": "'xcode-select --install' installs one",
             "Windows": "install clang of LLVM, and add it to the path"}
"""How a compiler is installed, by ``platform.system()``."""
LONGEST = 3_000_000
"""Characters of C beyond which any optimisation takes minutes; without, it still beats CasADi's virtual machine."""
PROBING, COMPILING = 10.0, 120.0
"""Time limits [s] of a compiler to introduce itself, and to compile a kernel."""
COUNT, NUMBER, ADDRESS = ctypes.c_long, ctypes.c_double, ctypes.c_void_p
"""What routines take: long, double, and pointers."""


@dataclass
class Compiler:
    """The system's compiler: its command and options, and what it says of itself and of the processor it compiles for.

    `hangs` is set when it has exceeded its time limit: it is not called again.
    """

    command: tuple[str, ...]
    options: tuple[str, ...]
    macros: bytes
    hangs: bool = False

    @property
    def libraries(self) -> tuple[str, ...]:
        """The C library's vectors of sines, where there are any, and its mathematics, where it is a library."""
        if b"_MSC_VER" in self.macros:
            return ()
        vectors = all(name in self.macros for name in (b"__GLIBC__", b"__x86_64__")) and b"__clang__" not in self.macros
        return ("-DVECTOR_LIBRARY", "-lmvec", "-lm") if vectors else ("-lm",)

    def compile(self, source: str, folder: Path) -> Path:
        """A shared library of C `source`, in `folder`, which also takes the compiler's temporary files; the longest
        sources are not optimised.

        The compiler works there, since linkers look for some libraries in their working directory.

        Raises:
            OSError: the compiler cannot be started.
            subprocess.SubprocessError: it fails or exceeds its time limit.
        """
        built = folder / "kernel.so"
        level = ("-O0",) if len(source) > LONGEST else ()  # the last level counts
        command = (*self.command, *FLAGS, *self.options, *level, "-x", "c", "-", "-o", str(built), *self.libraries)
        try:
            _run(command, source.encode(), COMPILING, folder)
        except subprocess.TimeoutExpired:
            self.hangs = True
            raise
        return built


@functools.cache
def compiler() -> Compiler | None:
    """``$CC``, ``cc``, ``gcc`` or ``clang``; None, with a notice, where none of them works.

    Options that ``$CC`` states beside the command come last, so that they count.
    """
    for stated in filter(None, (os.environ.get("CC"), "cc", "gcc", "clang")):
        try:
            program, *words = shlex.split(stated) or [stated]
            own = next((k for k, word in enumerate(words) if word.startswith("-")), len(words))
            command = (os.path.abspath(program) if os.path.dirname(program) else program, *words[:own])
            options = tuple(words[own:])
            asked = (*command, *FLAGS[:2], *options, "-dM", "-E", "-x", "c", "-")
            return Compiler(command, options, _run(asked, b"#include <math.h>\n", PROBING))
        except (OSError, ValueError, subprocess.SubprocessError) as error:
            if stated == os.environ.get("CC"):
                notice(f"CC={stated!a:.100} cannot be used ({reason(error)})", "the system's compiler is used")
    notice(f"no C compiler found ({INSTALLED.get(platform.system(), 'install gcc or clang')})")
    return None


def _run(command: tuple[str, ...], given: bytes, seconds: float, folder: Path | None = None) -> bytes:
    """Standard output of a command; it and its processes end after `seconds`, by Ctrl-C, and with this process."""
    environment = None if folder is None else {**os.environ, "TMPDIR": str(folder)}
    own: dict[str, Any] = {"process_group": 0} if os.name == "posix" else {}
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                          env=environment, cwd=folder, **own) as running, _ending_with_us(running):
        try:
            out, said = running.communicate(given, seconds)
        except BaseException:
            with suppress(OSError):
                os.killpg(running.pid, signal.SIGKILL) if own else running.kill()
            raise
    if running.returncode:
        raise subprocess.CalledProcessError(running.returncode, command[0], out, said)
    return bytes(out)


@contextmanager
def _ending_with_us(running: subprocess.Popen[bytes]) -> Iterator[None]:
    """A shell in the group of a running command, which kills the group when this process ends, even if it is killed.

    The shell waits for the end of its input, which the system closes with this process.
    """
    if os.name != "posix":
        yield
        return
    with subprocess.Popen(("/bin/sh", "-c", "read -r _; kill -KILL 0"), stdin=subprocess.PIPE,
                          stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, process_group=running.pid) as shell:
        try:
            yield
        finally:
            shell.kill()


def reason(error: Exception) -> str:
    """Why a compiler or a library cannot be used, in short."""
    if isinstance(error, subprocess.TimeoutExpired):
        return f"no answer within {error.timeout:.0f} s"
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    said = (getattr(error, "stderr", None) or str(error).encode()).decode(errors="replace")
    return "".join(c if c.isprintable() else "?" for c in " ".join(said.split()))[:200]


@functools.cache
def notice(what: str, instead: str = "CasADi's virtual machine evaluates the model, more slowly") -> None:
    """Say once what does not work, and what happens instead."""
    logging.getLogger("hydroopt").warning("hydroopt: %s; %s.", what, instead)


def routine(library: ctypes.CDLL, name: str, *arguments: Any, result: Any = None) -> Callable[..., Any]:
    """A routine of a library that takes arguments of these types.

    Raises:
        OSError: the library has no such routine.
    """
    try:
        made: Callable[..., Any] = library[name]
    except AttributeError:
        raise OSError(f"the library has no routine '{name}'") from None
    made.argtypes, made.restype = arguments, result  # type: ignore[attr-defined]
    return made


def built(content: Sequence[bytes], by: Compiler, write: Callable[[], str]) -> ctypes.CDLL:
    """The shared library of some C, kept in the cache under the hash of all that it depends on.

    Args:
        content: what the C depends on.
        by: the compiler.
        write: writes the C.

    Raises:
        OSError, subprocess.SubprocessError: it cannot be compiled or loaded.
        NotImplementedError: there is no C for it.
    """
    key = hashlib.sha256()
    how = Path(__file__).read_bytes()
    for part in (*content, how, " ".join((*by.command, *FLAGS, *by.options)).encode(), by.macros):
        key.update(hashlib.sha256(part).digest())

    def compiled(place: Path) -> Path:
        library = by.compile(write(), place)
        _refuse_broken(library)
        return library

    try:
        return cache.kept(key.hexdigest()[:2], key.hexdigest()[:32], ".so", compiled,
                          lambda library: ctypes.CDLL(str(library)))
    except OSError as error:
        notice(f"kernels cannot be kept ({reason(error)})", "they are compiled at each start; set HYDROOPT_CACHE to a "
               "folder to which you alone can write")
    with cache.scratch() as place:
        return ctypes.CDLL(str(compiled(place)))


def _refuse_broken(library: Path) -> None:
    """Refuse a library that is not whole: it would end this process, now or when its last page is used.

    Linux maps what an ELF file lacks without an error; linkers write its table of sections at the end. All else is
    found by loading the library in another process.

    Raises:
        OSError: the library is missing or not whole.
    """
    with library.open("rb") as file:
        head, size = file.read(64), os.fstat(file.fileno()).st_size
    if head[:5] == b"\x7fELF\x02" and len(head) == 64:
        start, each, count = *struct.unpack_from("=Q", head, 40), *struct.unpack_from("=HH", head, 58)
        if not 0 < start <= size - each * count:
            raise OSError("the compiler wrote a part of the library")
    load = [sys.executable, "-I", "-S", "-c", "import ctypes, sys; ctypes.CDLL(sys.argv[1])", str(library)]
    if subprocess.run(load, capture_output=True, timeout=PROBING, check=False).returncode:
        raise OSError("the compiler wrote what cannot be loaded")
