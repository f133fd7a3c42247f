"""Whether numbers of a machine file are further off than their sigmas say, group by group."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import special

from hydroopt.estimation.inference.prior_conflict import CONFLICT
from hydroopt.results.diagnostic import Diagnostic, Meaning, probability
from hydroopt.spatial.inertia import Array

DETERMINED = 0.5
"""Part of the stated variance that the data must take away from a combination of numbers to test it."""
MOST = 4
"""Numbers that a sentence names."""


def contradicted(names: Sequence[str], groups: Sequence[str], off: Array, spread: Array) -> Iterator[Diagnostic]:
    """A diagnostic for each group that is further off than stated; where there is none, one for all numbers together.

    In units of sigma, what is found is normal about what is stated, with the covariance 1 − C/σ² where C is that of the
    estimate.

    Args:
        names: of k numbers.
        groups: of each, in words: those of one group are tested together.
        off: (k,) what is found beyond what is stated, over the stated sigma.
        spread: (k, k) covariance of `off` if all sigmas are right.

    >>> [found] = contradicted(["a", "b"], ["lengths", "lengths"], np.array([5.0, 0.5]), 0.9 * np.eye(2))
    >>> found.subject, found.evidence["ratio"].__format__(".1f")
    (('a',), '3.7')
    """
    members = {group: np.array([k for k, own in enumerate(groups) if own == group]) for group in dict.fromkeys(groups)}
    found = [one for group, own in members.items() if (one := _further(names, group, own, off, spread, len(members)))]
    if not found and len(members) > 1:
        found = list(filter(None, [_further(names, "numbers", np.arange(len(names)), off, spread, len(members))]))
    yield from found


def _further(names: Sequence[str], group: str, own: NDArray[np.intp], off: Array, spread: Array,
             tests: int) -> Diagnostic | None:
    """A diagnostic if some of the numbers, at places `own`, are together further off than stated."""
    values, vectors = np.linalg.eigh(spread[np.ix_(own, own)])
    determined = values > DETERMINED
    if not determined.any():
        return None
    squares = (vectors[:, determined].T @ off[own]) ** 2 / values[determined]
    p = float(special.chdtrc(len(squares), np.sum(squares)))
    if (tests + 1) * p >= CONFLICT:
        return None
    far = np.abs(off[own]) / np.sqrt(np.maximum(np.diag(spread)[own], DETERMINED))
    most = [k for n, k in enumerate(np.argsort(-far, kind="stable")[:MOST].tolist()) if far[k] > 2.0 or not n]
    return Diagnostic.of("stated numbers contradicted", tuple(names[own[k]] for k in most), {
        "group": group, "ratio": float(np.sqrt(np.mean(squares))), "directions": len(squares), "p_value": p,
        "probability": probability(p)},
        "The readings contradict {subject}: the {group} are {ratio:.1f} times as far off as stated ({probability}).",
        "Check these numbers, or widen the sigmas of all of their kind: what readings do not determine stays as "
        "uncertain as it is.", Meaning.CONTRADICTION)
