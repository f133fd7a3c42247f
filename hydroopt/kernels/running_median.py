"""Medians of a window that runs along a signal, by a network of comparisons at several places at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np

from hydroopt.kernels.shared_library import ADDRESS, COUNT, loaded, routine
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
    count = len(x)
    run = _compiled(width) if count >= FEW else None
    if run is None:
        return windowed_median(x, width)
    padded = np.empty(count + width + LANES)
    half = width // 2
    padded[:half], padded[half : half + count], padded[half + count :] = x[0], x, x[-1]
    made = np.empty(-(-count // LANES) * LANES)
    run(len(made), padded.ctypes.data, made.ctypes.data)
    return made[:count]


@cache
def _compiled(width: int) -> Callable[..., None] | None:
    own = [Path(__file__).with_suffix(end).read_bytes() for end in (".py", ".c")]
    library = loaded([str(width).encode(), *own], lambda: source(width), "the running median",
                     "SciPy computes it, more slowly")
    return None if library is None else routine(library, "running_median", COUNT, ADDRESS, ADDRESS)


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
