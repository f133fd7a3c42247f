"""The page of a designed calibrator, and its drawing with dimensions."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from hydroopt.report import pose_plan
from hydroopt.report.numbers import NONE, plain

if TYPE_CHECKING:
    from hydroopt.excitation.selection.calibrator_design import CalibratorDesign

PANEL, TALL = 250.0, 250.0
"""Width and height of the place of one part [px]."""
ACROSS = 3
"""Parts beside each other."""
EDGE = 58.0
"""Room for dimensions around a part [px]."""
LIGHT, STROKE = "#888", "currentColor"


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
    return f"{1e3 * length:.0f}".replace("-", "−")


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
    rows = -(-len(parts) // ACROSS)
    width, height = PANEL * min(ACROSS, len(parts)), TALL * rows
    said = "; ".join(f"{part['name']}: offset {_mm(part['d'])} mm, length {_mm(part['a'])} mm, twist "
                     f"{plain(np.degrees(part['alpha']), 3)} degrees" for part in parts)
    shapes = "".join(_part(part, scale, (k % ACROSS) * PANEL, (k // ACROSS) * TALL, last=k == len(parts) - 1)
                     for k, part in enumerate(parts))
    return Markup(
        f'<svg xmlns="http://www.w3.org/2000/svg" class="parts" viewBox="0 0 {width:.0f} {height:.0f}" role="img" '
        f'aria-label="{escape(f"Parts of the calibrator. {said}.")}" font-family="sans-serif" font-size="11" '
        f'fill="{STROKE}" stroke="none" style="width: 100%; min-width: {min(width, 600):.0f}px; '
        f'max-width: {width:.0f}px">{shapes}</svg>')


def _part(part: dict[str, Any], scale: float, x: float, y: float, *, last: bool) -> str:
    """One part: from its axis along the offset, then along its length, to the next joint."""
    up, along = scale * part["d"], scale * part["a"]
    left, foot = x + EDGE, y + TALL / 2 + up / 2 + 6
    top, right = foot - up, left + along
    upright = abs(np.sin(part["alpha"])) < 0.5
    end = (f'<circle cx="{right:.1f}" cy="{top:.1f}" r="6" fill="none" stroke="{STROKE}" stroke-width="2"/>'
           if last or not upright else f'<circle cx="{right:.1f}" cy="{top:.1f}" r="5" style="fill: {STROKE}"/>')
    sensor = "" if part["accuracy"] is None else f", sensor ±{plain(np.degrees(part['accuracy']), 3)}°"
    said = "ball" if last else f"twist {plain(np.degrees(part['alpha']), 3)}°"
    text = [
        f'<text x="{x + 6:.1f}" y="{y + 16:.1f}" font-weight="bold">{escape(str(part["name"]))}</text>',
        f'<text x="{x + 6:.1f}" y="{y + 30:.1f}">zero {plain(np.degrees(part["theta"]), 4)}°{sensor}</text>',
        f'<line x1="{left:.1f}" x2="{left:.1f}" y1="{min(foot, top) - 14:.1f}" y2="{max(foot, top) + 14:.1f}" '
        f'stroke="{LIGHT}" stroke-dasharray="8 3 2 3"/>',
        f'<polyline points="{left:.1f},{foot:.1f} {left:.1f},{top:.1f} {right:.1f},{top:.1f}" fill="none" '
        f'stroke="{STROKE}" stroke-width="4" stroke-linejoin="round"/>',
        f'<rect x="{left - 6:.1f}" y="{foot - 6:.1f}" width="12" height="12"/>', end,
        f'<text x="{right:.1f}" y="{top + (22 if up >= 0 else -14):.1f}" text-anchor="middle">'
        f"{said}</text>"]
    if part["a"] > 5e-4:
        at = top - 14 if up >= 0 else top + 22
        text.append(_dimension(left, at, right, at, f"a {_mm(part['a'])}"))
    if abs(part["d"]) > 5e-4:
        text.append(_dimension(left - 22, foot, left - 22, top, f"d {_mm(part['d'])}"))
    return "".join(text)


def _dimension(x1: float, y1: float, x2: float, y2: float, text: str) -> str:
    """A line between two ends with a text on it."""
    level = abs(y2 - y1) < 1e-6
    ticks = "".join(f'<line x1="{x - 4 * (not level):.1f}" x2="{x + 4 * (not level):.1f}" y1="{y - 4 * level:.1f}" '
                    f'y2="{y + 4 * level:.1f}" stroke="{LIGHT}"/>' for x, y in ((x1, y1), (x2, y2)))
    middle = (x1 + x2) / 2, (y1 + y2) / 2
    turn = "" if level else f' transform="rotate(-90 {middle[0]:.1f} {middle[1]:.1f})"'
    return (f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{LIGHT}"/>{ticks}'
            f'<text x="{middle[0]:.1f}" y="{middle[1] - 4:.1f}" text-anchor="middle"{turn}>{escape(text)}</text>')
