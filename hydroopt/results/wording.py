"""The kinds of diagnostics and the words of each: the one place where a diagnostic becomes text."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from string import Formatter
from typing import Any, NamedTuple


class _Percent(Formatter):
    """A format such as ``.0f %`` writes a part as a percentage."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if format_spec.endswith(" %"):
            return f"{100 * value:{format_spec.removesuffix(' %')}} %"
        return str(super().format_field(value, format_spec))


def filled(template: str, subject: str, evidence: Mapping[str, Any]) -> str:
    """A template with a diagnostic's subject and evidence; ``{relative:.0f %}`` writes 0.25 as "25 %"."""
    return _Percent().vformat(template, (), {**evidence, "subject": subject})


class Words(NamedTuple):
    """Templates for `filled`: what was found, and what to do about it."""

    text: str
    remedy: str = ""


class Kind(StrEnum):
    """What a diagnostic is about; the value stands in JSON files."""

    # of any job
    NO_VALIDATION = "no validation data"
    FINDING = "finding in the data"
    NOTE = "note"

    # identification of valves and oil
    UNEXPLAINED_CHANNEL = "channel not explained by the model"
    NO_INFORMATION = "no information in the data"
    LITTLE_INFORMATION = "little information in the data"
    RATIO_OR_PRODUCT_ONLY = "only a ratio or product identifiable"
    COMBINATION_ONLY = "only a combination identifiable"
    PARAMETER_AT_BOUND = "parameter at a bound"

    # identification of bodies and friction
    WORSE_THAN_ZERO = "unseen forces predicted worse than by zero"

    # kinematic calibration and pose planning
    NOT_IDENTIFIED_BY_POSES = "not identified by poses"


WORDS: dict[Kind, Words] = {
    Kind.NO_VALIDATION: Words(
        "No log was held out, so the prediction of unseen data is not known.",
        "Give --validate or --holdout."),
    Kind.FINDING: Words("{subject}: {text}"),
    Kind.NOTE: Words("{text}"),
    Kind.UNEXPLAINED_CHANNEL: Words(
        "The residuals of {subject} are {factor:.1f} times its sensor's standard deviation; the intervals are widened.",
        "Check the accuracy of the sensor, and the parts that the machine file states or omits."),
    Kind.NO_INFORMATION: Words(
        "The logs carry no information on {subject}; {determined_by} determines it.",
        "Record a motion that excites it, or remove its sigma."),
    Kind.LITTLE_INFORMATION: Words(
        "The logs alone admit {subject} from {low:.3g} to {high:.3g} {unit}; {determined_by} determines it within."),
    Kind.RATIO_OR_PRODUCT_ONLY: Words(
        "The logs determine only the {form} of {subject}; {determined_by} determines each."),
    Kind.COMBINATION_ONLY: Words(
        "The logs determine {subject} only in combination; {determined_by} determines each."),
    Kind.PARAMETER_AT_BOUND: Words(
        "{subject} is at its {side} bound, {bound:.3g} {unit}; 95 % of its probability lies {beyond} {limit:.3g} "
        "{unit}."),
    Kind.WORSE_THAN_ZERO: Words(
        "The forces of {subject} in the validation logs are predicted worse than by zero ({relative:.0f %} error)."),
    Kind.NOT_IDENTIFIED_BY_POSES: Words(
        "These poses do not identify {subject}.",
        "Fix them, add priors, or add poses and sensors that depend on them."),
}
