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

    def function(self, sign: Callable[[ca.SX, Sequence[ca.SX]], ca.SX] | None = None) -> ca.Function:
        """The same as a casadi.Function with dense outputs, if need be with another function for the sign of a value,
        which also receives the inputs."""
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
                    values.append(ca.sign(operands[0]) if sign is None else sign(operands[0], given))
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
    slots = [0] * function.sz_w()
    found: list[dict[int, int]] = [{} for _ in range(function.n_out())]
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
        entries = tuple(made.refs[values[at[r, c]] if (r, c) in at else made.constant(0.0)]
                        for r in range(rows) for c in range(columns))
        outputs.append(Output(function.name_out(i), rows, columns, entries))
    return _ordered(function.name(), inputs, outputs, made.nodes)


class _Maker:
    """Makes nodes, each only once.

    A value is here the place k of its node, its negative is ~k.
    """

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self.numbers: list[float | None] = []
        """Values of constants; None of what varies."""
        self.known: dict[tuple[str, tuple[int, ...], float, tuple[int, int]], int] = {}
        self.factors: dict[int, tuple[int, ...]] = {}
        self.products: dict[tuple[int, ...], int] = {}
        self.refs = _Refs()

    def node(self, op: str, operands: tuple[int, ...] = (), value: float = 0.0, place: tuple[int, int] = (0, 0)) -> int:
        key = op, operands, value, place
        found = self.known.get(key)
        if found is None:
            self.known[key] = found = len(self.nodes)
            self.nodes.append(Node(op, tuple([self.refs[k] for k in operands]), value, place))
            self.numbers.append(value if op == "constant" else None)
        return found

    def constant(self, value: float) -> int:
        if math.isnan(value):
            raise NotImplementedError("a constant is not a number")
        k = self.node("constant", value=abs(value))
        return ~k if value < 0 else k

    def number(self, k: int) -> float | None:
        if k >= 0:
            return self.numbers[k]
        value = self.numbers[~k]
        return None if value is None else -value

    def apply(self, op: str, operands: list[int]) -> int:
        a = operands[0]
        b = operands[-1]
        match op:
            case "mul":
                return self.product(a, b)
            case "add":
                return self.sum((a, b))
            case "sub":
                return self.sum((a, ~b))
            case "div":
                return self.product(a, self.inverse(b))
            case "neg":
                return ~a
            case "sq":
                return self.product(a, a)
            case "twice":
                return self.product(a, self.constant(2.0))
            case "inv":
                return self.inverse(a)
            case "hypot":
                return self.apply("sqrt", [self.sum((self.product(a, a), self.product(b, b)))])
            case "constpow" | "pow" if b < 0 and self.number(b) is not None:
                return self.inverse(self.apply("pow", [a, ~b]))
            case "constpow":
                op = "pow"
        if op not in UNARY | BINARY or (op == "pow" and self.number(b) is None):
            raise NotImplementedError(f"the operation '{op}' has no C counterpart here")
        if op in ("sin", "cos") and (turn := self.vector_angle(a)) is not None:
            return self.of_sum(op, *turn)
        if op in EVEN:
            return self.node(op, (_node(a),))
        if op in ODD:
            k = self.node(op, (_node(a),))
            return ~k if a < 0 else k
        # a negative operand becomes a value of its own
        return self.node(op, tuple([self.node("negative", (~k,)) if k < 0 else k for k in operands]))

    def vector_angle(self, angle: int) -> tuple[int, int] | None:
        """An angle as that of a vector and what is added to it; None if no term of it is one."""
        node = self.nodes[_node(angle)]
        terms = [~ref.node if ref.negative else ref.node for ref in node.operands] if node.op == "sum" else [
            _node(angle)]
        own = next((term for term in terms if self.nodes[_node(term)].op == "atan2"), None)
        if own is None:
            return None
        rest = self.sum([term for term in terms if term != own])
        return (~own, ~rest) if angle < 0 else (own, rest)

    def of_sum(self, op: str, own: int, rest: int) -> int:
        """Sine or cosine of a vector's angle and another one, without the angle of the vector."""
        y, x = (ref.node for ref in self.nodes[_node(own)].operands)
        unit = self.inverse(self.apply("sqrt", [self.sum((self.product(x, x), self.product(y, y)))]))
        cosine, sine = self.product(x, unit), self.product(~y if own < 0 else y, unit)
        value = self.number(rest)
        along, across = ((self.apply("cos", [rest]), self.apply("sin", [rest])) if value is None else
                         (self.constant(math.cos(value)), self.constant(math.sin(value))))
        if op == "cos":
            return self.sum((self.product(cosine, along), ~self.product(sine, across)))
        return self.sum((self.product(sine, along), self.product(cosine, across)))

    def inverse(self, k: int) -> int:
        value = self.number(k)
        if value is not None:
            return self.constant(1 / value if value else math.inf)
        made = self.node("inv", (_node(k),))
        return ~made if k < 0 else made

    def product(self, a: int, b: int) -> int:
        negative = (a < 0) != (b < 0)
        a, b = sorted((_node(a), _node(b)))
        others = [k for k in (a, b) if self.numbers[k] is None]
        if len(others) < 2:
            value = math.prod(v for k in (a, b) if (v := self.numbers[k]) is not None)
            if value == 0.0:
                return self.constant(0.0)
            if value != 1.0 or not others:
                others.insert(0, self.constant(value))
        made: int | None
        if len(others) == 1:
            made = others[0]
        else:
            # however it is bracketed, a product of the same factors is the same value
            whole = [factor for k in others for factor in self.factors.get(k, (k,))]
            key = tuple(sorted(whole)) if len(whole) <= FACTORS else ()
            made = self.products.get(key)
            if made is None:
                made = self.node("product", tuple(others))
                if key:
                    self.products[key] = made
                    self.factors[made] = key
        return ~made if negative else made

    def sum(self, terms: Iterable[int]) -> int:
        constants: list[float] = []
        count: dict[int, int] = {}
        for term in terms:
            node = term if term >= 0 else ~term
            if (value := self.numbers[node]) is None:
                count[node] = count.get(node, 0) + (1 if term >= 0 else -1)
            else:
                constants.append(value if term >= 0 else -value)
        value = math.fsum(constants)
        others: list[int] = []
        for node in sorted(count):
            if times := count[node]:
                one = node if abs(times) == 1 else self.product(node, self.constant(float(abs(times))))
                others.append(one if times > 0 else ~one)
        if value != 0.0 or not others:
            others.append(self.constant(value))
        if len(others) == 1:
            return others[0]
        # a sum and its negative are one value
        if others[0] < 0:
            return ~self.node("sum", tuple([~k for k in others]))
        return self.node("sum", tuple(others))


class _Refs(dict[int, Ref]):
    """References to places k, and of ~k to their negatives, each made once: programs have hundreds of thousands."""

    def __missing__(self, k: int) -> Ref:
        self[k] = made = Ref(k) if k >= 0 else Ref(~k, negative=True)
        return made


def _node(k: int) -> int:
    """The place of a value or of its negative."""
    return k if k >= 0 else ~k


def _ordered(name: str, inputs: tuple[Input, ...], outputs: list[Output], made: Sequence[Node]) -> Program:
    """Only what the outputs need, each value right before its first use."""
    place = [-1] * len(made)
    nodes: list[Node] = []
    refs = _Refs()
    for root in (ref.node for output in outputs for column in range(output.columns)
                 for ref in output.entries[column::output.columns]):
        stack = [root]
        while stack:
            index = stack.pop()
            ready, index = index < 0, _node(index)
            if place[index] >= 0:
                continue
            node = made[index]
            if not node.operands:
                place[index] = len(nodes)
                nodes.append(node)
            elif ready:
                place[index] = len(nodes)
                nodes.append(Node(node.op, tuple([refs[~place[k] if negative else place[k]]
                                                  for k, negative in node.operands]), node.value, node.place))
            else:
                stack.append(~index)
                stack += [k for k, _ in reversed(node.operands) if place[k] < 0]
    return Program(name, inputs, tuple(
        out._replace(entries=tuple([refs[~place[k] if negative else place[k]] for k, negative in out.entries]))
        for out in outputs), tuple(nodes))
