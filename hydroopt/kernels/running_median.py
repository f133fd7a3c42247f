"""Medians of a window that runs along a signal, by a network of comparisons at several places at once."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np

from hydroopt.kernels.shared_library import ADDRESS, COUNT, NUMBER, loaded, routine
from hydroopt.spatial.inertia import Array
from hydroopt.spectra import windowed_median

FEW = 2**14
"""Number of samples below which loading the compiled network does not pay."""
LANES = 8
"""As many windows are compared side by side at most."""


def running_median(x: Array, width: int) -> Array:
    """Medians (N,) of x (N,), finite, over an odd `width` of samples about each; the ends are repeated beyond them.

    >>> running_median(np.array([1.0, 1.0, 9.0, 2.0, 2.0]), 3).tolist()
    [1.0, 1.0, 2.0, 2.0, 2.0]
    """
    count, half = len(x), width // 2
    run = None if count < FEW or (library := _library(width)) is None else routine(
        library, "running_median", COUNT, ADDRESS, ADDRESS)
    if run is None:
        return windowed_median(x, width)
    x, made = np.ascontiguousarray(x, dtype=float), np.empty(count)
    inner = (count - width + 1) // LANES * LANES  # windows that reach beyond no end
    run(inner, x.ctypes.data, made[half:].ctypes.data)
    for first, end in ((0, half), (half + inner, count)):
        some = np.arange(first - half, end + half + LANES).clip(0, count - 1)
        beside, own = x[some], np.empty(end - first + LANES)
        run((end - first + LANES - 1) // LANES * LANES, beside.ctypes.data, own.ctypes.data)
        made[first:end] = own[: end - first]
    return made


def residuals(x: Array, width: int, share: float) -> tuple[Array, float, int]:
    """What x (N,), finite, is beyond its running median of `width`, (N,); the largest size of these residuals, and how
    many are at least this `share` of it.

    >>> off, worst, many = residuals(np.array([1.0, 1.0, 9.0, 2.0, 2.0]), 3, 0.5)
    >>> off.tolist(), worst, many
    ([0.0, 0.0, 7.0, 0.0, 0.0], 7.0, 1)
    """
    made = running_median(x, width)
    library = _library(width) if len(x) >= FEW else None
    if library is None:
        off = x - made
        size = np.abs(off)
        worst = float(size.max(initial=0.0))
        return off, worst, int(np.count_nonzero(size >= share * worst))
    x, most = np.ascontiguousarray(x, dtype=float), ctypes.c_double()
    count = routine(library, "residuals", COUNT, ADDRESS, ADDRESS, NUMBER, ADDRESS, result=COUNT)
    many = count(len(x), x.ctypes.data, made.ctypes.data, share, ctypes.addressof(most))
    return made, most.value, int(many)


@cache
def _library(width: int) -> ctypes.CDLL | None:
    own = [Path(__file__).with_suffix(end).read_bytes() for end in (".py", ".c")]
    return loaded([str(width).encode(), *own], lambda: source(width), "the running median",
                  "SciPy computes it, more slowly")


def source(width: int) -> str:
    """The C of windows of so many samples, an odd number."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415 (import cost)

    middle = width // 2
    needed, steps = {middle}, []
    for low, high in reversed([*_network(width)]):
        if needed & {low, high}:
            steps.append((low, high, low in needed, high in needed))
            needed |= {low, high}
    wires, lines = [f"x{k}" for k in range(width)], []
    for k, (low, high, least, most) in enumerate(reversed(steps)):
        both = f"({wires[low]}, {wires[high]})"
        if least:
            lines.append(f"const real a{k} = LEAST{both};")
            wires[low] = f"a{k}"
        if most:
            lines.append(f"const real b{k} = MOST{both};")
            wires[high] = f"b{k}"
    environment = Environment(loader=PackageLoader("hydroopt.kernels", "."), undefined=StrictUndefined,
                              trim_blocks=True, lstrip_blocks=True)
    return environment.get_template("running_median.c").render(width=width, lines=lines, median=wires[middle])


def _network(size: int) -> Iterator[tuple[int, int]]:
    """Pairs of places whose smaller number goes to the first, and which in this order sort so many numbers: Batcher's
    merge exchange (Knuth, The Art of Computer Programming 3, 5.2.2, Algorithm M)."""
    top = 1 << (size - 1).bit_length() >> 1
    step = top
    while step:
        other, rest, apart = top, 0, step
        while True:
            yield from ((i, i + apart) for i in range(size - apart) if i & step == rest)
            if other == step:
                break
            apart, other, rest = other - step, other // 2, step
        step //= 2
