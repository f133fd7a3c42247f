"""A suspect: something that contradicts the rest of the poses, with its evidence and its rivals."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.results.diagnostic import Diagnostic
from hydroopt.results.tables import number
from hydroopt.results.wording import Kind


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


DIAGNOSTICS = {SuspectKind.PLANE: Kind.POSES_IN_ONE_PLANE, SuspectKind.STAGE: Kind.STAGE_CONTRADICTS,
               SuspectKind.STRETCH: Kind.STRETCH_CONTRADICTS, SuspectKind.POSE: Kind.POSE_CONTRADICTS,
               SuspectKind.FIXTURE: Kind.FIXTURE_MOVED, SuspectKind.BASE: Kind.BASE_MOVED,
               SuspectKind.INSTRUMENT: Kind.INSTRUMENT_MOVED,
               SuspectKind.TOOL: Kind.TOOL_MOVED, SuspectKind.OFFSET: Kind.SENSOR_OFFSET,
               SuspectKind.SCALE: Kind.SENSOR_SCALE, SuspectKind.BACKLASH: Kind.BACKLASH,
               SuspectKind.GEAR: Kind.SENSOR_ECCENTRIC, SuspectKind.SAG: Kind.JOINT_SAGS,
               SuspectKind.NONLINEAR: Kind.SENSOR_NONLINEAR, SuspectKind.DISTANCE: Kind.DISTANCE_OFF}
"""Kind of the diagnostic of each kind of suspect."""

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
        size = "" if np.isnan(self.size) else f" by {self._shown:.3g} {self.unit}"
        match self.kind:
            case SuspectKind.OFFSET:
                return f"another zero of '{self.name}' {self.where}{size}"
            case SuspectKind.SCALE:
                return f"a wrong scale of '{self.name}' by {100 * self.size:.2f} %"
            case SuspectKind.BACKLASH:
                return f"backlash of '{self.name}'{size}"
            case SuspectKind.GEAR:
                return f"an eccentric sensor or gear of '{self.name}'{size}"
            case SuspectKind.NONLINEAR:
                return f"a nonlinear sensor of '{self.name}'{size}"
            case SuspectKind.SAG:
                return f"'{self.name}' giving way under gravity{size}"
            case SuspectKind.FIXTURE:
                return f"fixture '{self.name}' moved{size} before {self.place}"
            case SuspectKind.INSTRUMENT:
                return f"instrument '{self.name}' moved{size} before {self.place}"
            case SuspectKind.BASE:
                return f"the base moved{size} before {self.place}"
            case SuspectKind.TOOL:
                return f"the tool moved{size} before {self.place}"
            case SuspectKind.DISTANCE:
                return f"a wrong distance '{self.name}'{size}"
            case SuspectKind.LACK:
                return "an effect that the model lacks"
        return f"wrong poses at {self.place}"

    @property
    def _shown(self) -> float:
        return float(np.degrees(self.size)) if self.unit == "deg" else 1e3 * self.size

    @property
    def diagnostic(self) -> Diagnostic:
        """The finding with its words."""
        evidence: dict[str, Any] = {"place": self.place, "strength": self.strength}
        if self.rivals:
            candidates = (self, *self.rivals)
            return Diagnostic(Kind.SUSPECTS_UNDECIDED, tuple(dict.fromkeys(s.name for s in candidates if s.name)), {
                **evidence, "alternatives": "; ".join(s.phrase for s in candidates[:NAMED])
                + (f"; and {len(candidates) - NAMED} more" if len(candidates) > NAMED else ""),
                "strengths": [number(s.strength) for s in candidates]})
        match self.kind:
            case SuspectKind.SCALE:
                evidence |= {"size": self.size}
            case SuspectKind.PLANE | SuspectKind.STAGE | SuspectKind.STRETCH | SuspectKind.POSE:
                pass
            case _:
                evidence |= {"size": self._shown, "unit": self.unit, "where": self.where}
        return Diagnostic(DIAGNOSTICS[self.kind], (self.name,) if self.name else (), evidence)
