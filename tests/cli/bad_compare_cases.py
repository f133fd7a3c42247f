"""What can be wrong with two sessions to compare, see bad_input_cases."""

from __future__ import annotations

import functools
import json
import tempfile
from pathlib import Path

from cli.bad_input_cases import DIGGER, GOOD_LOG, Case, written

from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.logs.log import read_log
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.report.folder import save
from hydroopt.simulation import simulate


@functools.cache
def _other_log() -> str:
    """Another motion of the crane whose log the other cases spoil."""
    model = Model(load_machine("patu655_lift"))
    motion = simulate.random_trajectory(model, duration=20, rate=20, seed=77)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "after.csv"
        simulate.simulate(model, motion, seed=77).write(path)
        return path.read_text("utf-8")


@functools.cache
def _estimate() -> dict[str, str]:
    """The files of an estimate from the good log."""
    with tempfile.TemporaryDirectory() as folder:
        log = read_log(written(Path(folder), "\n".join(GOOD_LOG) + "\n", "before.csv"))
        save(identify(identification_problem(load_machine("patu655_lift"), [log]), "wls"), Path(folder) / "estimate")
        return {name: (Path(folder) / "estimate" / name).read_text("utf-8")
                for name in ("estimate.json", "information.csv")}


def compare(folder: Path, *more: str, before: str | None = None, after: str | None = None,
            machine: str = "patu655_lift") -> list[str]:
    """Arguments that compare two sessions, both good unless stated otherwise."""
    first = before or str(written(folder, "\n".join(GOOD_LOG) + "\n", "before.csv"))
    second = after or str(written(folder, _other_log(), "after.csv"))
    return ["compare", machine, "--before", first, "--after", second, "-o", str(folder / "out"), *more]


def option(*more: str, place: str) -> Case:
    return Case(lambda d: compare(d, *more), place)


def _folder(d: Path, **changed: str | None) -> str:
    """An estimate's directory with some files changed or left out."""
    (d / "estimate").mkdir()
    files = {"estimate_json": "estimate.json", "information_csv": "information.csv"}
    for key, name in files.items():
        text = changed.get(key, _estimate()[name])
        if text is not None:
            written(d / "estimate", text, name)
    return str(d / "estimate")


def kept(place: str, **changed: str | None) -> Case:
    return Case(lambda d: compare(d, before=_folder(d, **changed)), place)


def _failed(d: Path) -> list[str]:
    content = json.loads(_estimate()["estimate.json"]) | {"status": "failed"}
    return compare(d, before=_folder(d, estimate_json=json.dumps(content)))


def _other_machine(d: Path) -> list[str]:
    content = json.loads(_estimate()["estimate.json"])
    content["machine"]["sha256"] = "0" * 64
    return compare(d, before=_folder(d, estimate_json=json.dumps(content)))


def _resting(d: Path) -> list[str]:
    """A log in which the angle never changes."""
    rows = [line.split(",") for line in _other_log().splitlines()]
    place = rows[0].index("lift.q [rad]")
    length = rows[0].index("lift_cylinder.length [m]")
    for row in rows[2:]:
        row[place], row[length] = rows[1][place], rows[1][length]
    return compare(d, after=str(written(d, "\n".join(map(",".join, rows)) + "\n", "still.csv")))


CASES = {f"compare: {name}": case for name, case in {
    "no sessions": Case(lambda d: ["compare", "patu655_lift", "-o", str(d / "out")], "compare: .*'--before'"),
    "no such log": Case(lambda d: compare(d, after=str(d / "none.csv")), r"none\.csv: "),
    "the same log before and after": Case(
        lambda d: compare(d, after=str(written(d, "\n".join(GOOD_LOG) + "\n", "again.csv"))),
        r"again\.csv: the same samples"),
    "the log of the estimate again": Case(
        lambda d: compare(d, before=_folder(d), after=str(written(d, "\n".join(GOOD_LOG) + "\n", "again.csv"))),
        r"again\.csv: the same samples"),
    "unknown part": option("--parts", "friction,lift_cylindre", place=r"parts: .*'lift_cylindre'.*; .*lift_cylinder"),
    "kind that the machine lacks": option("--parts", "offset", place=r"parts: .*'offset'"),
    "empty part": option("--parts", "", place=r"parts: .*''"),
    "level of zero": option("--level", "0", place="level: 0"),
    "level not a number": option("--level", "nan", place="level: nan"),
    "no joint moves": Case(_resting, r"still\.csv: no joint moves"),
    "folder without estimate": Case(lambda d: compare(d, before=str(d)), r"no estimate.*; .*identify"),
    "folder without information": kept(r"estimate: there is no information\.csv", information_csv=None),
    "estimate that is none": kept(r"estimate\.json: .*no estimate", estimate_json="[1]"),
    "failed estimate": Case(_failed, r"estimate\.json: .*failed"),
    "estimate of another machine": Case(_other_machine, r"estimate\.json: .*another machine description"),
    "information of other parameters": kept(r"information\.csv: .*columns", information_csv="actuator,x,force\n"),
    "damaged information": Case(lambda d: compare(d, before=_folder(
        d, information_csv=_estimate()["information.csv"][:-40])), r"information\.csv: it is damaged"),
    "folder and log together": Case(lambda d: [*compare(d, before=_folder(d)), "--before", str(d / "after.csv")],
                                    "--before: .*whole session"),
    "link without a load": option("--link", "lift", place="--link: .*; .*--payload"),
    "gain without a load": option("--gain", "0.1", place="--gain: .*; .*--payload"),
    "parts of a load": option("--payload", "--parts", "friction", place="--parts: .*; .*--payload"),
    "load on an unknown link": option("--payload", "--link", "hook", place="link: .*'hook'.*; .*lift"),
    "gain of two": option("--payload", "--gain", "2", place="gain: 2"),
    "a link without body carries nothing": Case(
        lambda d: compare(d, "--payload", "--link", "swing", machine=str(written(d, DIGGER, "digger.toml"))),
        r"link: .*'swing' has no body.*; .*boom"),
}.items()}
