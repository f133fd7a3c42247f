"""Functions with fewer operations, kept beside the compiled kernels: to simplify one takes longer than to use it."""

from __future__ import annotations

import hashlib
from pathlib import Path

import casadi as ca

from hydroopt import cache
from hydroopt.kernels.expression_graph import program

LONG = 200
"""Operations of a function below which it is not worth a file."""


def simplified(function: ca.Function) -> ca.Function:
    """The same function with few operations and dense outputs, from the cache or simplified now and kept there.

    What is kept stands under the hash of all that it depends on: the function, how it is simplified, CasADi.

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
    name = f"{key.hexdigest()[:32]}.function"
    kept = cache.kept(name)
    if kept is not None:
        return ca.Function.deserialize(kept.decode())
    made = program(function).function()
    cache.keep(name, made.serialize().encode())
    return made
