"""Diagnostics as a terminal shows them: findings of the data first, properties of machine and motion apart."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from hydroopt.results.diagnostic import Diagnostic, of_kind, sentences
from hydroopt.results.wording import Kind

OF_MACHINE = frozenset({
    Kind.UNSTATED_BODIES, Kind.NO_FRICTION,
    Kind.IMPOSSIBLE_NOMINAL_BODIES, Kind.NO_CONFIDENCE_STATED, Kind.NO_FORCE_ACCURACY, Kind.NO_ANGLE_ACCURACY,
    Kind.RESERVE_USED, Kind.POSES_USE_RESERVE, Kind.WAYS_USE_RESERVE,
    Kind.NOT_LIMITED, Kind.ACTIVE_CONSTRAINTS, Kind.WEAK_LOG_DET, Kind.NOT_EXCITED, Kind.NOT_IDENTIFIABLE,
    Kind.CONFOUNDED, Kind.NO_INFORMATION, Kind.LITTLE_INFORMATION, Kind.RATIO_OR_PRODUCT_ONLY, Kind.COMBINATION_ONLY,
    Kind.ONLY_TOGETHER, Kind.NOT_DETERMINED, Kind.CORRELATED_ESTIMATES, Kind.PRIOR_ALONE, Kind.LITTLE_BESIDE_PRIOR,
    Kind.NOT_IDENTIFIED_BY_POSES, Kind.NOT_BY_MOTION, Kind.NOT_IMPROVED, Kind.CHANGE_CONFOUNDED,
    Kind.CHANGE_NOT_IDENTIFIABLE, Kind.JOINT_LIMITS_NARROWED, Kind.JOINT_LIMITS_WIDENED,
    Kind.LITTLE_DAMPING, Kind.MARGINS_BY_VALVES})
"""Kinds that are properties of the machine, its file and the motion, whatever the readings are."""
DATA, MACHINE = "Data", "Machine and motion"


def summary(diagnostics: Iterable[Diagnostic]) -> dict[str, list[str]]:
    """Sentences by heading, `DATA` before `MACHINE`; groups that are not separable in one sentence with their number.

    >>> both = [Diagnostic(Kind.NO_VALIDATION), Diagnostic(Kind.NOT_EXCITED, ("boom.m",))]
    >>> [(heading, len(each)) for heading, each in summary(both).items()]
    [('Data', 1), ('Machine and motion', 1)]
    """
    found = list(diagnostics)
    groups = of_kind(found, Kind.CONFOUNDED)
    machine = [each for each in found if each.kind in OF_MACHINE and (each not in groups or len(groups) == 1)]
    by_heading = {DATA: sentences([each for each in found if each.kind not in OF_MACHINE]),
            MACHINE: sentences(machine) + ([_not_separable(groups)] if len(groups) > 1 else [])}
    return {heading: texts for heading, texts in by_heading.items() if texts}


def _not_separable(groups: Sequence[Diagnostic]) -> str:
    count = sum(len(group.subject) for group in groups)
    return (f"{count} parameters in {len(groups)} groups are not separable in this motion: the data determine each "
            f"group's joint effect, and the priors the rest. estimate.json and the report list them. "
            f"{groups[-1].remedy.partition(': ')[2].capitalize()}")
