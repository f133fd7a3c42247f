"""A scale as C for a controller."""

from __future__ import annotations

from hydroopt.codegen.folder import Code
from hydroopt.codegen.scale_tables import ROUTINES, ScaleTables
from hydroopt.weighing.scale import Scale
from hydroopt.weighing.weighing import NEEDED


def scale_code(scale: Scale, step: float, *, needed: float | None = None, single: bool = False,
               name: str | None = None, measured: bool = False) -> Code:
    """Generated C that weighs as `weigh` does, sample by sample.

    Args:
        scale: that weighs.
        step: from one sample to the next [s].
        needed: half of the 95 % interval [kg] above which a mass is too uncertain; 2 % of the full scale by default.
        single: whether to compute in single precision.
        name: prefix of all names; else the machine's name.
        measured: whether to compile it, so that its README states stack and flash.

    Raises:
        ProblemError: there is no scale in C of this kind or with this step.

    Example:
        `hydroopt weigh --code` writes it; see docs/how-to/weigh_a_load.md.
    """
    tables = ScaleTables(scale, step, NEEDED * scale.load.full_scale if needed is None else needed)
    return Code(scale.model.machine, tables.origin, routines=ROUTINES, name=name, single=single, psi=scale.psi,
                measured=measured, scale=tables)
