"""Integration of ẋ = f(x, w, parameters) over pieces of time, in C compiled with f.

Explicit steps by Dormand and Prince 5(4), whose size one piece leaves to the next, and implicit ones by RODAS 4(3)
where stiffness makes them cheaper (Hairer and Wanner 1996). Where a branch or a rounded corner takes another side
within an explicit step, its error is estimated apart. Without a compiler CVODES integrates on CasADi's virtual machine.
"""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property, partial

import casadi as ca
import numpy as np

from hydroopt.kernels import c_writer, native
from hydroopt.kernels import expression_graph as straight
from hydroopt.kernels.compiler import ADDRESS, COUNT, NUMBER, compiler, notice, reason, routine
from hydroopt.kernels.expression_graph import Node, Program, Ref
from hydroopt.spatial.inertia import Array


class IntegrationError(ArithmeticError):
    """No step succeeds any more; `pieces` is how many pieces did."""

    def __init__(self, pieces: int) -> None:
        super().__init__(f"the integration stops in piece {pieces}")
        self.pieces = pieces


class Integrator:
    """Integrates an autonomous system; remembers its step, and whether it is stiff, from call to call.

    Attributes:
        tolerance: relative error of a step; a hundredth of it, in units of `scale`, is admissible as well.
    """

    def __init__(self, function: ca.Function, parameters: Sequence[Array], scale: Array, *,
                 tolerance: float = 1e-7) -> None:
        """Prepare the integration of a function (x, w₁, w₂, …, parameters…) → ẋ.

        Args:
            function: the rates, without structural zeros; what it takes between x and the parameters are inputs, which
                change from piece to piece.
            parameters: values of its last arguments.
            scale: (nx,) typical size of each state.
            tolerance: relative error of a step.
        """
        self.function, self.tolerance = function, tolerance
        self._scale = np.ascontiguousarray(scale, dtype=float)
        self._parameters = [np.ascontiguousarray(part, dtype=float) for part in parameters]
        self._held = [function.numel_in(i) for i in range(1, function.n_in() - len(parameters))]
        self._x, self._w, self._seconds = np.zeros(len(scale)), np.zeros(sum(self._held)), np.zeros(1)
        self._memory = _memory(len(scale))(error=1e-4)
        self._compiled = self._load()

    def __call__(self, x: Array, seconds: float, *inputs: Array) -> Array:
        """x (nx,) after `seconds` of constant inputs.

        Raises:
            IntegrationError: no step succeeds.
        """
        np.concatenate(inputs, out=self._w)
        self._seconds[0], self._x[:] = seconds, x
        if self._compiled is None:
            return self._by_cvodes(x, self._seconds, self._w[None], None)[0]  # type: ignore[no-any-return]
        if not self._once():
            raise IntegrationError(0)
        return self._x.copy()

    def along(self, x: Array, seconds: Array, *inputs: Array, slopes: Sequence[Array] = ()) -> Array:
        """x (M, nx) behind each of M pieces of time.

        Args:
            x: (nx,) at the start.
            seconds: (M,) length of each piece.
            inputs: (M, k) each, in every piece.
            slopes: (M, k) each, by which inputs change within a piece [1/s]; none if they are constant.

        Raises:
            IntegrationError: no step succeeds.
        """
        return self._along(x, np.ascontiguousarray(seconds, dtype=float), np.ascontiguousarray(np.hstack(inputs)),
                           np.ascontiguousarray(np.hstack(slopes)) if slopes else None)

    @property
    def steps(self) -> int:
        """Number of steps up to now, those included that were refused."""
        return int(self._memory.steps)

    @property
    def stiff(self) -> bool:
        """Whether the last steps were implicit."""
        return bool(self._memory.implicit)

    def _along(self, x: Array, seconds: Array, w: Array, slopes: Array | None) -> Array:
        if self._compiled is None:
            return self._by_cvodes(x, seconds, w, slopes)
        states = np.empty((len(seconds), len(self._x)))
        self._x[:] = x
        done = self._compiled(len(seconds), seconds.ctypes.data, w.ctypes.data,
                              None if slopes is None else slopes.ctypes.data, *self._fixed, self._x.ctypes.data,
                              states.ctypes.data)
        if done < len(seconds):
            raise IntegrationError(done)
        return states

    def _load(self) -> Callable[..., int] | None:
        """The compiled integration; None where CVODES has to do the work."""
        found = compiler()
        if found is None or found.hangs:
            return None
        try:
            library = native.library(self.function, found, partial(source, parameters=len(self._parameters)),
                                     ("integrator.py", "integrator.c"), str(len(self._parameters)))
            run = routine(library, "along", ADDRESS, COUNT, *[ADDRESS] * 5, NUMBER, NUMBER, ADDRESS, ADDRESS,
                          result=COUNT)
        except (OSError, subprocess.SubprocessError, NotImplementedError) as error:
            notice(f"the integration of '{self.function.name()}' cannot be compiled ({reason(error)})")
            return None
        self._constants = np.zeros(library.constant_count())
        library.constants(*(ctypes.c_void_p(part.ctypes.data) for part in (*self._parameters, self._constants)))
        self._fixed = (self._constants.ctypes.data, self._scale.ctypes.data, self.tolerance, self.tolerance / 100)
        compiled = partial(run, ctypes.byref(self._memory))
        self._after = np.zeros(len(self._x))
        self._once = partial(compiled, 1, self._seconds.ctypes.data, self._w.ctypes.data, None, *self._fixed,
                             self._x.ctypes.data, self._after.ctypes.data)
        return compiled

    @cached_property
    def cvodes(self) -> ca.Function:
        """(states in units of their scale; inputs, their slopes and the length of a piece) → states behind it."""
        z, w, slopes = (ca.SX.sym(*each) for each in (("z", len(self._scale)), ("w", len(self._w)),
                                                      ("slopes", len(self._w))))
        seconds, t = ca.SX.sym("seconds"), ca.SX.sym("t")
        inputs = ca.vertsplit(w + t * seconds * slopes, np.cumsum([0, *self._held]).tolist())
        rates = seconds * self.function(z * self._scale, *inputs, *self._parameters) / self._scale
        return ca.integrator("plant", "cvodes", {"x": z, "p": ca.vertcat(w, slopes, seconds), "t": t, "ode": rates},
                             0.0, 1.0, {"reltol": self.tolerance, "abstol": self.tolerance / 100,
                                        "max_num_steps": 100000})

    def _by_cvodes(self, x: Array, seconds: Array, w: Array, slopes: Array | None) -> Array:
        states, z = np.empty((len(seconds), len(self._scale))), x / self._scale
        for k, piece in enumerate(seconds):
            change = np.zeros(w.shape[1]) if slopes is None else slopes[k]
            try:
                z = np.asarray(self.cvodes(x0=z, p=np.concatenate([w[k], change, [piece]]))["xf"]).ravel()
            except RuntimeError:
                raise IntegrationError(k) from None
            states[k] = z * self._scale
        return states


def _memory(size: int) -> type[ctypes.Structure]:
    """The structure `memory` of integrator.c."""
    class Memory(ctypes.Structure):
        _fields_ = [*((name, ctypes.c_double) for name in ("step", "error", "radius", "whole")),
                    ("direction", ctypes.c_double * size),
                    *((name, ctypes.c_long) for name in ("implicit", "suspicious", "calm", "steps", "refused"))]

    return Memory


def source(made: Program, *, parameters: int) -> str:
    """The integration's C; what the last inputs, the `parameters`, decide alone is computed once.

    The first output are the rates; a second one becomes a function `outputs` beside them.
    """
    count = len(made.inputs) - parameters
    (state, *held), fixed = made.inputs[:count], [given.name for given in made.inputs[count:]]
    before, rest = made.hoisted(fixed, "c")
    rest = _with_corners(rest, "c")
    offsets, size = {}, 0
    for given in held:
        offsets[given.name] = size
        size += given.size

    def place(name: str, k: int) -> str:
        return f"x[{k}]" if name == state.name else f"w[{offsets[name] + k}]" if name in offsets else f"{name}[{k}]"

    def lines(of: Program, target: str) -> list[str]:
        return c_writer.statements(of, c_writer.Naming(
            source=place, target=lambda _, k: f"{target}[{k}] = {{}};", call=lambda op: f"each_{op}"))

    return c_writer.rendered(
        "integrator.c", states=state.size, held=size, parameters=fixed, count=before.outputs[0].rows,
        unary=sorted({node.op for node in made.nodes} & straight.UNARY - {"inv", "sign", "fabs"}),
        constants=lines(before, "c"), computed=[(name, lines(rest.only([each.name]), "y")) for name, each in zip(
            ("rates", "outputs"), rest.outputs, strict=False)])


def _with_corners(made: Program, fixed: str) -> Program:
    """The same, in which each root √(a·x² + b), a rounded corner at x = 0, passes through an operation `corner` that
    takes x as well; a and b are constants, or of the input `fixed`."""
    def known(ref: Ref) -> bool:
        node = made.nodes[ref.node]
        return node.op == "constant" or (node.op == "input" and made.inputs[node.place[0]].name == fixed)

    def varying(node: Node, op: str) -> list[Ref]:
        return [ref for ref in node.operands if not known(ref)] if node.op == op else []

    def corner(root: Node) -> Ref | None:
        """x, where a node is such a root."""
        if root.op != "sqrt" or len(terms := varying(made.nodes[root.operands[0].node], "sum")) != 1:
            return None
        factors = varying(made.nodes[terms[0].node], "product")
        return factors[0] if len(factors) == 2 and factors[0] == factors[1] else None

    nodes: list[Node] = []
    place: list[int] = []

    def moved(refs: Iterable[Ref]) -> tuple[Ref, ...]:
        return tuple(ref._replace(node=place[ref.node]) for ref in refs)

    for node in made.nodes:
        nodes.append(node._replace(operands=moved(node.operands)))
        at = corner(node)
        if at is not None:
            nodes.append(Node("corner", (Ref(len(nodes) - 1), *moved([at]))))
        place.append(len(nodes) - 1)
    return made._replace(nodes=tuple(nodes), outputs=tuple(
        out._replace(entries=moved(out.entries)) for out in made.outputs))
