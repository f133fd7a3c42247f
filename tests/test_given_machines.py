"""Every public function takes a machine, its name or its file, a log or several; anything else ends in one sentence."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hydroopt as ho
from hydroopt.excitation.motion.basis import Fourier

NAME, ARM = "patu655_lift", "panda_mukca"


def motion(machine: Any = NAME) -> Any:
    return ho.random_trajectory(machine, duration=4, rate=20, seed=1)


@pytest.fixture(scope="module")
def logs() -> tuple[ho.Log, ho.Log, ho.Log]:
    one, two, three = (ho.simulate(NAME, ho.random_trajectory(NAME, duration=20, rate=50, seed=k), seed=k)
                       for k in range(3))
    return one, two, three


Taking = Callable[[Any, tuple[ho.Log, ...]], Any]
TAKING: dict[str, Taking] = {
    "Model": lambda m, logs: ho.Model(m),
    "Plant": lambda m, logs: ho.Plant(m),
    "random_trajectory": lambda m, logs: motion(m).q,
    "random_truth": lambda m, logs: ho.random_truth(m, seed=1),
    "simulate": lambda m, logs: ho.simulate(m, motion(), seed=1).channels["lift.q"],
    "commands_for": lambda m, logs: ho.commands_for(m, motion()),
    "drive": lambda m, logs: ho.drive(m, np.arange(5) / 50, np.full((5, 1), 5.7), np.array([0.2])).t,
    "identification_problem": lambda m, logs: str(ho.identification_problem(m, logs[:1])),
    "combined_problem": lambda m, logs: ho.combined_problem(m, logs[:1]),
    "hydraulic_problem": lambda m, logs: ho.hydraulic_problem(m, ho.drive(NAME, np.arange(60) / 50, 5.7 + np.cos(
        np.arange(60) / 25)[:, None], np.array([0.2]), seed=1)),
    "sensor_problem": lambda m, logs: ho.sensor_problem(m, logs[:1]),
    "excitation_problem": lambda m, logs: ho.excitation_problem(m, Fourier(period=6.0, harmonics=2)),
    "with_friction": lambda m, logs: ho.with_friction(m, "viscous"),
    "choose_friction": lambda m, logs: ho.choose_friction(m, logs[:1], logs[1:2], ["none", "coulomb"], method="wls"),
    "check_logs": lambda m, logs: ho.check_logs(m, logs[0]),
    "scale": lambda m, logs: ho.scale(m, logs[:1], ho.CarriedLoad("lift", (0.5, 0.0, 0.0), (0.1,) * 3, 500.0)).psi,
    "payload": lambda m, logs: ho.payload(m, logs[0], logs[1], link="lift"),
    "compare": lambda m, logs: ho.compare(m, list(logs)),
    "path_difference": lambda m, logs: ho.path_difference(m, NAME, {"lift": [0.1, 0.2]}, "lift").rms,
}
GEOMETRY: dict[str, Taking] = {
    "KinematicModel": lambda m, logs: ho.KinematicModel(m),
    "pose_problem": lambda m, logs: ho.pose_problem(m, 20),
    "calibrator_problem": lambda m, logs: ho.calibrator_problem(m, 5),
    "measure_up_problem": lambda m, logs: ho.measure_up_problem(m, tip=0.01),
    "what_next_problem": lambda m, logs: ho.what_next_problem(m),
    "calibration_problem": lambda m, logs: ho.calibration_problem(m, ho.Poses("a", stage=np.array(["low"]), channels={
        f"{joint}.q": np.array([0.1]) for joint in ho.load_machine(ARM).joints})),
    "inverse_kinematics": lambda m, logs: ho.inverse_kinematics(m, [4.0, 1.0, -1.0]),
}
OF_GEOMETRY = {"inverse_kinematics": "cat215b", "calibrator_problem": "cat215b"}
ALL = {**TAKING, **GEOMETRY}


def shown(found: Any) -> str:
    return found.tobytes().hex() if isinstance(found, np.ndarray) else repr(found)


def machine_for(name: str) -> str:
    return NAME if name in TAKING else OF_GEOMETRY.get(name, ARM)


@pytest.mark.parametrize("name", ALL)
def test_a_name_is_as_good_as_a_machine(name: str, logs: tuple[ho.Log, ...]) -> None:
    given = machine_for(name)

    def outcome(machine: Any) -> str:
        try:
            return shown(ALL[name](machine, logs))
        except ho.HydrooptError as error:  # one and the same, whatever names the machine
            return str(error)

    assert outcome(given) == outcome(ho.load_machine(given))


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("wrong", [42, None, {"name": "arm"}, np.eye(2)], ids=["number", "none", "table", "array"])
def test_what_is_no_machine_is_refused_in_one_sentence(name: str, wrong: Any, logs: tuple[ho.Log, ...]) -> None:
    with pytest.raises(ho.ProblemError, match="not a machine; give a Machine") as refusal:
        ALL[name](wrong, logs)
    assert "\n" not in str(refusal.value)


def test_every_public_function_of_a_machine_is_tried() -> None:
    first = {name: next(iter(inspect.signature(getattr(ho, name)).parameters), "") for name in ho.__all__
             if inspect.isfunction(getattr(ho, name))}
    taking = {name for name, parameter in first.items() if parameter in ("machine", "model", "plant", "first")}
    assert taking - {"load_machine", "dump_machine"} <= ALL.keys()


def test_unknown_names_and_files_are_machine_errors(tmp_path: Path) -> None:
    with pytest.raises(ho.MachineError, match="neither a bundled machine"):
        ho.identification_problem("cat215c", [])
    with pytest.raises(ho.MachineError, match=r"there is no such file"):
        ho.Model(tmp_path / "mine.toml")


def test_one_log_stands_for_a_list_of_it(logs: tuple[ho.Log, ...]) -> None:
    one, listed = (ho.identification_problem(NAME, given, logs[1]) for given in (logs[0], [logs[0]]))
    assert str(one) == str(listed)
    with pytest.raises(ho.LogError, match=r"this is a str, not a log; read one by read_log"):
        ho.identification_problem(NAME, "run.csv")
    with pytest.raises(ho.LogError, match="this is a int, not a log"):
        ho.payload(NAME, 3, logs[0])
