"""An order of C statements for which processors take less time than for the order in which they were made."""

from __future__ import annotations

import re
from collections.abc import Sequence

from hydroopt.kernels.c_writer import VALUE, defined

_CALL = re.compile(r"= (sin|cos)f?\(")


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
