"""Functions on CasADi's virtual machine: with fewer operations, and at one sample at a time."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from pathlib import Path

import casadi as ca
import numpy as np

from hydroopt.kernels.expression_graph import program
from hydroopt.spatial.inertia import Array
from hydroopt.support import cache

LONG = 200
"""Operations of a function below which it is not worth a file."""


def simplified(function: ca.Function) -> ca.Function:
    """The same function with few operations and dense outputs, from the cache or simplified now and kept there.

    To simplify one takes longer than to use it. What is kept stands under the hash of all that it depends on: the
    function, how it is simplified, CasADi.

    >>> x = ca.SX.sym("x")
    >>> simplified(ca.Function("twice", [x], [x * 3 + x * 3])).n_instructions()
    4
    """
    if function.n_instructions() < LONG:
        return program(function).function()
    key = hashlib.sha256()
    how = Path(__file__).with_name("expression_graph.py").read_bytes()
    for part in (function.serialize().encode(), how, ca.__version__.encode()):
        key.update(hashlib.sha256(part).digest())

    def simple(place: Path) -> Path:
        (place / "function").write_text(program(function).function().serialize())
        return place / "function"

    with suppress(OSError):
        return cache.kept("", key.hexdigest()[:32], ".function", simple,
                          lambda file: ca.Function.deserialize(file.read_text()))
    return program(function).function()


class OneSample:
    """A function of SX without the conversions that CasADi's own call makes; not for threads.

    Its arguments and results stand in memory of its own.

    >>> x = ca.SX.sym("x", 2)
    >>> OneSample(ca.Function("twice", [x], [2 * x]))([1.0, 2.0])[0]
    array([2., 4.])
    """

    def __init__(self, function: ca.Function) -> None:
        given = function.sx_in()
        dense = ca.Function(function.name(), given, [ca.densify(out) for out in function.call(given)])
        self._buffer, self._run = dense.buffer()
        # CasADi writes column by column
        self._arguments = [_room(dense.size_in(i)) for i in range(dense.n_in())]
        self._results = [_room(dense.size_out(i)) for i in range(dense.n_out())]
        for place, arrays in ((self._buffer.set_arg, self._arguments), (self._buffer.set_res, self._results)):
            for i, values in enumerate(arrays):
                if values.size:
                    place(i, memoryview(values.T.reshape(-1).data))

    def __call__(self, *arguments: Array) -> list[Array]:
        """Results, (n,) or (n, m), at arguments of these shapes or (n, 1)."""
        for place, values in zip(self._arguments, arguments, strict=True):
            # NumPy's reshape takes longer than the function itself
            place[...] = values if getattr(values, "shape", None) == place.shape else np.reshape(values, place.shape)
        self._run()
        return [values.copy() for values in self._results]


def _room(size: tuple[int, int]) -> Array:
    return np.zeros(size[0]) if size[1] == 1 else np.zeros(size, order="F")
