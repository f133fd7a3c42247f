"""FMUs of a machine run in FMPy, an independent importer, and give what hydroopt's own integrator and kernels give."""

from __future__ import annotations

import io
import re
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy import fmi3, validation

from fixtures import library
from fixtures.tiers import tiered
from fixtures.tools import Tool, must
from hydroopt.codegen import fmu as generator
from hydroopt.kernels.compiler import compiler
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.simulation.drive_valves import ACCURACY

Array = np.ndarray
Fmus = Callable[[str], dict[str, Path]]
PLANTS = tiered(["patu655_lift", "cat215b", "backhoe"], lambda subject: subject not in ("backhoe", "cat215b"))
STRICT = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Wno-unused-parameter", "-Wno-unused-function", "-Werror")


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Fmus:
    """The FMUs of a machine, by what they are."""
    home = tmp_path_factory.mktemp("fmus")

    @cache
    def get(subject: str) -> dict[str, Path]:
        made = library.code(library.machine(subject), hosts=("fmi",), routines=("inverse_dynamics",)).fmus
        for name, content in made.items():
            (home / name).write_bytes(content)
        return {name.removeprefix(f"{subject}_").removesuffix(".fmu"): home / name for name in made}

    return get


@pytest.mark.parametrize("subject", tiered(["patu655_lift", "cat215b", "kr300", "backhoe"],
                                           lambda subject: subject not in ("backhoe", "cat215b")))
def test_descriptions_are_valid_by_schema_and_structure(subject: str, fmus: Fmus) -> None:
    made = fmus(subject)
    assert set(made) == ({"inverse_dynamics"} if subject == "kr300" else {"plant", "inverse_dynamics"})
    for file in made.values():
        assert not validation.validate_fmu(str(file))


def test_variables_have_units_of_the_base_units_of_fmi(fmus: Fmus) -> None:
    with zipfile.ZipFile(fmus("cat215b")["plant"]) as archive:
        tree = ET.fromstring(archive.read("modelDescription.xml"))
    units = {each.attrib["name"]: each[0].attrib for each in tree.iterfind("UnitDefinitions/Unit")}
    assert units["Pa"] == {"kg": "1", "m": "-1", "s": "-2", "factor": "1.0"}
    assert units["rad/s"] == {"rad": "1", "s": "-1", "factor": "1.0"}
    assert units["Pa/s"] == {"kg": "1", "m": "-1", "s": "-3", "factor": "1.0"}
    known = {each.attrib["name"]: each.attrib for each in tree.find("ModelVariables") or ()}
    assert known["boom_cylinder.p_head"]["unit"] == "Pa"
    assert known["boom.q"]["unit"] == "rad"
    assert known["der(boom_cylinder.p_head)"]["unit"] == "Pa/s"
    assert float(known["boom.m"]["start"]) == pytest.approx(library.machine("cat215b").link("boom").body.m)
    assert known["boom.m"]["causality"] == "parameter"


def commands(plant: Plant, at_rest: Array, t: Array) -> Array:
    """Commands (N, a) that move all joints to and fro within their ranges."""
    span = np.array([each.valve.span for each in plant.actuators])
    return np.asarray(at_rest + 0.15 * span * np.sin(2 * np.pi * t[:, None] / 1.7 + np.arange(len(span))))


def given(plant: Plant, t: Array, u: Array) -> Array:
    """Commands as FMPy takes them."""
    made = np.zeros(len(t), [("time", float), *((name, float) for name in plant.inputs)])
    made["time"] = t
    for k, name in enumerate(plant.inputs):
        made[name] = u[:, k]
    return made


def deviation(found: Array, plant: Plant, states: Array) -> float:
    """Largest difference of a state, as a part of the largest value that it takes, or of its typical one."""
    got = np.array([found[name] for name in plant.states]).T
    assert got.shape == states.shape
    return float((np.abs(got - states) / np.maximum(np.abs(states).max(axis=0), 0.01 * plant.scale)).max())


def driven(plant: Plant, step: float, count: int, tolerance: float) -> tuple[Array, Array, Array]:
    """Times (N,), commands (N, a), each held until the next, and states (N, nx) by hydroopt's integrator."""
    psi, theta = plant.model.parameters.nominal, plant.parameters.nominal
    rest = generator.at_rest(plant, psi)
    t = np.arange(count) * step
    u = commands(plant, rest.u, t)
    later = plant.integrator(psi, theta, tolerance=tolerance).along(
        rest.x, np.full(count - 1, step), u[:-1], np.tile(plant.supply, (count - 1, 1)))
    states = np.vstack([rest.x, later])
    assert np.ptp(states[:, 0]) > 0.01  # it moves
    return t, u, states


@pytest.mark.parametrize("subject", PLANTS)
def test_the_plant_in_co_simulation_is_hydroopts_integrator(subject: str, fmus: Fmus) -> None:
    plant = Plant(Model(library.machine(subject)))
    t, u, states = driven(plant, 0.01, 151, ACCURACY)
    found = fmpy.simulate_fmu(str(fmus(subject)["plant"]), fmi_type="CoSimulation", stop_time=t[-1],
                              output_interval=0.01, input=given(plant, t, u), output=plant.states)
    assert deviation(found, plant, states) < 1e-6


@pytest.mark.parametrize("subject", PLANTS)
def test_the_plant_by_model_exchange_is_hydroopts_integrator(subject: str, fmus: Fmus) -> None:
    """CVODE of the importer integrates: it begins anew where a time stands twice, and else is told of no jump."""
    plant = Plant(Model(library.machine(subject)))
    t, u, states = driven(plant, 0.05, 31, 1e-11)
    jumps = given(plant, np.repeat(t, 2)[1:-1], np.repeat(u[:-1], 2, axis=0))
    found = fmpy.simulate_fmu(str(fmus(subject)["plant"]), fmi_type="ModelExchange", stop_time=t[-1],
                              relative_tolerance=1e-11, output_interval=0.05, input=jumps, output=plant.states,
                              record_events=False)
    assert deviation(found, plant, states) < 1e-6


def test_outputs_are_those_of_the_plant(fmus: Fmus) -> None:
    plant = Plant(Model(library.machine("cat215b")))
    psi, theta = plant.model.parameters.nominal, plant.parameters.nominal
    rest = generator.at_rest(plant, psi)
    names = [f"{each.actuator.name}.{key}" for key in ("force", "flow", "speed") for each in plant.actuators]
    found = fmpy.simulate_fmu(str(fmus("cat215b")["plant"]), fmi_type="CoSimulation", stop_time=0.01,
                              output_interval=0.01, output=names, start_values={"boom.qd": 0.1, "stick.qd": -0.2})
    x = rest.x.copy()
    x[plant.states.index("boom.qd")], x[plant.states.index("stick.qd")] = 0.1, -0.2
    expected = dict(zip(plant.outputs.name_out(), plant.outputs(x, rest.u, plant.supply, psi, theta), strict=True))
    values = np.concatenate([np.asarray(expected[key]).ravel() for key in ("force", "flow", "speed")])
    assert np.allclose([found[name][0] for name in names], values, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("subject", tiered(["cat215b", "kr300", "backhoe"], lambda subject: subject != "backhoe"))
def test_inverse_dynamics_in_co_simulation_are_those_of_the_kernels(subject: str, fmus: Fmus) -> None:
    described = library.machine(subject)
    model, rng = Model(described), np.random.default_rng(3)
    lower, upper = described.ranges.T
    n, t = len(described.joints), np.arange(40) * 0.01
    q = (lower + upper) / 2 + 0.1 * (upper - lower) * rng.uniform(-1, 1, (len(t), n))
    qd, qdd = rng.standard_normal((2, len(t), n))
    moved = np.zeros(len(t), [("time", float), *((f"{joint}.{key}", float) for joint in described.joints
                                                 for key in ("q", "qd", "qdd"))])
    moved["time"] = t
    for k, joint in enumerate(described.joints):
        for key, values in (("q", q), ("qd", qd), ("qdd", qdd)):
            moved[f"{joint}.{key}"] = values[:, k]
    found = fmpy.simulate_fmu(str(fmus(subject)["inverse_dynamics"]), stop_time=t[-1], output_interval=0.01,
                              input=moved)
    names = [name for name in found.dtype.names if name.endswith(".force")]
    expected = model.over(model.inverse_dynamics, q, qd, qdd, model.parameters.nominal)[0][..., 0]
    got = np.array([found[name] for name in names]).T
    assert got.shape == expected.shape
    # outputs of a step are those of the inputs at its start
    assert np.abs(got[1:] - expected[:-1]).max() < 1e-9 * np.abs(expected).max()


class Instance:
    """An FMU that is called function by function."""

    def __init__(self, file: Path, folder: Path) -> None:
        self.description = fmpy.read_model_description(str(file))
        fmpy.extract(str(file), str(folder))
        self.reference = {each.name: each.valueReference for each in self.description.modelVariables}
        self.said: list[str] = []
        self.slave = fmi3.FMU3Slave(
            guid=self.description.guid, unzipDirectory=str(folder), instanceName="one",
            modelIdentifier=self.description.coSimulation.modelIdentifier)

        def log(_: object, status: int, category: bytes, message: bytes) -> None:
            self.said.append(message.decode())

        self.slave.instantiate(logMessage=fmi3.fmi3LogMessageCallback(log))
        self.slave.enterInitializationMode()

    def set(self, **values: float) -> None:
        self.slave.setFloat64([self.reference[name.replace("__", ".")] for name in values], list(values.values()))

    def get(self, *names: str) -> list[float]:
        return list(self.slave.getFloat64([self.reference[name] for name in names]))


@pytest.fixture
def started(fmus: Fmus, tmp_path: Path) -> Iterator[Callable[[str, str], Instance]]:
    made: list[Instance] = []

    def start(subject: str, kind: str) -> Instance:
        made.append(Instance(fmus(subject)[kind], tmp_path / kind))
        return made[-1]

    yield start
    for each in made:
        each.slave.freeInstance()


def test_parameters_can_be_set(started: Callable[[str, str], Instance]) -> None:
    one = started("cat215b", "inverse_dynamics")
    before = one.get("boom_cylinder.force")[0]
    model = Model(library.machine("cat215b"))
    psi = model.parameters.nominal.copy()
    place = model.parameters.names.index("stick.m")
    psi[place] += 100.0
    one.set(stick__m=float(psi[place]))
    q = one.get("swing.q", "boom.q", "stick.q")
    after = one.get("boom_cylinder.force")[0]
    expected = np.asarray(model.inverse_dynamics(q, np.zeros(3), np.zeros(3), psi)).ravel()
    assert after == pytest.approx(expected[model.machine.actuators.index(model.machine.cylinders[0])], rel=1e-12)
    assert after != before
    one.slave.reset()
    assert one.get("boom_cylinder.force")[0] == before


def test_a_state_can_be_kept_and_restored(started: Callable[[str, str], Instance]) -> None:
    one = started("patu655_lift", "plant")
    one.slave.exitInitializationMode()
    one.set(lift_cylinder__u=6.5)
    one.slave.doStep(0.0, 0.1)
    kept = one.slave.getFMUState()
    copied = one.slave.deserializeFMUState(one.slave.serializeFMUState(kept))
    one.slave.doStep(0.1, 0.1)
    first = one.get("lift.q", "lift.qd", "lift_cylinder.p_head")
    for state in (kept, copied):
        one.slave.setFMUState(state)
        assert one.get("lift.q")[0] != first[0]
        one.slave.doStep(0.1, 0.1)
        assert one.get("lift.q", "lift.qd", "lift_cylinder.p_head") == first
        one.slave.freeFMUState(state)


def drive_on(one: Instance) -> None:
    for k in range(1000):
        one.slave.doStep(0.1 * k, 0.1)


def test_what_has_no_result_is_an_error_that_says_why(started: Callable[[str, str], Instance]) -> None:
    failed = fmpy.fmi1.FMICallException
    one = started("cat215b", "inverse_dynamics")
    with pytest.raises(failed):
        one.set(boom__q=float("nan"))
    assert one.said[-1] == "a value is not finite"
    one.set(boom__q=1.5)
    with pytest.raises(failed):
        one.get("boom_cylinder.force")
    assert one.said[-1].startswith("OUT_OF_STROKE")
    with pytest.raises(failed):
        one.slave.doStep(0.0, 0.1)
    with pytest.raises(failed):
        one.set(boom_cylinder__force=1.0)
    plant = started("patu655_lift", "plant")
    plant.slave.exitInitializationMode()
    plant.set(lift_cylinder__u=10.0)
    with pytest.raises(failed):
        drive_on(plant)
    assert re.match(r"lift is out of its range, .*: ends of strokes are not modelled", plant.said[-1])


@pytest.mark.parametrize("compiler", ["cc", Tool("clang")])
def test_sources_compile_without_warnings(compiler: str, fmus: Fmus, tmp_path: Path) -> None:
    for kind, file in fmus("patu655_lift").items():
        with zipfile.ZipFile(file) as archive:
            archive.extractall(tmp_path / kind)
        place = tmp_path / kind / "sources"
        described = ET.parse(place / "buildDescription.xml").getroot()
        names = [each.attrib["name"] for each in described.iter("SourceFile")]
        must([compiler, *STRICT, "-shared", "-fPIC", "-fvisibility=hidden", "-o", "fmu.so", *names, "-lm"], place)
        exported = must(["nm", "-D", "--defined-only", "fmu.so"], place)
        assert len(functions()) > 70
        assert functions() <= set(re.findall(r" T (fmi3\w+)", exported))


def functions() -> set[str]:
    """All functions of the standard, as FMPy's header lists them."""
    header = Path(fmpy.__file__).parent / "c-code/fmi3Functions.h"
    return set(re.findall(r"^FMI3_Export fmi3\w+TYPE\s+(fmi3\w+);", header.read_text("utf-8"), re.MULTILINE))


def test_archives_are_the_same_however_often_they_are_made(fmus: Fmus) -> None:
    again = library.code(library.machine("patu655_lift"), hosts=("fmi",), routines=("inverse_dynamics",)).fmus
    for name, content in again.items():
        before = fmus("patu655_lift")[name.removeprefix("patu655_lift_").removesuffix(".fmu")].read_bytes()
        texts = [[(each, archive.read(each)) for each in archive.namelist() if not each.startswith("binaries")]
                 for archive in (zipfile.ZipFile(io.BytesIO(each)) for each in (before, content))]
        assert texts[0] == texts[1]
        assert len(texts[0]) > 3


def test_without_a_compiler_the_sources_alone_are_there(monkeypatch: pytest.MonkeyPatch) -> None:
    compiler.cache_clear()
    monkeypatch.setattr(generator, "compiler", lambda: None)
    made = library.code(library.machine("patu655_lift"), hosts=("fmi",), routines=("inverse_dynamics",)).fmus
    for content in made.values():
        names = zipfile.ZipFile(io.BytesIO(content)).namelist()
        assert "sources/fmi3.c" in names
        assert not [name for name in names if name.startswith("binaries")]


def test_a_machine_without_valves_says_what_is_missing() -> None:
    made = library.code(library.machine("kr300"), hosts=("fmi",))
    assert next(names for reason, names in made.missing.items() if "not by oil" in reason) == ["kr300_plant.fmu"]


def test_the_command_writes_them_and_removes_them_again(tmp_path: Path) -> None:
    code = library.code(library.machine("patu655_lift"), hosts=("fmi",), routines=("inverse_dynamics",))
    assert {"patu655_lift_plant.fmu", "patu655_lift_inverse_dynamics.fmu"} <= set(code.write(tmp_path))
    assert (tmp_path / "patu655_lift_plant.fmu").exists()
    library.code(library.machine("patu655_lift"), routines=("inverse_dynamics",)).write(tmp_path)
    assert not list(tmp_path.glob("*.fmu"))
