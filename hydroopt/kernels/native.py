"""Model functions over whole logs: native kernels of the same C that the controller gets, several samples in each step.

A kernel is compiled once with the system's compiler and kept under the hash of all that it depends on. Without a
compiler CasADi's virtual machine does the same work.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from threading import Lock

import casadi as ca
import numpy as np

from hydroopt.kernels import c_writer
from hydroopt.kernels import expression_graph as straight
from hydroopt.kernels.compiler import ADDRESS, COUNT, Compiler, built, compiler, notice, reason, routine
from hydroopt.kernels.expression_graph import Program, program
from hydroopt.spatial.inertia import Array

FEW = 256
"""Number of samples below which compiling a kernel does not pay."""
SHARE = 4096
"""Number of samples per thread."""
LANES = 8
"""Doubles in a cache line: as many samples as a kernel computes side by side at most."""
MUCH = 16
"""Operations for each result from which on it does not matter whether results are written past the caches."""
LONG, PIECE = 300_000, 2000
"""Characters of C from which on code is long, and statements of it that a compiler takes at a time, whose time grows
faster than their number."""
CACHED, RECYCLED = 2**20, 2**25
"""Bytes of results above which they are written past the caches, and above which memory is always fresh, thus zero."""


Way = Callable[[list[Array], int, list[Array] | None], list[Array]]
"""How a function is evaluated: from its arguments, the number of samples and earlier results to be written over."""


class Runner:
    """Evaluates functions at many samples; remembers how, for as long as it lives."""

    def __init__(self) -> None:
        self._ways: dict[tuple[int, bool], tuple[ca.Function, Way]] = {}
        self._lock = Lock()  # CasADi's expressions are not made for threads

    def over(self, function: ca.Function, *columns: Array, out: list[Array] | None = None) -> list[Array]:
        """Evaluate at N samples: each argument (N, k), or (k,) if it is the same for all; results (N, rows, columns).

        Results of many samples stand in memory entry by entry, samples side by side: a column over all samples is one
        piece. `out` holds what an earlier call with as many samples gave, to be written over: fresh memory costs more
        than most functions.

        Raises:
            ValueError: arguments or `out` have not the shapes that the function calls for.
        """
        held = [np.ascontiguousarray(column, dtype=float) for column in columns]
        count = next((len(values) for values in held if values.ndim == 2), 0)
        wanted = [(count, function.numel_in(i)) for i in range(function.n_in())]
        if [values.shape if values.ndim == 2 else (count, *values.shape) for values in held] != wanted:
            raise ValueError(f"{function.name()} takes arguments of the shapes {wanted}, not "
                             f"{[values.shape for values in held]}")
        shapes = [(count, *function.size_out(i)) for i in range(function.n_out())]
        if out is not None and ([values.shape for values in out] != shapes or not all(
                values.dtype == float and values.flags.writeable for values in out)):
            raise ValueError(f"{function.name()} writes over arrays of float64 of the shapes {shapes}")
        if not count:
            return [np.zeros(shape) for shape in shapes]
        return self._way(function, count)(held, count, out)

    def _way(self, function: ca.Function, count: int) -> Way:
        key = hash(function), count >= FEW
        with self._lock:
            if key not in self._ways:
                way = kernel(function) if count >= FEW else None
                self._ways[key] = function, way or _mapped(function)  # holding the function keeps its hash its own
            return self._ways[key][1]


def _mapped(function: ca.Function) -> Way:
    """The same on CasADi's virtual machine."""
    symbols = function.sx_in()
    dense = ca.Function(function.name(), symbols, [ca.densify(out) for out in function.call(symbols)])
    mapped: tuple[int, ca.Function] = (0, dense)
    lock = Lock()  # the buffer's memory is one

    def evaluate(columns: list[Array], count: int, out: list[Array] | None) -> list[Array]:
        with lock:
            return alone(columns, count, out)

    def alone(columns: list[Array], count: int, out: list[Array] | None) -> list[Array]:
        nonlocal mapped
        if mapped[0] != count:
            mapped = count, dense.map(count)
        buffer, run = mapped[1].buffer()
        held = [np.ascontiguousarray(np.broadcast_to(c, (count, c.shape[-1]))) for c in columns]
        results = [np.empty((count, function.size2_out(i), function.size1_out(i))) for i in range(function.n_out())]
        for give, arrays in ((buffer.set_arg, held), (buffer.set_res, results)):
            for i, values in enumerate(arrays):
                if values.size:
                    give(i, memoryview(values.data).cast("B").cast("d"))
        run()
        # CasADi writes column by column
        made = [np.ascontiguousarray(values.swapaxes(1, 2)) for values in results]
        return made if out is None else _copied(made, out)

    return evaluate


class Kernel:
    """A compiled function."""

    def __init__(self, library: ctypes.CDLL, function: ca.Function) -> None:
        self._shapes = [function.size_out(i) for i in range(function.n_out())]
        self._run = routine(library, "over", COUNT, *[ADDRESS] * 4, COUNT, COUNT)

    def __call__(self, columns: list[Array], count: int, out: list[Array] | None = None) -> list[Array]:
        """Results (N, rows, columns) of arguments (N, k) or (k,)."""
        if out is not None and all(map(_by_entry, out)):
            results, whole = out, False
        else:
            made = [room(count, shape) for shape in self._shapes]
            results, whole = [values for values, _ in made], not all(zero for _, zero in made)
        parts = min(threads(), -(-count // SHARE))
        edges = [LANES * (count * k // parts // LANES) for k in range(parts)] + [count]
        if parts == 1:
            self._part(columns, results, whole, 0, count)
        else:
            with ThreadPoolExecutor(parts) as pool:  # the library's call releases Python's lock
                list(pool.map(partial(self._part, columns, results, whole), edges[:-1], edges[1:]))
        return results if out is None else _copied(results, out)

    def _part(self, columns: list[Array], results: list[Array], whole: bool, first: int, last: int) -> None:
        strides = [c.shape[1] if c.ndim == 2 else 0 for c in columns]
        into = [c.ctypes.data + first * step * c.itemsize for c, step in zip(columns, strides, strict=True)]
        out_of = [values.ctypes.data + first * values.itemsize for values in results]
        steps = [values.strides[2] // values.itemsize for values in results]
        past = sum(values.nbytes for values in results) > CACHED
        self._run(last - first, (ctypes.c_void_p * len(into))(*into), (ctypes.c_long * len(strides))(*strides),
                  (ctypes.c_void_p * len(out_of))(*out_of), (ctypes.c_long * len(steps))(*steps), past, whole)


def room(count: int, shape: tuple[int, int]) -> tuple[Array, bool]:
    """Memory for results (N, rows, columns), entry by entry, samples side by side; and whether it is zero.

    Entries begin at multiples of a cache line, of which the number between them is odd: powers of two would map all
    entries to a few places in the caches.
    """
    rows, columns = shape
    step = (-(-count // LANES) | 1) * LANES
    size = rows * columns * step + LANES
    fresh = size * 8 > RECYCLED
    flat = np.zeros(size) if fresh else np.empty(size)
    first = -(flat.ctypes.data // flat.itemsize) % LANES
    whole = flat[first : first + rows * columns * step].reshape(rows, columns, step)
    return whole[:, :, :count].transpose(2, 0, 1), fresh


def _by_entry(values: Array) -> bool:
    """Whether results stand in memory as `room` has them."""
    step, line = values.strides[2], LANES * values.itemsize
    return (values.strides == (values.itemsize, values.shape[2] * step, step)
            and step % line == 0 and values.ctypes.data % line == 0)


def _copied(made: list[Array], out: list[Array]) -> list[Array]:
    """What was made, in the memory of earlier results."""
    for old, new in zip(out, made, strict=True):
        if old is not new:
            old[:] = new
    return out


def threads() -> int:
    """As many as OMP_NUM_THREADS says, or as there are processors for this process."""
    stated = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0].strip()
    if stated.isdigit() and int(stated):
        return int(stated)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def kernel(function: ca.Function) -> Kernel | None:
    """The kernel of a function from the cache, or compiled now; None where CasADi has to do the work."""
    found = compiler()
    if found is None or found.hangs or not function.is_a("SXFunction"):
        return None
    try:
        return Kernel(library(function, found, source, ("native.py", "kernel.c")), function)
    except (OSError, subprocess.SubprocessError, NotImplementedError) as error:
        notice(f"the kernel '{function.name()}' cannot be compiled ({reason(error)})")
        return None


def library(function: ca.Function, by: Compiler, write: Callable[[Program], str], own: Sequence[str],
            options: str = "") -> ctypes.CDLL:
    """The shared library from the cache, or compiled now and kept there, or compiled for this process alone.

    Args:
        function: what is compiled.
        by: the compiler.
        write: writes the C; what it depends on are the program of `function`, `options` and the files `own`.
        own: names of files in this folder.
        options: of `write`.

    Raises:
        OSError, subprocess.SubprocessError: it cannot be compiled or loaded.
        NotImplementedError: the function has no C counterpart.
    """
    here = Path(__file__).parent
    read = [(here / name).read_bytes() for name in ("expression_graph.py", "c_writer.py", *own)]
    return built([function.serialize().encode(), *read, options.encode()], by, lambda: write(program(function)))


def source(made: Program) -> str:
    """The kernel's C: a few samples side by side in each value, as many as the processor's registers hold."""
    written = [[made.number(ref) != 0.0 for ref in out.entries] for out in made.outputs]
    given = {each.name: k for k, each in enumerate(made.inputs)}
    place = {out.name: k for k, out in enumerate(made.outputs)}
    lines = c_writer.statements(made, c_writer.Naming(
        source=lambda name, k: f"x{given[name]}[{k}]",
        target=lambda name, k: (f"PUT(y{place[name]} + {k} * step{place[name]}, {{}});" if written[place[name]][k]
                                else None),
        type="real", call=lambda op: f"each_{op}", lift=lambda text: f"((real){{0}} + {text})"))
    long = sum(map(len, lines)) > LONG
    results = sum(map(sum, written))
    pieces, passed = c_writer.in_pieces(lines, PIECE if long else len(lines) or 1)
    return c_writer.rendered(
        "kernel.c",
        # code that computes much for each result takes as long wherever these go
        ways=("here",) if long or MUCH * results < len(made.nodes) else ("here", "past"), pieces=pieces, passed=passed,
        unary=sorted({node.op for node in made.nodes} & straight.UNARY - {"inv", "sign"}),
        inputs=made.inputs, outputs=made.outputs, runs=[_runs(mask, of=True) for mask in written],
        gaps=[_runs(mask, of=False) for mask in written])


def _runs(mask: Sequence[bool], *, of: bool) -> list[tuple[int, int]]:
    """First and end of the places in a row where a mask is true, or false."""
    edges = np.flatnonzero(np.diff(np.array(mask) == of, prepend=False, append=False)).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))
