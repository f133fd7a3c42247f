"""Paths of a point by two geometries: Eqs. 3.44 and 3.46 by hand, both ends of the chain, and refusals."""

from __future__ import annotations

import numpy as np
import pytest

from hydroopt.errors import ProblemError
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.model.path_difference import path_difference

MACHINE = load_machine("cat215b")
RNG = np.random.default_rng(0)
ANGLES = {name: RNG.uniform(-1, 1, 30) for name in KinematicModel(MACHINE).joints}


def test_places_are_those_of_the_closed_chain() -> None:
    model = KinematicModel(MACHINE)
    changed = {"boom.a": 5.2, "swing.alpha": -1.55, "stick.beta": 0.02}
    second = MACHINE.with_values(changed)
    q = np.column_stack([ANGLES[name] for name in model.joints])
    found = path_difference(MACHINE, second, ANGLES)
    g = np.array([changed.get(name, value) for name, value in zip(
        model.parameters.names, model.parameters.nominal, strict=True)])
    ends = [model.over(model.tip, geometry, q)[0][:, :, 0] for geometry in (model.parameters.nominal, g)]
    np.testing.assert_allclose(found.first, ends[0], atol=1e-13)
    np.testing.assert_allclose(found.second, ends[1], atol=1e-13)
    apart = ends[1] - ends[0]
    assert found.rms == pytest.approx(np.sqrt(np.mean(np.sum(apart**2, axis=1))))
    assert found.vaf == pytest.approx(1 - np.sum(apart**2) / np.sum((ends[0] - ends[0].mean(axis=0)) ** 2))


def test_from_the_calibrator_only_its_own_links_count() -> None:
    """The thesis's grapple is exactly right from the calibrator's side (RMS 0.000 m), since nothing there changed."""
    second = MACHINE.with_values({"boom.a": 5.2, "swing.a": 0.4, "stick.a": 1.9})
    calibrator = {name: ANGLES[name] for name in ("grapple", "yoke", "upper_arm", "forearm")}
    for point in ("grapple_swing", "grapple"):
        assert path_difference(MACHINE, second, calibrator, point, seen_from="forearm").rms == 0
    longer = MACHINE.with_values({"boom.a": 5.2})
    of_stick = path_difference(MACHINE, longer, {"stick": ANGLES["stick"], "boom": ANGLES["boom"]}, "stick",
                               seen_from="swing")
    assert of_stick.rms == pytest.approx(0.02)


@pytest.mark.parametrize(("angles", "point", "sentence"), [
    ({"swing": [0.0]}, "stick", "the angle of joint 'boom' is missing"),
    (ANGLES, "bucket", "there is no link 'bucket'"),
    ({**ANGLES, "boom": [0.0]}, "stick", "angles have the shapes")])
def test_refusals(angles: dict[str, object], point: str, sentence: str) -> None:
    with pytest.raises(ProblemError, match=sentence):
        path_difference(MACHINE, MACHINE, angles, point)  # type: ignore[arg-type]
