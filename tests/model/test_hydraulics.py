"""Valve, chambers and pump against what textbooks and hand calculation say of them."""

import casadi as ca
import numpy as np
import pytest

import hydroopt as ho
from hydroopt.model.hydraulics import AMBIENT, compressibility, hinge, openings, orifice, pump_flow, spool_position
from hydroopt.model.plant import Plant


def plant(name="patu655_lift"):
    """A bundled machine; the log crane without its air, with an own flow for each edge."""
    data = ho.load_machine(name).model_dump()
    if name == "patu655_lift":
        circuit = data["cylinders"][0]["circuit"]
        circuit["air_b"] = circuit["valve"]["rated_flow"] = None
        circuit["valve"] |= {"flow_pa": 62 / 6e4, "flow_at": 72 / 6e4, "flow_pb": 72 / 6e4, "flow_bt": 62 / 6e4}
    return Plant(ho.Model(ho.Machine.model_validate(data)))


def value_of(subject, k=0):
    theta = subject.parameters.nominal
    owner = subject.actuators[k].actuator.name
    return lambda key: float(theta[subject.parameters.index(key if key.startswith("oil.") else f"{owner}.{key}")])


def number(expression):
    return float(ca.DM(expression))


@pytest.mark.parametrize("drop", [2e5, 1e6, 2e7])
def test_orifice_is_turbulent_at_large_drops(drop):
    # 62 L/min at 35 bar: Q = Q_n·sqrt(Δp/Δp_n)
    conductance = 62 / 6e4 / np.sqrt(35e5)
    for sign in (1, -1):
        found = number(orifice(ca.DM(conductance), ca.DM(sign * drop), ca.DM(0), 5e4))
        assert found == pytest.approx(sign * 62 / 6e4 * np.sqrt(drop / 35e5), rel=0.016)


def test_orifice_is_laminar_at_small_drops():
    assert number(orifice(ca.DM(1.0), ca.DM(200.0), ca.DM(0), 5e4)) == pytest.approx(
        2 * number(orifice(ca.DM(1.0), ca.DM(100.0), ca.DM(0), 5e4)), rel=1e-4)


def test_hinge_has_the_corner_it_rounds():
    assert number(hinge(ca.DM(1.0), 0.01)) == pytest.approx(1, abs=3e-5)
    assert number(hinge(ca.DM(-1.0), 0.01)) == pytest.approx(0, abs=3e-5)
    assert number(hinge(ca.DM(0.0), 0.01)) == pytest.approx(0.005)


def test_a_command_reaches_from_the_dead_band_to_full_opening():
    subject = plant()
    valve, value = subject.actuators[0].valve, value_of(subject)
    commands = [5.7, 5.3, 6.1, 3.9, 7.5, 3.0, (5.2 + 3.9) / 2]  # neutral, inside, inside, full, back, beyond, half way
    spool = [number(spool_position(valve, ca.DM(u), value)) for u in commands]
    assert np.allclose(spool, [0, 0, 0, 1, -1, 1, 0.5], atol=1e-3)
    ways = [openings(valve, ca.DM(x), value) for x in (0.6, -0.6)]
    found = [[number(part) for part in way] for way in ways]
    assert np.allclose(found, [[0.6, 0, 0, 0.6], [0, 0.6, 0.6, 0]], atol=1e-3)


def test_oil_with_air_has_the_secant_of_its_volume():
    """Mixture of oil and air compressed step by step: 1/β = −dV/dp/V by differences of its volume."""
    oil = ho.load_machine("cat215b").oil
    air, beta, n = 0.005, 1.4e9, oil.polytropic

    def volume(p):
        return (1 - air) * np.exp(-p / beta) + air * (AMBIENT / (AMBIENT + p)) ** (1 / n)

    for p in (1e5, 1e6, 1e7):
        step = 1e-4 * (p + AMBIENT)
        secant = (volume(p - step) - volume(p + step)) / (2 * step) / volume(p)
        found = number(compressibility(oil, ca.DM(p), lambda key: {"oil.air": air, "oil.bulk_modulus": beta}[key]))
        # the expression leaves the oil's own compression out of the part that is air: within p/β of one another
        assert found == pytest.approx(secant, rel=2 * p / beta + 0.01)


def test_oil_that_is_pulled_on_tears_and_closes_again():
    """A crane lowered at full speed whose valve shuts: its inertia pulls on the oil of the rod side until it rises."""
    subject = plant()
    psi, theta = subject.model.parameters.nominal, subject.parameters.nominal
    at = subject.steady(np.array([0.5]), np.zeros(1), psi, theta)
    integrator, x = subject.integrator(psi, theta), [at.x]
    for u in np.repeat([7.5, 5.7, 4.8], [40, 40, 160]):
        x.append(integrator(x[-1], 0.005, [u], subject.supply))
    rod = np.array(x)[:, -1] + AMBIENT
    assert 0 < np.min(rod) < 5e3
    assert rod[-1] == pytest.approx(subject.steady(x[-1][:1], x[-1][1:2], psi, theta).x[-1] + AMBIENT, rel=0.1)


def test_pump_gives_all_until_near_its_set_pressure():
    given = [number(pump_flow(1.0, ca.DM(280e5), ca.DM(p))) for p in (0.0, 200e5, 270e5, 290e5)]
    assert np.allclose(given, [1, 1, 1, 0], atol=0.02)


@pytest.mark.parametrize("name", ["patu655_lift", "cat215b"])
def test_steady_motion_keeps_its_speed_by_the_integrator(name):
    """From the steady state on the machine moves at that speed, as far as the posture does not change the forces."""
    subject = plant(name)
    machine = subject.machine
    psi, theta = subject.model.parameters.nominal, subject.parameters.nominal
    n = len(machine.joints)
    q = machine.ranges.mean(axis=1)
    qd = np.full(n, 0.03)
    at = subject.steady(q, qd, psi, theta)
    integrator, x = subject.integrator(psi, theta), at.x
    for _ in range(5):
        x = integrator(x, 0.02, at.u, subject.supply)
    assert np.allclose(x[:n], q + 0.1 * qd, atol=2e-5)
    assert np.allclose(x[n:2 * n], qd, atol=1e-3)
    rates = np.asarray(subject.rates(at.x, at.u, subject.supply, psi, theta)).ravel()[n:]
    assert np.max(np.abs(rates / subject.scale[n:])) < 1e-6


def test_the_ideal_opening_is_that_of_the_sharp_valve():
    """Flow into and out of the chambers by Q = K·x·√Δp at what `opening_for` says."""
    subject = plant()
    each, value = subject.actuators[0], value_of(subject)
    a, b = each.areas
    for force, speed in ((4e4, 0.02), (4e4, -0.02), (-5e3, 0.05)):
        x, p_a, p_b = (number(part) for part in each.opening_for(ca.DM(force), ca.DM(speed), ca.DM([92e5, 1e5]), value))
        feeding, draining = ((92e5 - p_a, p_b - 1e5) if speed > 0 else (92e5 - p_b, p_a - 1e5))
        keys = ("flow_pa", "flow_bt") if speed > 0 else ("flow_pb", "flow_at")
        areas = (a, b) if speed > 0 else (b, a)
        for key, area, drop in zip(keys, areas, (feeding, draining), strict=True):
            assert value(key) * abs(x) * np.sqrt(drop / 35e5) == pytest.approx(area * abs(speed), rel=1e-9)
        assert a * p_a - b * p_b == pytest.approx(force)
        assert np.sign(x) == np.sign(speed)


def changed(name="patu655_lift", valve=None, **circuit):
    """A bundled machine with other numbers of its first cylinder's circuit."""
    data = ho.load_machine(name).model_dump()
    data["cylinders"][0]["circuit"] |= circuit
    data["cylinders"][0]["circuit"]["valve"] |= valve or {}
    return Plant(ho.Model(ho.Machine.model_validate(data)))


@pytest.mark.parametrize("overlap", [-0.3, 0.3, 0.6, 0.9])
def test_overlap_is_travelled_before_the_machine_moves(overlap):
    """The spool of a valve with sharp edges, moved on by its overlap; an underlap takes both pressures with it."""
    subject, sharp = changed(valve={"overlap": overlap}), changed(valve={"overlap": 0.0})
    spools = []
    for each in (subject, sharp):
        psi, theta = each.model.parameters.nominal, each.parameters.nominal
        at = each.steady(np.array([0.5]), np.array([0.1]), psi, theta)
        rates = np.asarray(each.rates(at.x, at.u, each.supply, psi, theta)).ravel()
        assert np.max(np.abs(rates / each.scale)[1:]) < 1e-6
        spools.append(at.x[2])
    if overlap > 0:
        assert spools[0] == pytest.approx(overlap + (1 - overlap) * spools[1], abs=2e-3)


def test_what_the_load_would_tear_off_its_oil_is_refused():
    """Where the draining edge lets more out than the feeding one lets in, the rod side falls below vacuum."""
    edges = {"flow_at": 200 / 6e4, "flow_pb": 20 / 6e4}
    subject = changed(valve=edges)
    psi, theta = subject.model.parameters.nominal, subject.parameters.nominal
    with pytest.raises(ho.ProblemError, match=r"'lift_cylinder'.*p_rod would be -\d\d bar.*'anticavitation'"):
        subject.steady(np.array([0.5]), np.array([-0.2]), psi, theta)
    followed = changed(valve=edges, anticavitation=True)
    at = followed.steady(np.array([0.5]), np.array([-0.2]), psi, theta)
    assert -AMBIENT < at.x[-1] < followed.supply[1]


def test_a_place_of_the_spool_that_no_command_reaches_is_refused():
    """Widely rounded, a dead band of nine tenths on the other side still holds a little back at full command."""
    subject = changed(valve={"dead_band": 0.0, "dead_band_reverse": 1.6, "rounding": 0.2})
    psi, theta = subject.model.parameters.nominal, subject.parameters.nominal
    with pytest.raises(ho.ProblemError, match=r"no command moves the spool of 'lift_cylinder' to 99 %"):
        subject.steady(np.array([0.5]), np.array([0.316]), psi, theta)


def test_too_fast_is_refused():
    subject = plant()
    with pytest.raises(ho.ProblemError, match=r"a supply of 92 bar cannot move 'lift_cylinder'"):
        subject.steady(np.array([0.5]), np.array([2.0]), subject.model.parameters.nominal, subject.parameters.nominal)


def test_a_machine_without_circuit_is_refused():
    with pytest.raises(ho.ProblemError, match="driven directly, not by oil"):
        plant("kr300")


def test_seals_rub_by_the_pressures_in_the_chambers():
    """Pressures that cancel as force still slow the piston: by seal·(p_head + p_rod)/m at the cylinder."""
    seal = 2e-5
    data = ho.load_machine("patu655_lift").model_dump()
    data["cylinders"][0]["friction"] |= {"seal": seal}
    subject = Plant(ho.Model(ho.Machine.model_validate(data)))
    psi, theta = subject.model.parameters.nominal, subject.parameters.nominal
    a, b = subject.actuators[0].areas

    def acceleration(p_head, p_rod, speed):
        x = [0.5, speed, 0.0, 0.0, p_head, p_rod]
        return float(subject.outputs(x=x, u=[5.7], supply=subject.supply, psi=psi, theta=theta)["qdd"])

    lever = float(subject.actuator_motion([0.5], [1.0])[1])
    mass = float(subject.mass([0.5], psi)) / lever
    low, high = (acceleration(p, p * a / b, 0.2) for p in (1e6, 2e6))
    assert lever > 0
    assert low - high == pytest.approx(seal * 1e6 * (1 + a / b) / mass, rel=1e-9)
    low, high = (acceleration(p, p * a / b, -0.2) for p in (1e6, 2e6))
    assert high - low == pytest.approx(seal * 1e6 * (1 + a / b) / mass, rel=1e-9)
