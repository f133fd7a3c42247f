"""C statements of a `Program`: what the controller's code and the kernels in this process have in common."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from hydroopt.kernels.expression_graph import Program, Ref

WIDTH = 100
"""Characters up to which an expression takes in the ones it is made of."""
_CALL = re.compile(r"= (sin|cos)f?\(")


class Naming(NamedTuple):
    """What a program's values are called in C.

    `source` gives the C expression of an element of an input; `target` the statement about the k-th entry of an output,
    with {} for its value, or None if there is none. `call` names the function of an operation, `lift` makes of a number
    what it takes.
    """

    source: Callable[[str, int], str]
    target: Callable[[str, int], str | None]
    type: str = "double"
    single: bool = False
    call: Callable[[str], str] = str
    lift: Callable[[str], str] = str


def literal(value: float, *, single: bool = False) -> str:
    """A number that reads back as the same double, or with nine significant digits as the same float."""
    text = f"{value:.9g}" if single else repr(float(value))
    if math.isinf(value):
        return "HUGE_VALF" if single else "HUGE_VAL"
    if not any(mark in text for mark in ".e"):
        text += ".0"
    return text + ("f" if single else "")


def statements(program: Program, naming: Naming) -> list[str]:
    """One statement a line: values that serve several others first, then every entry of every output."""
    return _Writer(program, naming).lines


def rendered(template: str, **values: Any) -> str:
    """C by a template in this folder."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415 — only where something is compiled

    return Environment(loader=PackageLoader("hydroopt.kernels", "."), undefined=StrictUndefined, trim_blocks=True,
                       lstrip_blocks=True).get_template(template).render(**values)


class Pieces(NamedTuple):
    """Statements in pieces that a compiler can take one by one, and how many values pass between them."""

    pieces: list[list[str]]
    passed: int


def in_pieces(lines: Sequence[str], size: int) -> Pieces:
    """Statements in pieces of a `size`: what a later piece needs stands in an array ``passed`` instead of a name.

    >>> in_pieces(["const double v0 = 2 * x[0];", "const double v1 = v0 * v0;", "y[0] = v0 + v1;"], 2).pieces
    [['passed[0] = 2 * x[0];', 'passed[1] = passed[0] * passed[0];'], ['y[0] = passed[0] + passed[1];']]
    """
    at = {name: k // size for k, line in enumerate(lines) if (name := defined(line))}
    across: dict[str, str] = {}
    for k, line in enumerate(lines):
        for name in VALUE.findall(line):
            if at[name] != k // size:
                across.setdefault(name, f"passed[{len(across)}]")

    def written(line: str) -> str:
        name = defined(line)
        value = line.partition(" = ")[2] if name in across else line
        value = VALUE.sub(lambda found: across.get(found[0], found[0]), value)
        return f"{across[name]} = {value}" if name in across else value

    made = [written(line) for line in lines]
    return Pieces([made[k : k + size] for k in range(0, len(made), size)], len(across))


VALUE = re.compile(r"\bv\d+\b")
"""The name of a value that serves several others."""


def defined(line: str) -> str:
    """The value that a statement names; nothing where it is an entry of an output."""
    return line.split(maxsplit=3)[2] if line.startswith("const ") else ""


class _Writer:
    def __init__(self, program: Program, naming: Naming) -> None:
        self.program, self.naming = program, naming
        self.uses = Counter(ref.node for node in program.nodes for ref in node.operands)
        self.uses.update(ref.node for output in program.outputs for ref in output.entries)
        self.text: dict[int, tuple[str, int]] = {}
        self.lines: list[str] = []
        targets: dict[int, list[tuple[str, Ref]]] = {}
        for output in program.outputs:
            for k, ref in enumerate(output.entries):
                statement = naming.target(output.name, k)
                if statement is not None:
                    targets.setdefault(ref.node, []).append((statement, ref))
        named = 0
        for index, node in enumerate(program.nodes):
            text, rank = self.expression(index)
            # a reciprocal that serves once becomes a division where it does
            long = len(text) > WIDTH and node.op != "inv"
            if node.op != "input" and not self.fixed(Ref(index)) and (self.uses[index] > 1 or long):
                self.lines.append(f"const {naming.type} v{named} = {text};")
                text, rank = f"v{named}", _ATOM
                named += 1
            self.text[index] = text, rank
            for statement, ref in targets.get(index, ()):
                value = self.signed(ref, _SUM)
                self.lines.append(statement.format(naming.lift(value) if self.fixed(ref) else value))

    def expression(self, index: int) -> tuple[str, int]:
        """Text of a value and how tightly its outermost operator binds."""
        node, naming = self.program.nodes[index], self.naming
        match node.op:
            case "input":
                name = self.program.inputs[node.place[0]].name
                return naming.source(name, node.place[1]), _ATOM
            case "constant":
                return literal(node.value, single=naming.single), _ATOM
            case "sum":
                text = self.signed(node.operands[0], _ATOM)
                for ref in node.operands[1:]:
                    text += f" {'-' if ref.negative else '+'} {self.of(ref.node, _ATOM)}"
                return text, _SUM
            case "product":
                return self.product(node.operands), _PRODUCT
            case "inv":
                return f"{literal(1.0, single=naming.single)} / {self.of(node.operands[0].node, _ATOM)}", _PRODUCT
            case "negative":
                return f"-{self.of(node.operands[0].node, _ATOM)}", _SUM
        arguments = [self.signed(ref, _SUM) for ref in node.operands]
        if node.op != "pow":  # whose exponent is a plain number
            arguments = [naming.lift(text) if self.fixed(ref) else text
                         for text, ref in zip(arguments, node.operands, strict=True)]
        return f"{naming.call(node.op)}({', '.join(arguments)})", _ATOM

    def fixed(self, ref: Ref) -> bool:
        """Whether a value is a number, or the negative of one."""
        node = self.program.nodes[ref.node]
        return node.op == "constant" or (node.op == "negative" and self.fixed(node.operands[0]))

    def product(self, operands: tuple[Ref, ...]) -> str:
        # a reciprocal that serves only here is a division
        below = [r for r in operands if self.program.nodes[r.node].op == "inv" and self.uses[r.node] == 1]
        above = [r for r in operands if r not in below]
        if not above or not below:
            return " * ".join(self.of(ref.node, _PRODUCT if k == 0 else _ATOM) for k, ref in enumerate(operands))
        text = " * ".join(self.of(ref.node, _PRODUCT if k == 0 else _ATOM) for k, ref in enumerate(above))
        for ref in below:
            text += f" / {self.of(self.program.nodes[ref.node].operands[0].node, _ATOM)}"
        return text

    def of(self, index: int, rank: int) -> str:
        text, own = self.text[index]
        return text if own >= rank else f"({text})"

    def signed(self, ref: Ref, rank: int) -> str:
        return f"-{self.of(ref.node, _ATOM)}" if ref.negative else self.of(ref.node, rank)


_SUM, _PRODUCT, _ATOM = range(3)


def quick(lines: Sequence[str], first: int = 0) -> list[str]:
    """Statements in another order, the first ones where they are.

    Sines and cosines of inputs come before the others: a call empties the registers. Results that are computed from
    nothing, such as zeros, are spread over the others, since they wait for the memory alone.

    >>> quick(["y[0] = 0.0;", "const double v0 = 2 * x[0];", "const double v1 = sin(x[1]);", "y[1] = v0 * v1;",
    ...        "y[2] = v0 + v1;"])
    ['const double v1 = sin(x[1]);', 'const double v0 = 2 * x[0];', 'y[1] = v0 * v1;', 'y[0] = 0.0;', 'y[2] = v0 + v1;']
    """
    calls, results, others = list[str](), list[str](), list[str]()
    for line in lines[first:]:
        operands = set(VALUE.findall(line)) - {defined(line)}
        kind = others if operands else calls if _CALL.search(line) else others if defined(line) else results
        kind.append(line)
    spread = [((place + 0.5) / len(group), line) for group in (others, results) for place, line in enumerate(group)]
    return [*lines[:first], *calls, *(line for _, line in sorted(spread, key=lambda each: each[0]))]
