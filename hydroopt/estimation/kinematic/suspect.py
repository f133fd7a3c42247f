"""A suspect: something that contradicts the rest of the poses, with its evidence and its rivals."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.results.diagnostic import Diagnostic, Meaning, filled
from hydroopt.results.tables import number


class SuspectKind(StrEnum):
    """What a suspect is; the value stands in JSON files."""

    PLANE = "plane"
    STAGE = "stage"
    STRETCH = "stretch"
    POSE = "pose"
    FIXTURE = "fixture"
    BASE = "base"
    TOOL = "tool"
    INSTRUMENT = "instrument"
    OFFSET = "offset"
    SCALE = "scale"
    BACKLASH = "backlash"
    GEAR = "gear"
    SAG = "sag"
    NONLINEAR = "nonlinear"
    DISTANCE = "distance"
    LACK = "lack"

    @property
    def is_poses(self) -> bool:
        """Whether the suspect is poses, which can be left out."""
        return self in (SuspectKind.STAGE, SuspectKind.STRETCH, SuspectKind.POSE)


class _Words(NamedTuple):
    """What is said of a kind of suspect: kind of its diagnostic, it in a few words as one of several, the sentence."""

    kind: str
    phrase: str
    text: str
    remedy: str = ""
    meaning: Meaning = Meaning.CONTRADICTION


_POSES, _BEFORE = "wrong poses at {place}", "by about {size:.1f} {unit} before {place}."
_WORDS = {
    SuspectKind.PLANE: _Words("poses in one plane", _POSES, (
        "All joints that turned between the poses have parallel axes, so that the poses lie in one plane and geometry "
        "across it is not identifiable."), "Measure poses that leave the plane.", Meaning.NOTE),
    SuspectKind.STAGE: _Words("stage contradicts the others", _POSES, (
        "The poses of '{subject}' ({place}) contradict the others: their errors are {strength:.1f} times the usual "
        "ones.")),
    SuspectKind.STRETCH: _Words("stretch of poses contradicts the others", _POSES, (
        "In '{subject}', {place} contradict the others: their errors are {strength:.1f} times the usual ones."),
        meaning=Meaning.NOTE),
    SuspectKind.POSE: _Words("pose contradicts the others", _POSES, (
        "Pose {subject} ({place}) contradicts the others: its error is {strength:.1f} times the usual one."),
        meaning=Meaning.NOTE),
    SuspectKind.FIXTURE: _Words("fixture moved", "fixture '{subject}' moved{by} before {place}", (
        "The fixture '{subject}' moved " + _BEFORE)),
    SuspectKind.BASE: _Words("base moved", "the base moved{by} before {place}", "The base moved " + _BEFORE),
    SuspectKind.TOOL: _Words("tool moved", "the tool moved{by} before {place}", (
        "The tool moved on its link " + _BEFORE)),
    SuspectKind.INSTRUMENT: _Words("instrument moved", "instrument '{subject}' moved{by} before {place}", (
        "The instrument '{subject}' moved " + _BEFORE), "Name another set-up from there on, in the column 'setup'."),
    SuspectKind.OFFSET: _Words("sensor reads another zero", "another zero of '{subject}' {where}{by}", (
        "The sensor of '{subject}' reads another zero {where}, by {size:.3g} {unit}.")),
    SuspectKind.SCALE: _Words("sensor reads a wrong scale", "a wrong scale of '{subject}' by {size:.2f %}", (
        "The sensor of '{subject}' reads a wrong scale, by {size:.2f %}.")),
    SuspectKind.BACKLASH: _Words("backlash", "backlash of '{subject}'{by}", (
        "'{subject}' has backlash: its reading depends on where it comes from, by {size:.3g} {unit}.")),
    SuspectKind.GEAR: _Words("sensor or gear eccentric", "an eccentric sensor or gear of '{subject}'{by}", (
        "The sensor or the gear of '{subject}' is eccentric: its error repeats once a turn, with an amplitude of "
        "{size:.3g} {unit}.")),
    SuspectKind.NONLINEAR: _Words("sensor not linear", "a nonlinear sensor of '{subject}'{by}", (
        "The sensor of '{subject}' is not linear: its error at both ends differs from that in the middle by "
        "{size:.3g} {unit}.")),
    SuspectKind.SAG: _Words("joint gives way under gravity", "'{subject}' giving way under gravity{by}", (
        "'{subject}' gives way under gravity, by up to {size:.3g} {unit}."),
        "Take it in by --compliance auto, or state its compliance with a sigma."),
    SuspectKind.DISTANCE: _Words("distance between fixtures wrong", "a wrong distance '{subject}'{by}", (
        "The stated distance '{subject}' is wrong by {size:.2f} {unit}."), "Measure it again."),
    SuspectKind.LACK: _Words("effect lacking", "an effect that the model lacks", (
        "The model lacks an effect that the poses show."))}
"""By kind of suspect; those that are poses alone do not contradict a calibration, from which they can be left out."""
NAMED = 4
"""Most alternatives that a sentence names."""


@dataclass(frozen=True, eq=False)
class Suspect:
    """Something that contradicts the rest.

    Attributes:
        kind: what it is.
        name: of the stage, pose, fixture, distance, joint or cylinder.
        poses: (N,) poses it concerns; `place` says where they stand in their files.
        strength: root of the likelihood gain: of the drop of squared errors that it explains, in units of the errors'
            variance; of poses, their errors relative to the usual ones.
        size: of the defect [rad, m, or 1 for a scale]; NaN where it has none.
        where: in which poses a sensor reads another zero.
        unit: ``deg`` or ``mm``, in which the size is said.
        rivals: what else explains the same errors about as well. The data decide where there are none.
    """

    kind: SuspectKind
    name: str
    poses: NDArray[np.bool_]
    place: str
    strength: float
    size: float = float("nan")
    where: str = ""
    unit: str = "deg"
    rivals: tuple[Suspect, ...] = ()

    @property
    def decided(self) -> bool:
        """Whether the data decide for it."""
        return not self.rivals

    @property
    def phrase(self) -> str:
        """It in a few words, as one of several."""
        evidence = self._evidence
        by = " by {size:.3g} {unit}".format(**evidence) if "unit" in evidence else ""
        return filled(_WORDS[self.kind].phrase, self._subject, evidence | {"by": by})

    @property
    def diagnostic(self) -> Diagnostic:
        """The finding with its words."""
        if self.rivals:
            candidates = (self, *self.rivals)
            named = dict.fromkeys(each.name for each in candidates if each.name)
            return Diagnostic.of("cause of the contradiction undecided", tuple(named), {
                "place": self.place, "strength": self.strength,
                "alternatives": "; ".join(s.phrase for s in candidates[:NAMED])
                + (f"; and {len(candidates) - NAMED} more" if len(candidates) > NAMED else ""),
                "strengths": [number(s.strength) for s in candidates]},
                "Something contradicts the poses, and the data do not decide between: {alternatives}.",
                meaning=Meaning.CONTRADICTION)
        words = _WORDS[self.kind]
        return Diagnostic.of(words.kind, self._subject, self._evidence, words.text, words.remedy, words.meaning)

    @property
    def _subject(self) -> tuple[str, ...]:
        return (self.name,) if self.name else ()

    @property
    def _evidence(self) -> dict[str, Any]:
        """Where it is and how large, as sentences write it."""
        evidence: dict[str, Any] = {"place": self.place, "strength": self.strength}
        if np.isnan(self.size):
            return evidence
        if self.kind is SuspectKind.SCALE:
            return evidence | {"size": self.size}
        size = float(np.degrees(self.size)) if self.unit == "deg" else 1e3 * self.size
        return evidence | {"size": size, "unit": self.unit, "where": self.where}
