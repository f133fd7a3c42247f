"""The parameter vector: whose numbers stand where, what bounds them, and what the file's confidences mean."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.parameters.dynamic import bodies, parameter_set
from hydroopt.spatial import inertia

ELEMENTS = ("m", "mc_x", "mc_y", "mc_z", "I_xx", "I_xy", "I_xz", "I_yy", "I_yz", "I_zz")


def body(m: float) -> dict:
    """A body whose every number is its own: its elements are m + 0, m + 1, … with mass m."""
    return {"m": m, "mc": (m + 1, m + 2, m + 3), "inertia": (m + 4, m + 5, m + 6, m + 7, m + 8, m + 9)}


EVERYTHING = {
    "name": "everything",
    "links": [
        {
            "name": "turret",
            "parent": "base",
            "body": body(100),
            "joint": {
                "type": "revolute",
                "alpha": -1.5,
                "lower": -2,
                "upper": 2,
                "friction": {"coulomb": 11, "viscous": 12},
            },
        },
        {
            "name": "boom",
            "parent": "turret",
            "body": body(200),
            "joint": {"type": "revolute", "a": 2.0, "lower": 0.2, "upper": 1.2, "friction": {"viscous": 13}},
        },
        {"name": "bracket", "parent": "boom", "body": body(300), "joint": {"type": "locked"}},
        {
            "name": "slide",
            "parent": "bracket",
            "body": body(400),
            "joint": {"type": "prismatic", "lower": 0, "upper": 1, "friction": {"coulomb": 14, "viscous": 15}},
        },
        {"name": "tool", "parent": "slide", "joint": {"type": "revolute", "lower": -1, "upper": 1}},
    ],
    "motors": [
        {
            "name": "turret_motor",
            "joint": "turret",
            "torque_per_pressure": 1e-4,
            "friction": {"offset": -1, "coulomb": 2, "viscous": 3},
        }
    ],
    "drives": [
        {"name": "slide_drive", "joint": "slide", "rotor_inertia": 0.5, "friction": {"offset": 4, "coulomb": 5}},
        {"name": "tool_drive", "joint": "tool", "friction": {"viscous": 6}},
    ],
    "cylinders": [
        {
            "name": "boom_cylinder",
            "bore": 0.1,
            "rod_diameter": 0.06,
            "dead_length": 0.3,
            "stroke": 2.0,
            "barrel": {"link": "turret", "pin": (0.4, 0.1, 0.0), "body": body(500)},
            "rod": {"link": "boom", "pin": (1.0, 0.2, 0.0), "body": body(600)},
            "friction": {"offset": -21, "coulomb": 22, "viscous": 23, "barrel_pin": 24, "rod_pin": 25},
        }
    ],
    "gas_cylinders": [
        {
            "name": "gas",
            "acts": "push",
            "area": 0.002,
            "volume": 0.004,
            "reference_length": 0.8,
            "precharge": 5e6,
            "barrel": {"link": "turret", "pin": (0.4, 0.3, 0.0)},
            "rod": {"link": "boom", "pin": (0.6, -0.2, 0)},
        }
    ],
    "notes": {
        "boom.body.m": Note(lower=150.0, upper=260.0),
        "boom_cylinder.friction.offset": Note(upper=0.0),
        "turret_motor.friction.coulomb": Note(lower=1.0, sigma=0.5, relative=True),
        "turret_motor.friction.offset": Note(sigma=0.25),
        "slide_drive.friction.offset": Note(sigma=0.5, relative=True),
    },
}


@pytest.fixture(scope="module")
def everything() -> Machine:
    return Machine.model_validate(EVERYTHING)


def block(owner: str, m: float) -> list[tuple[str, float]]:
    return [(f"{owner}.{element}", m + k) for k, element in enumerate(ELEMENTS)]


def test_order_and_nominal_values(everything: Machine) -> None:
    """Eq. 4.53 to 4.55: joint after joint, link, rod, barrel, then friction of the joint and of its actuator."""
    expected = [
        *block("turret", 100),
        ("turret.tau_coulomb", 11),
        ("turret.tau_viscous", 12),
        ("turret_motor.tau_offset", -1),
        ("turret_motor.tau_coulomb", 2),
        ("turret_motor.tau_viscous", 3),
        *block("boom", 200),
        *block("boom_cylinder.rod", 600),
        *block("boom_cylinder.barrel", 500),
        ("boom.tau_viscous", 13),
        ("boom_cylinder.f_offset", -21),
        ("boom_cylinder.f_coulomb", 22),
        ("boom_cylinder.f_viscous", 23),
        ("boom_cylinder.n_barrel", 24),
        ("boom_cylinder.n_rod", 25),
        *block("bracket", 300),
        *block("slide", 400),
        ("slide.tau_coulomb", 14),
        ("slide.tau_viscous", 15),
        ("slide_drive.tau_offset", 4),
        ("slide_drive.tau_coulomb", 5),
        ("slide_drive.rotor_inertia", 0.5),
        ("tool_drive.tau_viscous", 6),
        ("gas.precharge", 5e6),
    ]
    parameters = parameter_set(everything)
    assert list(zip(parameters.names, parameters.nominal.tolist(), strict=True)) == expected


def test_reduced_model_leaves_barrels_and_rods_out(everything: Machine) -> None:
    complete, reduced = parameter_set(everything), parameter_set(everything, actuator_inertia=False)
    gone = [name for name in complete.names if name not in reduced.names]
    assert gone == [f"boom_cylinder.{end}.{element}" for end in ("rod", "barrel") for element in ELEMENTS]
    assert list(bodies(everything, actuator_inertia=False)) == ["turret", "boom", "bracket", "slide"]
    assert list(bodies(everything)) == [
        "turret",
        "boom",
        "boom_cylinder.rod",
        "boom_cylinder.barrel",
        "bracket",
        "slide",
    ]


def test_units_follow_the_kind_of_joint(everything: Machine) -> None:
    parameters = parameter_set(everything)
    unit = dict(zip(parameters.names, parameters.units, strict=True))
    assert [unit[f"boom.{element}"] for element in ELEMENTS] == ["kg", *["kg*m"] * 3, *["kg*m^2"] * 6]
    assert (unit["turret.tau_coulomb"], unit["turret.tau_viscous"]) == ("N*m", "N*m*s/rad")
    assert (unit["slide.tau_coulomb"], unit["slide.tau_viscous"], unit["slide_drive.tau_offset"]) == ("N", "N*s/m", "N")
    assert (unit["boom_cylinder.f_viscous"], unit["boom_cylinder.n_rod"]) == ("N*s/m", "N*m")
    assert unit["gas.precharge"] == "Pa"


def test_bounds_are_those_of_nature_and_of_the_file(everything: Machine) -> None:
    parameters = parameter_set(everything)
    bounds = {name: (parameters.lower[k], parameters.upper[k]) for k, name in enumerate(parameters.names)}
    inf = np.inf
    assert bounds["turret.m"] == (0, inf)
    assert bounds["boom.m"] == (150, 260)
    assert bounds["boom.mc_x"] == bounds["boom.I_xx"] == (-inf, inf)
    assert bounds["boom_cylinder.f_offset"] == (-inf, 0)
    assert bounds["slide_drive.tau_offset"] == (-inf, inf)
    assert bounds["turret_motor.tau_coulomb"] == (1, inf)
    for name in ("boom.tau_viscous", "boom_cylinder.n_rod", "slide_drive.rotor_inertia", "gas.precharge"):
        assert bounds[name] == (0, inf)


def test_prior_of_a_number_is_its_sigma(everything: Machine) -> None:
    parameters = parameter_set(everything)
    information = {name: parameters.information[k, k] for k, name in enumerate(parameters.names)}
    assert information["turret_motor.tau_offset"] == pytest.approx(16)
    assert information["turret_motor.tau_coulomb"] == pytest.approx(1)  # 50 % of 2
    assert information["slide_drive.tau_offset"] == pytest.approx(0.25)  # 50 % of 4
    assert information["boom_cylinder.f_coulomb"] == 0


def test_parts_of_the_prior_belong_to_one_body_each(everything: Machine) -> None:
    information = parameter_set(everything).information
    np.testing.assert_allclose(information, information.T, rtol=1e-9)
    names = parameter_set(everything).names
    for row, column in zip(*np.nonzero(information), strict=True):
        assert names[row].rpartition(".")[0] == names[column].rpartition(".")[0]


@pytest.mark.parametrize("stated", ["sigma absolute", pytest.param("sigma in percent", marks=pytest.mark.slow)])
@pytest.mark.slow
def test_confidences_of_mass_centre_and_inertia_propagate_as_monte_carlo_shows(stated: str) -> None:
    m, com, six = 50.0, np.array([1.2, -0.4, 0.3]), np.array([3.0, 0.2, -0.1, 9.0, 0.3, 8.0])
    sigma = {"m": 2.0, "com": 0.012, "inertia_com": 0.36}
    notes = {key: Note(sigma=value) for key, value in sigma.items()}
    if stated == "sigma in percent":  # of the largest of a vector's numbers
        notes = {"m": Note(sigma=0.04, relative=True), "com": Note(sigma=0.01, relative=True),
                 "inertia_com": Note(sigma=0.04, relative=True)}
    data = load_machine("patu655_lift").model_dump(exclude={"notes"})
    data["links"][0]["body"] = {"m": m, "com": tuple(com), "inertia_com": tuple(six)}
    machine = Machine.model_validate(data | {"notes": {f"lift.body.{key}": note for key, note in notes.items()}})
    prior = np.linalg.inv(parameter_set(machine).information[:10, :10])

    rng = np.random.default_rng(0)
    draws = np.array([inertia.from_centre_of_mass(m + sigma["m"] * rng.standard_normal(),
                                                  com + sigma["com"] * rng.standard_normal(3),
                                                  six + sigma["inertia_com"] * rng.standard_normal(6))
                      for _ in range(20_000)])
    expected = np.cov(draws.T)
    size = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(np.sqrt(np.diag(prior)), size, rtol=0.03)
    np.testing.assert_allclose(prior / np.outer(size, size), expected / np.outer(size, size), atol=0.03)
    np.testing.assert_allclose(parameter_set(machine).scale[:10], np.sqrt(np.diag(prior)), rtol=1e-6)


def test_first_moment_and_inertia_about_the_origin_are_independent() -> None:
    data = load_machine("cat215b", parameter_set="thesis_literal")
    prior = np.linalg.inv(parameter_set(data).information[:10, :10])
    np.testing.assert_allclose(np.sqrt(np.diag(prior)), [0.2 * 8031, *[0.2 * 8433] * 3, *[0.2 * 15700] * 6], rtol=1e-9)
    np.testing.assert_allclose(prior, np.diag(np.diag(prior)), atol=1e-6 * np.max(prior))


def test_nothing_stated_is_nothing_precise(everything: Machine) -> None:
    """Without a stated confidence every element may still be off by about its own size."""
    parameters = parameter_set(everything)
    for owner in ("turret", "slide", "boom_cylinder.rod"):
        k = parameters.index(f"{owner}.m")
        std = np.sqrt(np.diag(np.linalg.inv(parameters.information[k:k + 10, k:k + 10])))
        assert np.all(std >= 0.99 * np.abs(parameters.nominal[k:k + 10]))


def test_an_impossible_nominal_body_is_no_numerical_accident() -> None:
    """A file may state what cannot exist (the estimate need not keep it); it must not end in the root of −1."""
    data = load_machine("patu655_lift").model_dump(exclude={"notes"})
    data["links"][0]["body"] = {"m": 3.0, "mc": (0.1, 0.2, 0.3), "inertia": (0.7, 0.1, 0.1, -1.4, 0.1, -2.5)}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parameters = parameter_set(Machine.model_validate(data))
    assert np.all(np.isfinite(parameters.scale))
    assert np.all(np.isfinite(parameters.information))
