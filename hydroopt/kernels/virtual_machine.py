"""Functions on CasADi's virtual machine at one sample at a time."""

from __future__ import annotations

import casadi as ca
import numpy as np

from hydroopt.spatial.inertia import Array


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
