"""A casadi.Function as a straight-line program: each value computed once, in the fewest operations found.

CasADi's own code keeps the order and the sharing in which expressions were written. Here every operation is looked up
before it is made, whatever the order or the signs of its operands, and quotients become products with a shared
reciprocal, sine and cosine of an angle found by atan2 with the vector itself. That changes rounding, what overflows on
the way to a finite result, and where this vector vanishes, which has no direction: there it is no number; nothing else.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import casadi as ca

_NAMES = {value: name[3:].lower() for name, value in vars(ca).items() if name.startswith("OP_")}
ODD = frozenset({"sin", "tan", "asin", "atan", "tanh", "sign"})
EVEN = frozenset({"cos", "fabs"})
UNARY = ODD | EVEN | {"sqrt", "acos", "exp", "log", "inv", "floor"}
FACTORS = 12
"""Up to how many factors two products are compared."""
BINARY = frozenset({"atan2", "pow", "fmin", "fmax"})


class Ref(NamedTuple):
    """A value or its negative: place in `Program.nodes` and sign."""

    node: int
    negative: bool = False

    def __neg__(self) -> Ref:
        return Ref(self.node, not self.negative)


class Node(NamedTuple):
    """One operation: its name, operands, and for a constant its value, for an input its place.

    ``sum`` and ``product`` take any number of operands; all operands but those of a sum are positive.
    """

    op: str
    operands: tuple[Ref, ...] = ()
    value: float = 0.0
    place: tuple[int, int] = (0, 0)


class Output(NamedTuple):
    """A matrix that the program computes: its entries row by row."""

    name: str
    rows: int
    columns: int
    entries: tuple[Ref, ...]


class Input(NamedTuple):
    """A vector that the program takes."""

    name: str
    size: int


class Program(NamedTuple):
    """Operations in an order in which they can be carried out, with inputs and outputs."""

    name: str
    inputs: tuple[Input, ...]
    outputs: tuple[Output, ...]
    nodes: tuple[Node, ...]

    def only(self, names: Iterable[str]) -> Program:
        """The part that computes some of the outputs, in the order given."""
        by_name = {out.name: out for out in self.outputs}
        return _ordered(self.name, self.inputs, [by_name[name] for name in names], self.nodes)

    def hoisted(self, fixed: Iterable[str], name: str) -> tuple[Program, Program]:
        """What some inputs alone decide, as a program of its own, and the rest, which takes its result.

        Returns:
            A program with one output `name` (k, 1), and this one with one more input `name` (k,).
        """
        known = set(fixed)
        alone: list[bool] = []
        for node in self.nodes:
            free = node.op == "input" and self.inputs[node.place[0]].name not in known
            alone.append(not free and all(alone[ref.node] for ref in node.operands))
        needed = [ref.node for out in self.outputs for ref in out.entries]
        needed += [r.node for k, node in enumerate(self.nodes) if not alone[k] for r in node.operands]
        edge = [k for k in dict.fromkeys(needed) if alone[k] and self.nodes[k].op != "constant"]
        last = len(self.inputs)
        place = {k: n for n, k in enumerate(edge)}
        rest = [Node("input", place=(last, place[k])) if k in place else node for k, node in enumerate(self.nodes)]
        before = Output(name, len(edge), 1, tuple(Ref(k) for k in edge))
        return (_ordered(name, self.inputs, [before], self.nodes),
                _ordered(self.name, (*self.inputs, Input(name, len(edge))), list(self.outputs), rest))

    def function(self, sign: Callable[[ca.SX], ca.SX] = ca.sign) -> ca.Function:
        """The same as a casadi.Function with dense outputs, if need be with another function for the sign."""
        given = [ca.SX.sym(each.name, each.size) for each in self.inputs]
        values: list[ca.SX] = []

        def of(ref: Ref) -> ca.SX:
            return -values[ref.node] if ref.negative else values[ref.node]

        for node in self.nodes:
            operands = [of(ref) for ref in node.operands]
            match node.op:
                case "input":
                    values.append(given[node.place[0]][node.place[1]])
                case "constant":
                    values.append(ca.SX(node.value))
                case "inv":
                    values.append(1 / operands[0])
                case "negative":
                    values.append(-operands[0])
                case "sum":
                    values.append(sum(operands[1:], operands[0]))
                case "product":
                    values.append(math.prod(operands[1:], start=operands[0]))
                case "pow":
                    values.append(operands[0] ** operands[1])
                case "sign":
                    values.append(sign(operands[0]))
                case _:
                    values.append(getattr(ca, node.op)(*operands))
        results = [ca.reshape(ca.vertcat(*map(of, out.entries)), out.columns, out.rows).T for out in self.outputs]
        return ca.Function(self.name, given, results, [each.name for each in self.inputs],
                           [out.name for out in self.outputs])

    def number(self, ref: Ref) -> float | None:
        """The value of a constant; None if the value varies."""
        node = self.nodes[ref.node]
        return (-node.value if ref.negative else node.value) if node.op == "constant" else None

    @property
    def operations(self) -> Counter[str]:
        """How many operations of each kind it takes: ``add``, ``multiply``, ``divide``, ``sqrt``, ``sin``, …"""
        count: Counter[str] = Counter()
        for node in self.nodes:
            if node.op in ("sum", "product"):
                count["add" if node.op == "sum" else "multiply"] += len(node.operands) - 1
            elif node.op not in ("constant", "input"):
                count["divide" if node.op == "inv" else node.op] += 1
        return count


def program(function: ca.Function) -> Program:
    """The program of a casadi.Function of SX with dense inputs, its outputs row by row.

    Raises:
        NotImplementedError: an operation that no model of a machine needs, or an input with structural zeros.
    """
    if not all(function.sparsity_in(i).is_dense() for i in range(function.n_in())):
        raise NotImplementedError("an input has structural zeros")
    made = _Maker()
    slots: dict[int, Ref] = {}
    found: list[dict[int, Ref]] = [{} for _ in range(function.n_out())]
    for k in range(function.n_instructions()):
        op, into, out_of = (function.instruction_id(k), function.instruction_output(k), function.instruction_input(k))
        if op == ca.OP_INPUT:
            slots[into[0]] = made.node("input", place=(out_of[0], out_of[1]))
        elif op == ca.OP_OUTPUT:
            found[into[0]][into[1]] = slots[out_of[0]]
        elif op == ca.OP_CONST:
            slots[into[0]] = made.constant(function.instruction_constant(k))
        else:
            slots[into[0]] = made.apply(_NAMES[op], [slots[i] for i in out_of])
    inputs = tuple(Input(function.name_in(i), function.numel_in(i)) for i in range(function.n_in()))
    outputs = []
    for i, values in enumerate(found):
        rows, columns = function.size_out(i)
        at = {place: n for n, place in enumerate(zip(*function.sparsity_out(i).get_triplet(), strict=True))}
        entries = tuple(values[at[r, c]] if (r, c) in at else made.constant(0.0)
                        for r in range(rows) for c in range(columns))
        outputs.append(Output(function.name_out(i), rows, columns, entries))
    return _ordered(function.name(), inputs, outputs, made.nodes)


class _Maker:
    """Makes nodes, each only once."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self.known: dict[Node, int] = {}
        self.factors: dict[int, tuple[int, ...]] = {}
        self.products: dict[tuple[int, ...], Ref] = {}

    def node(self, op: str, operands: tuple[Ref, ...] = (), value: float = 0.0, place: tuple[int, int] = (0, 0)) -> Ref:
        node = Node(op, operands, value, place)
        if node not in self.known:
            self.known[node] = len(self.nodes)
            self.nodes.append(node)
        return Ref(self.known[node])

    def constant(self, value: float) -> Ref:
        if math.isnan(value):
            raise NotImplementedError("a constant is not a number")
        ref = self.node("constant", value=abs(value))
        return -ref if value < 0 else ref

    def number(self, ref: Ref) -> float | None:
        node = self.nodes[ref.node]
        return (-node.value if ref.negative else node.value) if node.op == "constant" else None

    def apply(self, op: str, operands: list[Ref]) -> Ref:
        a = operands[0]
        b = operands[-1]
        match op:
            case "add":
                return self.sum((a, b))
            case "sub":
                return self.sum((a, -b))
            case "mul":
                return self.product((a, b))
            case "div":
                return self.product((a, self.inverse(b)))
            case "neg":
                return -a
            case "sq":
                return self.product((a, a))
            case "twice":
                return self.product((a, self.constant(2.0)))
            case "inv":
                return self.inverse(a)
            case "hypot":
                return self.apply("sqrt", [self.sum((self.product((a, a)), self.product((b, b))))])
            case "constpow" | "pow" if b.negative and self.number(b) is not None:
                return self.inverse(self.apply("pow", [a, -b]))
            case "constpow":
                op = "pow"
        if op not in UNARY | BINARY or (op == "pow" and self.number(b) is None):
            raise NotImplementedError(f"the operation '{op}' has no C counterpart here")
        if op in ("sin", "cos") and (turn := self.vector_angle(a)) is not None:
            return self.of_sum(op, *turn)
        if op in EVEN:
            return self.node(op, (Ref(a.node),))
        if op in ODD:
            ref = self.node(op, (Ref(a.node),))
            return -ref if a.negative else ref
        return self.positive(op, operands)

    def vector_angle(self, angle: Ref) -> tuple[Ref, Ref] | None:
        """An angle as that of a vector and what is added to it; None if no term of it is one."""
        node = self.nodes[angle.node]
        terms = node.operands if node.op == "sum" else (Ref(angle.node),)
        own = next((term for term in terms if self.nodes[term.node].op == "atan2"), None)
        if own is None:
            return None
        rest = self.sum(term for term in terms if term != own)
        return (-own, -rest) if angle.negative else (own, rest)

    def of_sum(self, op: str, own: Ref, rest: Ref) -> Ref:
        """Sine or cosine of a vector's angle and another one, without the angle of the vector."""
        y, x = self.nodes[own.node].operands
        unit = self.inverse(self.apply("sqrt", [self.sum((self.product((x, x)), self.product((y, y))))]))
        cosine, sine = self.product((x, unit)), self.product((-y if own.negative else y, unit))
        value = self.number(rest)
        along, across = ((self.apply("cos", [rest]), self.apply("sin", [rest])) if value is None else
                         (self.constant(math.cos(value)), self.constant(math.sin(value))))
        if op == "cos":
            return self.sum((self.product((cosine, along)), -self.product((sine, across))))
        return self.sum((self.product((sine, along)), self.product((cosine, across))))

    def positive(self, op: str, operands: list[Ref]) -> Ref:
        # a negative operand becomes a value of its own
        return self.node(op, tuple(self.node("negative", (Ref(r.node),)) if r.negative else r for r in operands))

    def inverse(self, ref: Ref) -> Ref:
        value = self.number(ref)
        if value is not None:
            return self.constant(1 / value if value else math.inf)
        node = self.node("inv", (Ref(ref.node),))
        return -node if ref.negative else node

    def product(self, factors: Iterable[Ref]) -> Ref:
        factors = tuple(factors)
        negative = sum(f.negative for f in factors) % 2 == 1
        value = math.prod(v for f in factors if (v := self.number(Ref(f.node))) is not None)
        others = sorted(Ref(f.node) for f in factors if self.number(f) is None)
        if value == 0.0:
            return self.constant(0.0)
        if value != 1.0 or not others:
            others.insert(0, self.constant(value))
        # however it is bracketed, a product of the same factors is the same value
        whole = tuple(sorted(single for ref in others for single in self.factors.get(ref.node, (ref.node,))))
        if len(others) == 1:
            ref = others[0]
        elif whole in self.products:
            ref = self.products[whole]
        else:
            ref = self.node("product", tuple(others))
            if len(whole) <= FACTORS:
                self.products[whole] = ref
                self.factors[ref.node] = whole
        return -ref if negative else ref

    def sum(self, terms: Iterable[Ref]) -> Ref:
        terms = tuple(terms)
        value = math.fsum(v for t in terms if (v := self.number(t)) is not None)
        count: Counter[int] = Counter()
        for term in terms:
            if self.number(term) is None:
                count[term.node] += -1 if term.negative else 1
        others: list[Ref] = []
        for node, times in sorted(count.items()):
            one = Ref(node) if abs(times) == 1 else self.product((Ref(node), self.constant(float(abs(times)))))
            others += [-one if times < 0 else one] if times else []
        if value != 0.0 or not others:
            others.append(self.constant(value))
        if len(others) == 1:
            return others[0]
        # a sum and its negative are one value
        if others[0].negative:
            return -self.node("sum", tuple(-r for r in others))
        return self.node("sum", tuple(others))


def _ordered(name: str, inputs: tuple[Input, ...], outputs: list[Output], made: Sequence[Node]) -> Program:
    """Only what the outputs need, each value right before its first use."""
    place: dict[int, int] = {}
    nodes: list[Node] = []
    for root in (ref.node for output in outputs for column in range(output.columns)
                 for ref in output.entries[column::output.columns]):
        stack = [(root, False)]
        while stack:
            index, ready = stack.pop()
            if index in place:
                continue
            node = made[index]
            if ready:
                place[index] = len(nodes)
                nodes.append(Node(node.op, tuple([Ref(place[r.node], r.negative) for r in node.operands]), node.value,
                                  node.place) if node.operands else node)
            else:
                stack.append((index, True))
                stack += [(ref.node, False) for ref in reversed(node.operands)]
    return Program(name, inputs, tuple(
        out._replace(entries=tuple(Ref(place[r.node], r.negative) for r in out.entries)) for out in outputs),
        tuple(nodes))
