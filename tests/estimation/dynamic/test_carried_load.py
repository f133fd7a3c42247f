"""The load that is carried: exactly without noise, inside its interval with it, and silence about what is not seen."""

from __future__ import annotations

import numpy as np
import pytest

from fixtures.periodic import PERIODIC as CAT_PERIODIC
from fixtures.two_sessions import GRIPPING, PERIODIC, PLANAR, SPATIAL, TORQUE_NOISE, recorded, with_load
from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.payload import payload
from hydroopt.machine.machine import Machine
from hydroopt.model.model import Model
from hydroopt.results.diagnostic import of_kind
from hydroopt.spatial import inertia

COM = np.array([0.7, -0.2, 0.15])


def carried(model, m, com, link, *, seeds=(1, 2), noise=0.0, scale=1.0, **asked):
    return payload(model.machine, [recorded(model, model.parameters.nominal, seeds[0], noise, scale=scale)],
                   [recorded(model, with_load(model, m, com, link), seeds[1], noise, scale=scale)],
                   smoothing=PERIODIC, **asked)


def test_a_load_is_weighed_exactly():
    found = carried(SPATIAL, 2.805, COM, "fore")
    assert found.link == "fore"
    assert found.mass.value == pytest.approx(2.805, abs=1e-8)
    assert [one.value for one in found.com] == pytest.approx(COM, abs=1e-8)
    assert [one.value for one in found.moment] == pytest.approx(2.805 * COM, abs=1e-8)
    assert inertia.smallest_eigenvalue(found.phi) > 0


@pytest.mark.slow
def test_an_excavators_load_is_weighed_exactly(cat215b, cat_truth, record):
    loaded = cat_truth.copy()
    k = cat215b.parameters.index("stick.m")
    loaded[k : k + 10] += inertia.from_centre_of_mass(300.0, [1.9, 0.4, 0.0], [9.0, 0, 0, 9.0, 0, 9.0])
    found = payload(cat215b.machine, record(cat215b, cat_truth, (1, 2)), record(cat215b, loaded, (3, 5)),
                    smoothing=CAT_PERIODIC)
    assert found.mass.value == pytest.approx(300.0, abs=1e-8 * 300)
    assert [one.value for one in found.com[:2]] == pytest.approx([1.9, 0.4], abs=1e-8)


def test_across_a_planar_machine_nothing_is_invented():
    found = carried(PLANAR, 1.5, COM, "fore")
    assert found.mass.value == pytest.approx(1.5, abs=1e-8)
    assert [one.value for one in found.com[:2]] == pytest.approx(COM[:2], abs=1e-8)
    assert np.isnan(found.com[2].value)
    assert np.isnan(found.com[2].std)
    (partly,) = of_kind(found.diagnostics, "payload partly identifiable")
    assert partly.subject == ("com_z",)
    assert "z =" not in found.findings[0].text


def test_one_joint_tells_a_moment_but_no_mass():
    wheel = {"name": "crank", "orientation": (np.pi / 2, 0.0, 0.0), "links": [
        {"name": "crank", "parent": "base", "joint": {"type": "revolute", "lower": -2.0, "upper": 2.0,
                                                      "max_speed": 3.0},
         "body": {"m": 4.0, "com": (0.3, 0.0, 0.0), "inertia_com": (0.1, 0.0, 0.0, 0.1, 0.0, 0.1)}}],
        "drives": [{"name": "drive", "joint": "crank", "friction": {"coulomb": 1.0}}]}
    found = carried(Model(Machine.model_validate(wheel)), 2.0, COM, "crank")
    assert np.isnan(found.mass.std)
    assert all(np.isnan(one.std) for one in found.com)
    assert [one.value for one in found.moment[:2]] == pytest.approx(2.0 * COM[:2], abs=1e-8)
    assert found.findings[0].kind == "mass of the payload not identifiable"
    assert "moment is x = 1.4" in found.findings[0].text


@pytest.mark.slow
def test_a_locked_link_without_a_body_carries_in_its_own_frame():
    """The load as seen from the arm that the grip is fixed to: turned by 0.3 rad, at its end and 0.1 m aside."""
    own = np.array([0.2, 0.05, -0.1])
    c, s = np.cos(0.3), np.sin(0.3)
    seen = np.array([1.0 + c * own[0] - s * own[1], s * own[0] + c * own[1], 0.1 + own[2]])
    found = carried(GRIPPING, 1.2, seen, "fore")
    assert found.link == "grip"
    assert found.mass.value == pytest.approx(1.2, abs=1e-8)
    assert [one.value for one in found.com] == pytest.approx(own, abs=1e-8)


@pytest.mark.slow
def test_intervals_hold_a_noisy_load():
    inside = []
    for seed in range(12):
        com = COM + np.random.default_rng(seed).uniform(-0.1, 0.1, 3)
        found = carried(SPATIAL, 1.0, com, "fore", seeds=(100 + seed, 500 + seed), noise=TORQUE_NOISE, seed=seed)
        inside += [one.ci95[0] <= true <= one.ci95[1] for one, true in zip((found.mass, *found.com), (1.0, *com),
                                                                            strict=True)]
    assert np.mean(inside) >= 0.85  # of 48; 95 % are expected, and the study counts more


@pytest.mark.slow
def test_friction_may_grow_with_the_load():
    model, name = SPATIAL, "upper_drive.tau_coulomb"
    loaded = with_load(model, 1.0, COM, "fore")
    loaded[model.parameters.index(name)] += 1.5
    logs = [recorded(model, model.parameters.nominal, 1)], [recorded(model, loaded, 2)]
    found = payload(model.machine, *logs, smoothing=PERIODIC, friction_changes=True)
    assert found.mass.value == pytest.approx(1.0, abs=1e-8)
    assert {one.name: one.value for one in found.friction}[name] == pytest.approx(1.5, abs=1e-8)
    noisy = [recorded(model, model.parameters.nominal, 1, 0.1)], [recorded(model, loaded, 2, 0.1)]
    found = payload(model.machine, *noisy, smoothing=PERIODIC, friction_changes=True)
    assert found.mass.ci95[0] < 1.0 < found.mass.ci95[1]
    for one in found.friction:
        low, high = one.ci95
        assert low - one.std < (1.5 if one.name == name else 0.0) < high + one.std
        assert (low > 0) == (one.name == name)


@pytest.mark.slow
def test_a_misread_scale_is_told_by_what_is_known_of_the_arm():
    """Torques that read 8 % too much make the load 8 % too heavy, unless the machine file's masses may speak."""
    known = SPATIAL.machine.model_copy(update={"notes": {key: note.model_copy(update={"sigma": 0.01})
                                                         for key, note in SPATIAL.machine.notes.items()}})
    model = Model(known)
    trusting = carried(model, 1.0, COM, "fore", noise=TORQUE_NOISE / 5, scale=1.08)
    doubting = carried(model, 1.0, COM, "fore", noise=TORQUE_NOISE / 5, scale=1.08, gain=0.1)
    assert trusting.mass.ci95[0] > 1.0
    assert of_kind(trusting.diagnostics, "scale of force readings assumed exact")
    assert doubting.mass.ci95[0] < 1.0 < doubting.mass.ci95[1]
    assert abs(doubting.mass.value - 1.0) < 0.02
    for gain in doubting.gains:
        assert gain.ci95[0] < 0.08 < gain.ci95[1]


@pytest.mark.slow
def test_a_light_load_is_still_a_possible_one():
    found = carried(SPATIAL, 0.0, COM, "fore", noise=TORQUE_NOISE)
    assert found.mass.ci95[0] >= 0
    assert inertia.smallest_eigenvalue(found.phi) >= 0
    assert found.p_value > 0.05


def test_an_unknown_link():
    logs = [recorded(SPATIAL, SPATIAL.parameters.nominal, seed) for seed in (1, 2)]
    with pytest.raises(ProblemError, match="no link 'hook'"):
        payload(SPATIAL.machine, logs[:1], logs[1:], link="hook", smoothing=PERIODIC)


@pytest.mark.parametrize("gain", [-0.1, 1.0, float("nan")])
def test_a_gain_is_a_part(gain):
    with pytest.raises(ProblemError, match="relative error must be at least 0"):
        carried(SPATIAL, 1.0, COM, "fore", gain=gain)
