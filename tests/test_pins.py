"""Where pins stand: pins.svg is what crane.toml gives, and lengths follow from pins as pins.md says."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from hydroopt import Model, load_machine, read_machine

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs/how-to"
CRANE = (DOCS / "crane.toml").read_text("utf-8")


def step(angle: float, axis: int, move: tuple[float, float, float]) -> np.ndarray:
    """A translation, then a rotation about an axis: (4, 4)."""
    turn, (j, k) = np.eye(4), ((axis + 1) % 3, (axis + 2) % 3)
    turn[[j, k], [j, k]] = np.cos(angle)
    turn[j, k], turn[k, j] = -np.sin(angle), np.sin(angle)
    turn[:3, 3] = move
    return turn


def lengths(text: str, q: tuple[float, float]) -> np.ndarray:
    """Lengths [m] of both cylinders at angles [rad]."""
    model = Model(read_machine(text))
    return np.array(model.cylinder_kinematics(np.array(q), np.zeros(2), np.zeros(2))[0]).ravel()


@pytest.mark.parametrize("q", [(0.3, -1.2), (0.8, -0.7)])
def test_pins_stand_behind_d_and_theta_but_before_a_and_alpha(q: tuple[float, float]) -> None:
    text = CRANE.replace('a = "2.9 m"', 'a = "2.9 m", d = "0.05 m", theta = "-1.5 deg", alpha = "7 deg"').replace(
        'a = "2.0 m"', 'a = "2.0 m", d = "-0.03 m", alpha = "50 deg"')
    lift = step(q[0] + np.radians(-1.5), 2, (0, 0, 0.05))
    jib = lift @ step(np.radians(7), 0, (2.9, 0, 0)) @ step(q[1], 2, (0, 0, -0.03))
    pins = [(np.eye(4), (0.25, -1.0, 0, 1)), (lift, (1.10, -0.15, 0, 1)), (lift, (1.20, 0.30, 0, 1)),
            (jib, (-0.20, 0.40, 0, 1))]
    base_end, lift_rod, lift_barrel, jib_rod = (frame @ np.array(local) for frame, local in pins)
    by_hand = [np.linalg.norm(lift_rod - base_end), np.linalg.norm(jib_rod - lift_barrel)]
    np.testing.assert_allclose(lengths(text, q), by_hand, rtol=1e-12)
    longer = text.replace('a = "2.0 m"', 'a = "3.0 m"').replace('alpha = "50 deg"', 'alpha = "-20 deg"')
    np.testing.assert_allclose(lengths(longer, q), by_hand, rtol=1e-12)


def test_the_picture_is_drawn_from_the_crane() -> None:
    drawn = runpy.run_path(str(DOCS / "pins.py"))["drawing"]()
    assert drawn == (DOCS / "pins.svg").read_text("utf-8"), "run python docs/how-to/pins.py"
    for text in ("(0.25, −1.00) barrel, in the base frame", "(1.10, −0.15) rod, in P of lift", "a of jib = 2.0 m"):
        assert text in drawn
    for cylinder in load_machine(DOCS / "crane.toml").cylinders:
        for attachment in (cylinder.barrel, cylinder.rod):
            assert "({:.2f}, {:.2f})".format(*attachment.pin[:2]).replace("-", "−") in drawn


def test_documents_point_to_the_picture() -> None:
    assert "(pins.svg)" in (DOCS / "pins.md").read_text("utf-8")
    assert "../how-to/pins.md" in (ROOT / "docs/tutorials/crane_by_hand.md").read_text("utf-8")
    for name in ("cat215b", "patu655_lift"):
        assert "docs/how-to/pins.md" in (ROOT / f"models/{name}.toml").read_text("utf-8")
