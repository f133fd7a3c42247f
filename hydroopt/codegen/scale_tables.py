"""What the generated scale knows: sizes, rules of the recursion, the smoothing kernel, and a calibration."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hydroopt.codegen.parameter_source import Origin
from hydroopt.errors import ProblemError
from hydroopt.results.verdict import NORMAL
from hydroopt.spatial.inertia import Array
from hydroopt.weighing import course, equations, recursion, smoothed_log
from hydroopt.weighing.course import Weighable
from hydroopt.weighing.scale import STEEPEST, Scale
from hydroopt.weighing.smoothed_log import SmoothingKernel

ROUTINES = ("actuator_forces", "tilted_regressor", "force_by_motion")
"""What the scale calls."""
FILES = {"{p}_scale.h": "scale.h", "{p}_scale.c": "scale.c", "{p}_scale_params.h": "scale_params.h"}
"""Template by file."""
LONGEST_TARE = 15.0
"""Longest tare in C [s]."""
CATCHING_UP = 5
"""While how many smoothed samples come in those of the tare are taken again."""
FASTEST = 1000.0
"""Highest rate [Hz] for which a scale is generated, since the samples of 1.8 s are kept."""
SLOWEST = 0.1
"""Longest step [s]: the smoothing needs some samples."""
_BELIEVED = {
    "WEIGHABLE": Weighable.OK, "FILLING": "too few samples since the start or a gap", "TARING": Weighable.TARING,
    "CHANGING": Weighable.CHANGING, "STANDSTILL": Weighable.STANDSTILL, "UNCERTAIN": Weighable.UNCERTAIN,
    "CONTRADICTED": Weighable.CONTRADICTED, "IMPOSSIBLE": Weighable.IMPOSSIBLE,
    "REFUSED": "the call returned another status than OK"}


@dataclass(frozen=True, eq=False)
class ScaleTables:
    """A scale as the templates of its C need it.

    Attributes:
        scale: that weighs.
        step: from one sample to the next [s].
        needed: half of the 95 % interval [kg] above which a mass is too uncertain.

    Raises:
        ProblemError: there is no scale in C of this kind or with this step.
    """

    scale: Scale
    step: float
    needed: float

    def __post_init__(self) -> None:
        where = self.scale.machine.name
        if not (1 / FASTEST <= self.step <= SLOWEST and self.needed > 0):
            raise ProblemError("a scale in C needs a sampling step and an interval that it can have", where=where,
                               remedy=f"sample at {1 / SLOWEST:g} to {FASTEST:g} Hz, and give a positive interval")
        if not self.scale.model.linear:
            raise ProblemError("there is no scale in C for friction that is not linear in its parameters", where=where,
                               remedy="leave Stribeck speeds out of the machine file")

    @cached_property
    def kernel(self) -> SmoothingKernel:
        """The smoothing with this step."""
        return SmoothingKernel.of_step(self.step)

    @property
    def weighable(self) -> Mapping[str, str]:
        """What an enumerator means, by name."""
        return {name: str(text) if name != "WEIGHABLE" else "the mass can be believed"
                for name, text in _BELIEVED.items()}

    @staticmethod
    def status(weighable: int) -> Weighable | str:
        """The status in Python of a number in C; words for what Python does not have."""
        return list(_BELIEVED.values())[weighable]

    @property
    def link(self) -> str:
        """What carries the load."""
        return self.scale.load.link

    @property
    def rows(self) -> int:
        """Number of measured forces."""
        return len(self.scale.force_std)

    @property
    def numbers(self) -> int:
        """Number of own unknowns without gravity."""
        return len(self.scale.known.mean)

    @property
    def psi(self) -> Array:
        """(p,) calibrated parameters."""
        return self.scale.psi

    @property
    def recent(self) -> int:
        """Number of samples since which a change is sought."""
        return recursion.RECENT

    @property
    def lags(self) -> int:
        """Number of smoothed samples before, with which errors are correlated."""
        return len(self.kernel.covariance) - 1

    @property
    def rules(self) -> Mapping[str, float]:
        """Numbers of the rules."""
        return {"MOVING": smoothed_log.MOVING, "UNEVEN": smoothed_log.UNEVEN, "LEAST": equations.LEAST,
                "STEEPEST": STEEPEST, "SHOWN": recursion.SHOWN, "AGAIN": recursion.AGAIN, "WIDEST": recursion.WIDEST,
                "SMALLEST": recursion.SMALLEST, "ALIKE": recursion.ALIKE, "THRESHOLD": course.THRESHOLD,
                "GOES_ON": course.GOES_ON,
                "NOTICED": course.NOTICED, "EMPTY": course.EMPTY, "LASTS": course.LASTS, "SETTLED": course.SETTLED,
                "RESTING": course.RESTING, "FORGOTTEN": course.FORGOTTEN, "FEWEST": course.FEWEST,
                "CONTRADICTED": course.CONTRADICTED,
                "NEGATIVE": course.NEGATIVE, "OVERLOAD": course.OVERLOAD, "NORMAL": NORMAL, "ROUNDING": 1e-6}

    @cached_property
    def constants(self) -> Mapping[str, Array]:
        """Arrays of the smoothing, and the joint that each measured force is about."""
        taus, shares = zip(*self.kernel.nodes, strict=True)
        return {"joint_of": np.array(self.scale.model.dynamics.kept, dtype=np.int64),
                "weighs": np.isfinite(self.scale.force_std).astype(np.int64),
                "weights": self.kernel.weights, "node_share": np.array(shares),
                "of_a_jump": self.kernel.of_a_jump(self.recent),
                "kernel_covariance": self.kernel.covariance.reshape(self.lags + 1, 16),
                "at_node": np.stack([self.kernel.at_node(tau) for tau in taus])}

    @cached_property
    def values(self) -> Mapping[str, Array]:
        """What stands in the parameters, in their order."""
        scale, load = self.scale, self.scale.load
        root, right = scale.known.rows
        return {"psi": scale.psi, "columns": np.hstack([scale.directions, -scale.taken, scale.carried]),
                "root": root, "right": right, "angle_std": scale.angle_std,
                "force_std": np.where(np.isfinite(scale.force_std), scale.force_std, 0.0),
                "read": scale.read,
                "gravity": np.array(np.linalg.norm(scale.gravity)), "axes": scale.axes,
                "centre": np.array(load.centre), "centre_std": np.array(load.centre_std),
                "full_scale": np.array(load.full_scale), "radius": np.array(load.radius), "gain": np.array(scale.gain),
                "needed": np.array(self.needed)}

    @cached_property
    def origin(self) -> Origin:
        """Where the parameters come from: the digest of all of them."""
        digest = hashlib.sha256(b"".join(np.ascontiguousarray(each, dtype=float).tobytes()
                                         for each in self.values.values())).hexdigest()
        return Origin(f"a scale of {self.scale.machine.name}", digest)

    @property
    def longest_tare(self) -> float:
        """Longest tare [s]: its smoothed samples are kept."""
        return LONGEST_TARE

    @cached_property
    def tape(self) -> int:
        """How many smoothed samples are kept: of the longest tare, and of the time in which they are taken again."""
        return round(LONGEST_TARE / (self.kernel.stride * self.kernel.step)) + 2 * CATCHING_UP

    @cached_property
    def at_once(self) -> int:
        """How many smoothed samples a call takes at most."""
        return -(-self.tape // (CATCHING_UP * self.kernel.stride))

    def state_size(self, *, single: bool) -> int:
        """Bytes of the state between calls."""
        n, r, c, window = len(self.scale.angle_std), self.rows, self.numbers + 2, (self.lags + 1) * self.rows
        columns, left = c + 11 + self.recent, 1 + self.recent
        reals = 13 + self.tape * (1 + 6 * n + r) + (2 * self.kernel.margin + 1) * (n + r) + c * (c + 3) + 10
        reals += (c + 10) * columns + 3 * left + window * (columns + window + 4 * n)
        size = (4 if single else 8) * reals + 4 * (21 + window)
        return size if single else -(-size // 8) * 8

    def digest(self, *texts: str) -> str:
        """What header, source and parameters must have in common: 8 hexadecimal digits."""
        made = hashlib.sha256("".join(texts).encode())
        made.update(repr((self.step, self.rows, self.numbers, len(self.psi), self.rules, self.link)).encode())
        return made.hexdigest()[:8]
