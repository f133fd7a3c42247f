"""A map of correlations as inline SVG in the colours of its page."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from itertools import combinations

from markupsafe import Markup

from hydroopt.errors import visible
from hydroopt.report.drawing import LETTER
from hydroopt.results.diagnostic import listed
from hydroopt.spatial.inertia import Array

CELL, LEAST_CELL, LEAST_WRITTEN, SIDE = 30.0, 15.0, 24.0, 720.0
"""Largest and smallest side of a cell, that from which on its number is written, and that of the whole map from which
on cells shrink [px]."""
FAINT, WRITTEN = 0.02, 0.3
"""Magnitudes from which on a cell is coloured, and its number written."""
NAMED = 3
"""Pairs that the description names."""


def correlation_map(names: Sequence[str], correlation: Array) -> Markup:
    """An ``<svg>`` element of the correlations (n, n) below the diagonal; one colour a sign, fainter near zero.

    >>> import numpy as np
    >>> shown = correlation_map(["boom.a", "ball.x"], np.array([[1.0, -0.9], [-0.9, 1.0]]))
    >>> "Correlations of 2 parameters. Most correlated: boom.a and ball.x by −.90." in shown
    True
    """
    size, shown = len(names), [escape(visible(name)) for name in names]
    cell = max(LEAST_CELL, min(CELL, SIDE / size))
    margin = LETTER * max(map(len, names)) + 12
    words = []
    for j, i in combinations(range(size), 2):
        r, x, y = float(correlation[i, j]), margin + j * cell, i * cell
        if abs(r) > FAINT:
            words.append(f'<rect class="{"more" if r > 0 else "less"}" x="{x:.1f}" y="{y:.1f}" width="{cell - 1:.1f}" '
                         f'height="{cell - 1:.1f}" fill-opacity="{min(abs(r), 1.0):.2f}">'
                         f"<title>{shown[i]}, {shown[j]}: {_written(r)}</title></rect>")
        if abs(r) > WRITTEN and cell > LEAST_WRITTEN:
            words.append(f'<text x="{x + cell / 2:.1f}" y="{y + cell / 2 + 3:.1f}" text-anchor="middle">'
                         f"{_written(r)}</text>")
    for k, name in enumerate(shown):
        at = (k + 0.5) * cell + 4
        words.append(f'<text x="{margin - 6:.0f}" y="{at:.1f}" text-anchor="end">{name}</text>')
        words.append(f'<text transform="translate({margin + at:.1f} {size * cell + 6:.0f}) rotate(-90)" '
                     f'text-anchor="end">{name}</text>')
    side = margin + size * cell + LETTER
    return Markup(f'<svg class="correlations" viewBox="0 0 {side:.0f} {side:.0f}" width="{side:.0f}" role="img" '
                  f'aria-label="{escape(_description(names, correlation))}">{"".join(words)}</svg>')


def _description(names: Sequence[str], correlation: Array) -> str:
    """The map in words: the pairs that are separated worst."""
    pairs = sorted(combinations(range(len(names)), 2), key=lambda pair: -abs(correlation[pair]))
    worst = [f"{visible(names[i])} and {visible(names[j])} by {_written(float(correlation[i, j]))}"
             for i, j in pairs[:NAMED]]
    return f"Correlations of {len(names)} parameters. Most correlated: {listed(worst)}."


def _written(r: float) -> str:
    return f"{r:+.2f}".replace("-", "−").replace("+0.", "+.").replace("−0.", "−.")
