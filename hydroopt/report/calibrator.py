"""The page of a designed calibrator, and its drawing with dimensions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from hydroopt.report import pose_plan
from hydroopt.report.numbers import NONE, plain
from hydroopt.report.page import fragment

if TYPE_CHECKING:
    from hydroopt.excitation.selection.calibrator_design import CalibratorDesign

PANEL, TALL = 250.0, 250.0
"""Width and height of the place of one part [px]."""
ACROSS = 3
"""Parts beside each other."""
EDGE = 58.0
"""Room for dimensions around a part [px]."""


def render(design: CalibratorDesign) -> str:
    """The page as one HTML document that needs nothing else."""
    return pose_plan.render(
        design, "calibrator.html", drawing=drawing(design), ball=", ".join(plain(each, 4) for each in design.ball),
        cost=plain(design.cost, 4),
        parts=[(part["name"], plain(np.degrees(part["theta"]), 4), _mm(part["d"]), _mm(part["a"]),
                plain(np.degrees(part["alpha"]), 3),
                NONE if part["accuracy"] is None else plain(np.degrees(part["accuracy"]), 3)) for part in design.parts],
        lengths=[(name, plain(1e3 * design.length_std[name], 3), plain(1e3 * std, 3),
                  plain(1e3 * design.exact_deviations[name], 3)) for name, std in design.length_deviations.items()],
        errors=[(each.name, *_own(each.name, each.std), each.length, plain(100 * (each.factor - 1), 2))
                for each in design.own_errors],
        tried=[(each.links, ", ".join(plain(np.degrees(one), 3) for one in each.accuracy), plain(each.cost, 4),
                plain(each.ratio, 3)) for each in design.tried])


def _mm(length: float) -> str:
    return f"{round(1e3 * length)}".replace("-", "−")


def _own(name: str, std: float) -> tuple[str, str]:
    """Confidence of a number of the calibrator, and its unit."""
    return (plain(1e3 * std, 3), "mm") if name.endswith((".a", ".d")) else (plain(np.degrees(std), 3), "°")


def drawing(design: CalibratorDesign) -> Markup:
    """Its parts with dimensions as SVG, all to one scale, each with its own axis upright.

    >>> import hydroopt
    >>> from hydroopt.report.calibrator import sheet
    >>> sheet([{"name": "arm", "theta": 0.0, "d": 0.2, "a": 1.5, "alpha": 0.0, "accuracy": None}])[:40]
    Markup('<svg xmlns="http://www.w3.org/2000/svg" ')
    """
    return sheet(design.parts)


def sheet(parts: list[dict[str, Any]]) -> Markup:
    """Parts with name, θ [rad], d [m], a [m], α [rad] and accuracy [rad] as SVG, see `drawing`."""
    scale = min((PANEL - 2 * EDGE) / max(1e-3, *(part["a"] for part in parts)),
                (TALL - 2 * EDGE) / max(1e-3, *(abs(part["d"]) for part in parts)))
    shown = []
    for k, part in enumerate(parts):  # from its axis along the offset, then along its length, to the next joint
        x, y, up = (k % ACROSS) * PANEL, (k // ACROSS) * TALL, scale * part["d"]
        left, foot = x + EDGE, y + TALL / 2 + up / 2 + 6
        shown.append({
            "name": part["name"], "x": x, "y": y, "left": left, "foot": foot, "top": foot - up,
            "right": left + scale * part["a"], "upright": abs(np.sin(part["alpha"])) < 0.5, "a": _mm(part["a"]),
            "d": _mm(part["d"]), "alpha": plain(np.degrees(part["alpha"]), 3),
            "theta": plain(np.degrees(part["theta"]), 4),
            "accuracy": "" if part["accuracy"] is None else plain(np.degrees(part["accuracy"]), 3)})
    return fragment("calibrator.svg", parts=shown, width=PANEL * min(ACROSS, len(parts)),
                    height=TALL * -(-len(parts) // ACROSS))
