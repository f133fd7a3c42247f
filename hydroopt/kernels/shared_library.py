"""Shared libraries of C: compiled once by the system's compiler, and kept under the hash of all that they depend on."""

from __future__ import annotations

import ctypes
import hashlib
import os
import struct
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from hydroopt import cache
from hydroopt.kernels.compiler import FLAGS, PROBING, Compiler, notice, reason

COUNT, NUMBER, ADDRESS = ctypes.c_long, ctypes.c_double, ctypes.c_void_p
"""What routines take: long, double, and pointers."""


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
    how = Path(__file__).with_name("compiler.py").read_bytes()
    for part in (*content, how, " ".join((*by.command, *FLAGS, *by.options)).encode(), by.macros):
        key.update(hashlib.sha256(part).digest())

    def compiled(place: Path) -> Path:
        library = by.compile(write(), place)
        _refuse_broken(library)
        return library

    try:
        return _kept(cache.folder(key.hexdigest()[:2]), key.hexdigest()[:32], compiled)
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


def _kept(folder: Path, key: str, compiled: Callable[[Path], Path]) -> ctypes.CDLL:
    """The library of this key in a folder that only this user can write; what is there but not whole is made anew.

    The name is a hash of the content: a library is whole or is not used, however many processes make it at once.
    """
    names = [name for name in os.listdir(folder) if name.startswith(f"{key}-") and name.endswith(".so")]
    for entry in sorted(folder / name for name in names):  # pathlib's glob takes ten times as long
        with suppress(OSError):
            if hashlib.sha256(cache.read(entry)).hexdigest()[:32] == entry.stem.partition("-")[2]:
                return ctypes.CDLL(str(entry))
        with suppress(FileNotFoundError):  # another process found it first
            entry.unlink()
    with cache.scratch(folder) as place:
        built = compiled(place)
        built.chmod(0o700)  # whatever the umask: only this user may write it
        digest = hashlib.sha256(built.read_bytes()).hexdigest()[:32]
        return ctypes.CDLL(str(built.rename(folder / f"{key}-{digest}.so")))
