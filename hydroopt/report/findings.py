"""Diagnostics as a page shows them: what the data show, apart from what machine and motion are like."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from hydroopt.report.numbers import plain
from hydroopt.results.diagnostic import Diagnostic, of_kind, sentences
from hydroopt.results.summary import OF_MACHINE
from hydroopt.results.wording import Kind


class Findings(NamedTuple):
    """Sentences about the data, sentences about the machine and its motion, and groups of parameters that the motion
    does not separate: their names, effect and variance inflation, with the one remedy."""

    data: list[str]
    machine: list[str]
    groups: list[tuple[str, str, str]]
    remedy: str


def findings(diagnostics: Sequence[Diagnostic]) -> Findings:
    """Diagnostics in their order, by what they are about."""
    groups = of_kind(diagnostics, Kind.CONFOUNDED)
    rest = [each for each in diagnostics if each.kind is not Kind.CONFOUNDED]
    return Findings(sentences(each for each in rest if each.kind not in OF_MACHINE),
                    sentences(each for each in rest if each.kind in OF_MACHINE),
                    [(", ".join(each.subject), *_effect(each)) for each in groups],
                    groups[0].remedy if groups else "")


def _effect(diagnostic: Diagnostic) -> tuple[str, str]:
    return str(diagnostic.evidence["effects"]), plain(float(diagnostic.evidence["variance_inflation"]), 2)
