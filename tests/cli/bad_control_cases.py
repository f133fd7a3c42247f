"""What can be wrong with a closed loop that is asked for, in the form of `bad_input_cases`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from cli.bad_input_cases import DIGGER, Case, edited, written

PATU = (Path(__file__).parents[2] / "models" / "patu655_lift.toml").read_text("utf-8")
"""The machine file of a crane with one valve."""
LIMITED = edited(PATU, "[pump]", '[pump]\nmax_flow = "60 L/min"')
"""The same with a pump of stated flow."""


def path(amplitude: float = 0.1, frequency: float = 0.1, middle: float = 0.3, duration: float = 4.0) -> str:
    """A log of one joint that swings."""
    t = np.arange(0, duration, 0.02)
    q = middle + amplitude * np.sin(2 * np.pi * frequency * t)
    return "t [s],lift.q [rad]\n" + "".join(f"{a:.3f},{b:.8f}\n" for a, b in zip(t, q, strict=True))


def control(*more: str, place: str, motion: str | None = None, machine: str | None = None) -> Case:
    """A loop on the crane, or on another machine file, with the good motion or another."""
    def spoil(folder: Path) -> list[str]:
        named = "patu655_lift" if machine is None else str(written(folder, machine, "machine.toml"))
        return ["control", named, "-o", str(folder / "out"), "--trajectory",
                str(written(folder, path() if motion is None else motion, "path.csv")), *more]
    return Case(spoil, place)


def _with_truth(content: str, place: str) -> Case:
    good = control(place=place)
    return Case(lambda folder: [*good.spoil(folder), "--truth", str(written(folder, content, "truth.json"))], place)


def _in_the_way(folder: Path) -> list[str]:
    written(folder, "a file", "out")
    return control(place="").spoil(folder)


def _empty_estimate(folder: Path) -> list[str]:
    (folder / "estimate").mkdir()
    arguments = control(place="").spoil(folder)
    return [arguments[0], str(folder / "estimate"), *arguments[2:]]


def _no_trajectory(folder: Path) -> list[str]:
    return ["control", "patu655_lift", "-o", str(folder / "out"), "--trajectory", str(folder / "none.csv")]


ALL = {
    "motion beyond the pump": control(motion=path(0.3, 0.4), machine=LIMITED, place=(
        r"--trajectory: at \d+\.\d+ s .* \d+ L/min .* gives 60 L/min; .* longer")),
    "motion beyond the valve": control(
        machine=edited(PATU, 'rated_flow = { value = "62 L/min"', 'rated_flow = { value = "9 L/min"'),
        place="--trajectory: at .* s .*'lift_cylinder'.*fully open; .*slower"),
    "load beyond the supply": control(
        machine=edited(PATU, 'pressure = { value = "92 bar"', 'pressure = { value = "30 bar"'),
        place=r"--trajectory: at .* s .* N of 'lift_cylinder', which 30 bar do not make; "),
    "motion beyond the joint": control(motion=path(2.0), place=r"path\.csv: lift\.q leaves the joint's range at"),
    "no motion": Case(_no_trajectory, r"none\.csv: "),
    "motion of another machine": control(motion=path().replace("lift.q", "boom.q"), place=r"path\.csv: .*'?lift\.q"),
    "motion of a few samples": control(motion=path(duration=0.06), place=r"path\.csv|--rate"),
    "unstable loop": control("--gain", "60", "--controller", "pi", place=(
        r"control: the loop of 'lift_cylinder' is unstable with PI .* in the posture of the motion at \d.* s, where "
        r"its gain margin is -\d+\.\d dB; lower --gain")),
    "no circuit": control(machine=DIGGER, place="digger: nothing is said of what feeds '.*'; state 'circuit'"),
    "driven without oil": Case(lambda d: ["control", "panda_mukca", "-o", str(d / "out"), "--trajectory",
                                          str(written(d, path(), "path.csv"))], "panda_mukca: .*driven directly.*; "),
    "no supply pressure": control(machine="\n".join(line for line in LIMITED.splitlines()
                                                    if not line.startswith("pressure = ")),
                                  place="patu655_lift: pump: the supply's pressure is not known; state 'pressure'"),
    "dead band larger than the commands": control(
        machine=edited(PATU, 'dead_band = { value = "0.5 V"', 'dead_band = { value = "2 V"'),
        place=r"machine\.toml: .*dead_band: the dead band of 2 V leaves nothing of the 1\.8 V"),
    "unknown controller": control("--controller", "pid", place="--controller: 'pid' .*; .*feedforward"),
    "sensitivity below one": control("--sensitivity", "0.9", place="--sensitivity: .*0.9; "),
    "sensitivity not a number": control("--sensitivity", "nan", place="--sensitivity: .*nan; "),
    "no gain": control("--gain", "0", place="--gain: .* 0; "),
    "gain not a number": control("--gain", "nan", place="--gain: .*nan; "),
    "rate of zero": control("--rate", "0", place="--rate: .* 0 Hz"),
    "negative rate": control("--rate", "-50", place="--rate: .* -50 Hz"),
    "rate not a number": control("--rate", "nan", place="--rate: .* nan Hz"),
    "rate that leaves no samples": control("--rate", "0.5", place="--rate: .* 0.5 Hz .* 4 s|3.98 s"),
    "rate beyond memory": control("--rate", "1e9", place=r"--rate: .*1e\+09 Hz"),
    "unknown truth": control("--truth", "perfect", place="--truth: 'perfect' .*; .*truth.json"),
    "truth that is no JSON": _with_truth("{", r"truth\.json: .*JSON"),
    "truth that is a list": _with_truth("[1]", r"truth\.json: .*JSON"),
    "truth of another machine": _with_truth(json.dumps({"machine": "digger", "parameters": {"boom.m": 1.0}}),
                                            r"truth\.json: the truth of 'digger' says nothing of 'lift"),
    "truth without parameters": _with_truth("{}", r"truth\.json: .* says nothing of"),
    "output is a file": Case(_in_the_way, "/out(/c)?: "),
    "folder without an estimate": Case(_empty_estimate, "estimate: .*no estimate"),
}
CASES = {f"control: {name}": case for name, case in ALL.items()}
