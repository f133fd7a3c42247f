"""Machine files: units, what is said about numbers, parameter sets, and the bundled machines against the thesis."""

from __future__ import annotations

import tomllib
from typing import Any

import numpy as np
import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from fixtures.bad_input_cases import DIGGER
from fixtures.tiers import ONE_OF_A_KIND, machines
from hydroopt.errors import MachineError
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import bundled, dump_machine, load_machine, read_machine
from hydroopt.model.model import Model
from studies.first_contact import machine_files

INCH, PSI = 0.0254, 6894.757293168

ARM = """
name = "arm"
default_parameter_set = "light"
bandwidth = "3 Hz"
[[links]]
name = "turret"
joint = { type = "revolute", d = "40 cm", alpha = "90 deg", lower = "-170 deg", upper = "170 deg" }
[[links]]
name = "boom"
[links.joint]
type = "revolute"
a = { value = "2.5 m", sigma = "3 mm", source = "drawing 12" }
lower = "12 deg"
upper = "80 deg"
max_speed = "20 deg/s"
friction = { coulomb = { value = "120 N*m", sigma = "25 %", upper = "1 kN*m" } }
[[links]]
name = "slide"
joint = { type = "prismatic", lower = "0 mm", upper = "700 mm", max_acceleration = "0.5 m/s^2" }
[links.body]
m = "90 kg"
mc = ["45 kg*m", "0 kg*m", "0 kg*m"]
inertia = ["1 kg*m^2", "0 kg*m^2", "0 kg*m^2", "40 kg*m^2", "0 kg*m^2", "40 kg*m^2"]
[[motors]]
name = "turret_motor"
joint = "turret"
torque_per_pressure = "12 N*m/bar"
gear = 6.5
relief_pressure = "250 bar"
[[drives]]
name = "slide_drive"
joint = "slide"
rotor_inertia = "20 g*m^2"
[[cylinders]]
name = "boom_cylinder"
jacks = 2
bore = "80 mm"
rod_diameter = "50 mm"
dead_length = "0.4 m"
stroke = "1.5 m"
barrel = { link = "turret", pin = { value = ["0.3 m", "0.1 m", "0 m"], sigma = "1 cm" } }
rod = { link = "boom", pin = ["1.1 m", "0.2 m", "0 m"] }
[[gas_cylinders]]
name = "balance"
acts = "push"
area = "20 cm^2"
volume = "4 L"
reference_length = "0.8 m"
precharge = { value = "50 bar", sigma = "2 bar" }
polytropic = 1.3
barrel = { link = "turret", pin = ["0.4 m", "0.3 m", "0 m"] }
rod = { link = "boom", pin = ["0.6 m", "-0.2 m", "0 m"] }
[[sensors]]
channels = ["slide.q"]
accuracy = "1 mm"
distribution = "gaussian"
[[sensors]]
channels = ["boom.q", "turret.q"]
accuracy = { value = "0.05 deg", source = "data sheet" }
resolution = "0.01 deg"
rate = "100 Hz"
[parameter_sets.light.boom]
m = { value = "200 kg", sigma = "10 %" }
com = { value = ["1.2 m", "0 m", "0 m"], sigma = "5 cm" }
inertia_com = ["2 kg*m^2", "0 kg*m^2", "0 kg*m^2", "90 kg*m^2", "0 kg*m^2", "90 kg*m^2"]
[parameter_sets.light.boom_cylinder.barrel]
m = "30 kg"
mc = ["9 kg*m", "0 kg*m", "0 kg*m"]
inertia = ["1 kg*m^2", "0 kg*m^2", "0 kg*m^2", "4 kg*m^2", "0 kg*m^2", "4 kg*m^2"]
[parameter_sets.light.boom_cylinder.rod]
m = "20 kg"
mc = ["-8 kg*m", "0 kg*m", "0 kg*m"]
inertia = ["1 kg*m^2", "0 kg*m^2", "0 kg*m^2", "5 kg*m^2", "0 kg*m^2", "5 kg*m^2"]
[parameter_sets.heavy.boom]
m = "400 kg"
com = ["1.3 m", "0 m", "0 m"]
inertia_com = ["4 kg*m^2", "0 kg*m^2", "0 kg*m^2", "180 kg*m^2", "0 kg*m^2", "180 kg*m^2"]
"""


@pytest.fixture(scope="module")
def arm() -> Machine:
    return read_machine(ARM)


def test_everything_is_si_inside(arm: Machine) -> None:
    turret, boom, slide = (link.joint for link in arm.links)
    assert (turret.d, turret.alpha) == (pytest.approx(0.4), pytest.approx(np.pi / 2))
    assert (boom.a, boom.upper, boom.max_speed) == (2.5, pytest.approx(np.radians(80)), pytest.approx(np.pi / 9))
    assert (slide.upper, slide.max_acceleration) == (pytest.approx(0.7), 0.5)
    assert arm.motors[0].torque_per_pressure == pytest.approx(12e-5)
    assert arm.motors[0].relief_pressure == pytest.approx(25e6)
    assert arm.drives[0].rotor_inertia == pytest.approx(0.02)
    gas = arm.gas_cylinders[0]
    assert (gas.area, gas.volume, gas.precharge) == (pytest.approx(2e-3), pytest.approx(4e-3), pytest.approx(5e6))
    np.testing.assert_allclose(arm.cylinders[0].areas, np.pi * 2 * np.array([0.04**2, 0.04**2 - 0.025**2]))
    assert arm.sensors[1].accuracy == pytest.approx(np.radians(0.05))
    assert arm.sensors[0].accuracy == pytest.approx(1e-3)
    assert arm.bandwidth == 3


def test_a_serial_chain_needs_no_parents(arm: Machine) -> None:
    assert [link.parent for link in arm.links] == ["base", "turret", "boom"]
    branched = read_machine(ARM.replace('name = "slide"\n', 'name = "slide"\nparent = "turret"\n', 1))
    assert branched.link("slide").parent == "turret"


def test_what_is_said_about_numbers(arm: Machine) -> None:
    notes = arm.notes
    assert (notes["boom.joint.a"].sigma, notes["boom.joint.a"].relative) == (pytest.approx(0.003), False)
    assert notes["boom.joint.a"].source == "drawing 12"
    coulomb = notes["boom.joint.friction.coulomb"]
    assert (coulomb.sigma, coulomb.relative, coulomb.lower, coulomb.upper) == (
        pytest.approx(0.25),
        True,
        None,
        pytest.approx(1000),
    )
    assert notes["boom_cylinder.barrel.pin"].sigma == pytest.approx(0.01)
    assert (notes["boom.body.m"].sigma, notes["boom.body.com"].sigma) == (pytest.approx(0.1), pytest.approx(0.05))
    assert notes["balance.precharge"].sigma == pytest.approx(2e5)
    assert any(note.source == "data sheet" for note in notes.values())


def test_parameter_sets(arm: Machine) -> None:
    heavy = read_machine(ARM, parameter_set="heavy")
    assert (arm.parameter_set, heavy.parameter_set) == ("light", "heavy")
    assert arm.link("boom").body is not None
    assert arm.link("boom").body.m == 200
    assert heavy.link("boom").body is not None
    assert heavy.link("boom").body.m == 400
    (cylinder,) = arm.cylinders
    assert (cylinder.barrel.body.m, cylinder.rod.body.m, cylinder.rod.body.mc) == (30, 20, (-8, 0, 0))  # type: ignore[union-attr]
    assert heavy.cylinders[0].barrel.body is None
    with pytest.raises(MachineError, match=r"no parameter set 'middle'.*light, heavy"):
        read_machine(ARM, parameter_set="middle")


@pytest.mark.parametrize("chosen", ["light", "heavy"])
def test_a_set_is_validated_whether_it_is_chosen_or_not(chosen: str) -> None:
    for old, new, words in (('m = "30 kg"', 'm = "30 m"', r"light.boom_cylinder.barrel.m: 'm' is not a unit"),
                            ('m = "400 kg"', "m = [1]", r"heavy.boom.m: must be a number, not '.1.'"),
                            ('m = "400 kg"', "size = 3", r"heavy.boom.size: this key is unknown"),
                            ("heavy.boom]", "heavy.jib]", r"heavy.jib: .*'heavy' names 'jib', which does not exist")):
        with pytest.raises(MachineError, match=rf"parameter_sets.{words}"):
            read_machine(ARM.replace(old, new), parameter_set=chosen)


def test_spoilt_tables_end_in_a_machine_or_a_sentence() -> None:
    found = machine_files.run(100)
    assert found["machine_files_tracebacks"] == found["machine_files_hangs"] == 0
    assert 3 < found["machine_files_read"] < 50


@pytest.mark.parametrize("name", machines())
def test_bundled_machines_survive_being_written(name: str) -> None:
    machine = load_machine(name)
    again = read_machine(dump_machine(machine))
    assert again == machine
    assert again.notes == machine.notes
    np.testing.assert_array_equal(Model(again).parameters.information, Model(machine).parameters.information)


def test_a_made_up_machine_survives_being_written(arm: Machine) -> None:
    for machine in (arm, read_machine(ARM, parameter_set="heavy")):
        again = read_machine(dump_machine(machine))
        assert again == machine
        assert again.notes.keys() == machine.notes.keys()


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    """Zero, or what a machine file does not refuse as too small."""
    return st.floats(low, high).map(lambda x: x if abs(x) > 1e-59 else 0.0)


@given(lengths=st.lists(numbers(-1e3, 1e3), min_size=3, max_size=3), angle=numbers(0, 3.2),
       middle=numbers(-3, 3), half=st.floats(1e-3, 3), sigma=st.floats(1e-9, 1e3),
       mass=st.floats(1e-3, 1e6), note=st.text(st.characters(codec="utf-8", exclude_categories=["C"]), max_size=20))
@pytest.mark.slow
def test_any_number_survives_being_written_to_its_last_bit(
        lengths: list[float], angle: float, middle: float, half: float, sigma: float, mass: float, note: str) -> None:
    link = {"name": "arm", "parent": "base", "joint": {
        "type": "revolute", "a": lengths[0], "d": lengths[1], "alpha": angle, "lower": middle - half,
        "upper": middle + half, "friction": {"coulomb": abs(lengths[2])}}, "body": {
            "m": mass, "mc": tuple(lengths), "inertia": (mass, 0.0, 0.0, mass, 0.0, mass)}}
    notes = {"arm.joint.a": Note(sigma=sigma, source=note), "arm.body.m": Note(sigma=sigma)}
    machine = Machine.model_validate({"name": "arm", "links": [link], "notes": notes,
                                      "drives": [{"name": "drive", "joint": "arm"}]})
    again = read_machine(dump_machine(machine))
    assert again == machine
    assert again.sha256 == machine.sha256


def shuffled(node: Any) -> Any:
    """The same document with all keys in reverse order."""
    if isinstance(node, dict):
        return {key: shuffled(node[key]) for key in reversed(node)}
    return [shuffled(item) for item in node] if isinstance(node, list) else node


@pytest.mark.parametrize(
    "text", [ARM, *(dump_machine(load_machine(name)) for name in ONE_OF_A_KIND)], ids=["arm", *ONE_OF_A_KIND]
)
def test_digest_is_that_of_the_content_not_of_its_layout(text: str) -> None:
    machine = read_machine(text)
    again = read_machine(tomli_w.dumps(shuffled(tomllib.loads(text))))
    assert again == machine
    assert again.sha256 == machine.sha256
    spaced = read_machine("# a remark\n" + text.replace(" = ", "   =  ", 3))
    assert spaced.sha256 == machine.sha256


def test_digest_changes_with_the_content(arm: Machine) -> None:
    for old, new in (
        ('"2.5 m"', '"2.501 m"'),
        ('"drawing 12"', '"drawing 13"'),
        ('"3 mm"', '"4 mm"'),
        ("jacks = 2", "jacks = 1"),
    ):
        assert read_machine(ARM.replace(old, new, 1)).sha256 != arm.sha256


def test_friction_is_written_in_the_units_of_its_joint() -> None:
    text = ARM.replace('rotor_inertia = "20 g*m^2"', """rotor_inertia = "20 g*m^2"
friction = { coulomb = { value = "2 kN", sigma = "1 kN" }, viscous = "3 kN*s/m" }""")
    sliding = read_machine(text)
    written = dump_machine(sliding)
    assert '"2000.0 N"' in written
    assert '"3000.0 N*s/m"' in written
    assert read_machine(written) == sliding
    with pytest.raises(MachineError, match=r"drives\[slide_drive\]\.friction\.coulomb: 'kN\*m'"):
        read_machine(text.replace('"2 kN"', '"2 kN*m"').replace('"1 kN"', '"1 kN*m"'))


def test_gas_keeps_a_volume(arm: Machine) -> None:
    """Within the range a dead point at 18.4 deg is where the cylinder is shortest."""
    angles = np.radians(np.linspace(12, 80, 10001))
    states = np.column_stack([0 * angles, angles, 0 * angles])
    model = Model(arm)
    shortest = np.min(model.over(model.cylinder_kinematics, states, 0 * states, 0 * states)[0][:, 1, 0])
    least = 2 * (0.8 - shortest)  # litres: 20 cm² times the way from the reference length
    assert read_machine(ARM.replace('"4 L"', f'"{least + 0.001:.4f} L"', 1)).gas_cylinders[0].volume > 0
    with pytest.raises(MachineError, match=r"gas of 'balance' .* volume of -0\.001 l at boom = 18\.4 deg"):
        read_machine(ARM.replace('"4 L"', f'"{least - 0.001:.4f} L"', 1))


def test_gas_pushes_in_a_direction() -> None:
    """A pin that passes through the other one leaves the force without a direction."""
    ends = (('"0.4 m", "0.3 m", "0 m"', '"0 m", "0 m", "0 m"'), ('"0.6 m", "-0.2 m", "0 m"', '"0 m", "0 m", "0 m"'))
    text = ARM
    for old, new in ends:
        assert old in text
        text = text.replace(old, new, 1)
    with pytest.raises(MachineError, match="'balance'"):
        read_machine(text)


def test_paths_and_names(tmp_path: Any, arm: Machine) -> None:
    (tmp_path / "arm.toml").write_text(ARM, encoding="utf-8")
    assert load_machine(tmp_path / "arm.toml") == arm
    assert set(bundled()) >= {"cat215b", "kr300", "patu655_lift"}
    with pytest.raises(MachineError, match=r"no\.toml"):
        load_machine(tmp_path / "no.toml")
    with pytest.raises(MachineError, match="cat215b"):
        load_machine("cat215")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('d = "40 cm"', "d = 0.4", r"turret.*joint\.d.*0\.4 has no unit"),
        ('d = "40 cm"', 'd = "40 deg"', r"joint\.d.*'deg'"),
        ('sigma = "3 mm"', 'sigma = "3 deg"', "boom"),
        ('sigma = "3 mm"', 'sigma = "-3 mm"', "positive"),
        ('"arm"', '"arm', "TOML"),
        ("[[motors]]", "[[engines]]", "engines"),
        ('stroke = "1.5 m"', "", "stroke.*missing"),
        ('stroke = "1.5 m"', 'stroke = "0.2 m"', "boom_cylinder.*m long"),
        ('lower = "12 deg"', 'lower = "-60 deg"', "dead point at boom|m long at boom"),
        ('"boom.q", "turret.q"', '"boom.q", "slide.q"', "slide"),
    ],
)
def test_mistakes_are_found_where_they_are(old: str, new: str, words: str) -> None:
    assert old in ARM
    with pytest.raises(MachineError, match=words) as refusal:
        read_machine(ARM.replace(old, new, 1), where="arm.toml")
    assert refusal.value.where.startswith("arm.toml")


# --- the excavator of the thesis


@pytest.fixture(scope="module")
def excavator() -> Machine:
    return load_machine("cat215b")


@pytest.mark.parametrize(("cylinder", "joint", "sides", "offset"), [
    ("boom_cylinder", "boom", (0.625, 2.000), -78.6), ("stick_cylinder", "stick", (2.444, 0.720), 10.3)])
def test_cylinder_triangles_of_tables_3_and_11(
    excavator: Machine, cylinder: str, joint: str, sides: tuple[float, float], offset: float
) -> None:
    (part,) = [c for c in excavator.cylinders if c.name == cylinder]
    found = Geometry(excavator).triangle(part)
    assert found is not None
    assert found[0] == joint
    fixed, moving, angle, lateral = (float(v) for v in found[1])
    assert (fixed, moving) == (pytest.approx(sides[0], abs=5e-4), pytest.approx(sides[1], abs=5e-4))
    wrapped = (np.degrees(angle) - offset + 180) % 360 - 180
    assert wrapped == pytest.approx(0, abs=0.1)
    assert lateral == pytest.approx(0, abs=1e-9)


def test_areas_and_worst_errors_of_section_4_4_3(excavator: Machine) -> None:
    boom, stick = excavator.cylinders
    np.testing.assert_allclose(boom.areas, np.array([31.8, 19.92]) * INCH**2, rtol=1e-9)
    np.testing.assert_allclose(stick.areas, np.array([23.75, 14.13]) * INCH**2, rtol=1e-9)
    (motor,) = excavator.motors
    assert motor.torque_per_pressure * motor.gear * PSI == pytest.approx(0.089 * 307, rel=1e-9)
    worst = {}
    for actuator, factors in Model(excavator).force_from_pressure.items():
        sensors = {channel: excavator.sensor(channel) for channel in factors}
        worst[actuator] = sum(abs(factor) * sensors[channel].accuracy  # type: ignore[union-attr]
                              for channel, factor in factors.items())
    # printed with two digits
    assert {actuator: float(f"{error:.1e}") for actuator, error in worst.items()} == {
        "swing_motor": 1400, "boom_cylinder": 5800, "stick_cylinder": 4200}
    assert worst["boom_cylinder"] == pytest.approx(5700, rel=0.01)  # the thesis cuts 5746 N


def test_bodies_of_tables_1_and_13(excavator: Machine) -> None:
    literal = load_machine("cat215b", parameter_set="thesis_literal")
    for link, m, mc in (
        ("swing", 8031, (8433, -321, 4016)),
        ("boom", 1830, (4209, 366, 0)),
        ("stick", 688, (619, 69, 0)),
    ):
        for machine in (excavator, literal):
            body = machine.link(link).body
            assert body is not None
            assert body.phi[0] == m
            np.testing.assert_allclose(body.phi[1:4], mc, atol=1.0)  # Table 13 rounds to 1 kg·m


@pytest.mark.parametrize(("old", "new", "pattern"), [
    ('bore = "140 mm"', 'bore = "1e200 m"', r"cylinders\[stick_cylinder\]\.bore: 1e\+200 m is beyond"),
    ('rod_diameter = "89 mm"', 'rod_diameter = "1e-200 m"', "so small"),
    ('sigma = "20 %"', 'sigma = "1e-200 %"', r"sigma: .*so small"),
    ('sigma = "20 %"', 'sigma = "20 %", lower = "inf kg"', r"lower: .*finite"),
    ('sigma = "20 %"', 'sigma = "1e308 kg"', r"sigma: .*beyond"),
    ("gear = 307", f"gear = {10**308}", "64 bits"),
    ('bore = "140 mm"', 'bore = "140 mm"\njacks = true', r"jacks: must be a whole number, not 'true'"),
    ('name = "digger"', 'name = "digger"\nobstacles = { value = [] }', "obstacles: only a number has a 'value'"),
    ("gear = 307", "gear = 1e300", r"gear: .*beyond"),
    ('name = "digger"', f'name = "digger"\nbandwidth = "{10**309} Hz"', r"bandwidth: .*finite")])
def test_numbers_beyond_any_machine_are_refused(old, new, pattern):
    assert DIGGER.count(old) == 1
    with pytest.raises(MachineError, match=pattern) as caught:
        read_machine(DIGGER.replace(old, new))
    assert len(str(caught.value)) < 160


def test_a_file_based_on_a_bundled_machine_states_only_differences() -> None:
    base, own = load_machine("cat215b"), load_machine("cat215b_link4")
    assert [stage.name for stage in own.stages] == ["grapple_swing_moves", *(stage.name for stage in base.stages)]
    assert own.links == base.links
    assert own.numbers["grapple.d"].value == base.numbers["grapple.d"].value == 1.134
    assert own.notes["grapple.joint.d"].sigma == 0.05
    assert "grapple.joint.d" not in {path for path, note in base.notes.items() if note.sigma}
    assert read_machine(dump_machine(own)) == own
    more = load_machine("cat215b_bucket")
    assert [link.name for link in more.links] == ["swing", "boom", "stick", "stick_end", "rocker", "coupler", "bucket"]
    assert [cylinder.name for cylinder in more.cylinders] == ["boom_cylinder", "stick_cylinder", "bucket_cylinder"]
    with pytest.raises(MachineError, match="based_on: 'cat' is no bundled machine"):
        read_machine('based_on = "cat"')


def test_a_motor_may_state_its_displacement_per_revolution() -> None:
    data = load_machine("cat215b").model_dump(exclude={"notes"})
    data["motors"][0]["torque_per_pressure"] = "81 cm^3/rev"
    found = Machine.model_validate(data).motors[0].torque_per_pressure
    assert found == pytest.approx(81e-6 / (2 * np.pi), rel=1e-12)
    data["motors"][0]["torque_per_pressure"] = "81 cm^3"
    with pytest.raises(ValueError, match=r'volume without the angle in which .* write it as "81 cm\^3/rev"'):
        Machine.model_validate(data)
