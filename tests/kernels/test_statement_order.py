"""The order of C statements: none lost, none before what it needs, the first ones where they were."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hydroopt.kernels.c_writer import quick


def random_statements(seed: int) -> list[str]:
    """Values of some earlier ones each, calls among them, and results with and without operands."""
    rng = np.random.default_rng(seed)
    lines, values = [], 0
    for k in range(rng.integers(1, 300)):
        taken = [f"v{j}" for j in rng.choice(values, min(values, rng.integers(0, 4)), replace=False)]
        text = " + ".join(["sin(x[0])" if rng.random() < 0.1 else "1.0", *taken])
        if rng.random() < 0.6:
            lines.append(f"const double v{values} = {text};")
            values += 1
        else:
            lines.append(f"y[{k}] = {text};")
    return lines


@pytest.mark.parametrize("seed", range(30))
def test_values_are_known_where_they_are_used(seed: int) -> None:
    lines = random_statements(seed)
    first = seed % 5 if len(lines) > 5 else 0
    found = quick(lines, first)
    assert sorted(found) == sorted(lines)
    assert found[:first] == lines[:first]
    known: set[str] = set()
    for line in found:
        own, _, text = line.partition(" = ")
        assert set(re.findall(r"\bv\d+\b", text)) <= known
        known.add(own.split()[-1])


def test_sines_come_first_and_zeros_between_the_others() -> None:
    lines = [f"y[{k}] = 0.0;" for k in range(4)] + [f"const double v{k} = 2.0 * x[{k}];" for k in range(6)]
    lines += ["const double v6 = cos(x[3]);", *(f"y[{4 + k}] = v{k} * v6;" for k in range(6))]
    found = quick(lines)
    assert found[0] == lines[10]
    assert np.diff([found.index(line) for line in lines[:4]]).tolist() == [4, 4, 4]
    assert [line for line in found if line in lines[4:10] + lines[11:]] == lines[4:10] + lines[11:]


def test_calls_of_values_stay_behind_these() -> None:
    lines = ["const double v0 = x[0] + x[1];", "const double v1 = sin(v0);", "y[0] = sin(x[2]);", "y[1] = v1;"]
    assert quick(lines) == [lines[2], lines[0], lines[1], lines[3]]
    assert quick(lines, 1) == [lines[0], lines[2], *lines[1:2], lines[3]]
