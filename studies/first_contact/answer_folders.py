"""Answer folders of another person: spoilt files, names that lead out of the folder, links, and leftovers.

A folder that `identify` wrote and one that `calibrate` wrote are changed in 1,000 seeded ways: names in the JSON file
that lead out of the folder, symbolic links and pipes, other types and sizes of numbers, files that are cut or
exchanged, tables in tables, journals of hydroopt's former kind, and leftovers of writers. In half of the cases the
digests in the JSON file are made right again, as a person of ill will can. Each folder is read by all that reads
answers: `load` and all that an answer says, the page, and the readers of `codegen`, `control`, `convert`, `show`,
`compare`, `identify-payload`, `weigh`, `excite --estimate` and `what-next`; a share of them by the commands themselves.
Then an answer is written into the folder. A change is any difference in names, sizes, times, links or digests of the
tree around the folder that is written.
"""

from __future__ import annotations

import io
import json
import os
import random
import shutil
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

import hydroopt as ho
from hydroopt.cli import app
from hydroopt.codegen import parameter_source
from hydroopt.control.setting import nominal_of
from hydroopt.errors import LONGEST, HydrooptError
from hydroopt.estimation.dynamic.stored_information import stored_information
from hydroopt.excitation.motion.expected_accuracy import identified
from hydroopt.simulation.pose_table import simulate_poses

SHARE = 20
"""Of so many folders one is read by the commands, too."""
MACHINES = {"identified": "patu655_lift", "calibrated": "panda_mukca"}
VALUES = (None, True, -1, 0, 1e308, -1e308, 10**15, 10**400, 1e-320, "", "x" * 5000, "\ud800", "\0", "nan", [], {},
          [[1.0]], {"a": 1}, "../../victims/notes.txt")
"""What stands in place of a value of the JSON file."""


def prepared(place: Path) -> None:
    """Write the two answers into `place`/good and files that nothing may change into `place`/victims."""
    machine = ho.load_machine(MACHINES["identified"])
    log = ho.simulate(machine, ho.random_trajectory(machine, duration=8, rate=20, seed=1), seed=1)
    log.write(place / "log.csv")
    ho.solve(ho.identification_problem(machine, log), "sdp", intervals=False).save(place / "good/identified")
    arm = ho.load_machine(MACHINES["calibrated"])
    plan = ho.solve(ho.pose_problem(arm, 20), candidates=30)
    poses = simulate_poses(ho.KinematicModel(arm), plan.postures, random=True, seed=1).poses
    ho.solve(ho.calibration_problem(arm, poses)).save(place / "good/calibrated")
    (place / "victims/folder").mkdir(parents=True)
    (place / "victims/notes.txt").write_text("theirs")
    (place / "victims/folder/notes.txt").write_text("theirs, too")


def snapshot(place: Path, *, without: Path | None = None) -> dict[str, tuple[Any, ...]]:
    """Kind, size, time, and target or digest of all below a folder, but for what is in another."""
    found: dict[str, tuple[Any, ...]] = {}
    for folder, names, files in os.walk(place):
        if without is not None and Path(folder) == without:
            names.clear()
            continue
        for name in (*names, *files):
            file = Path(folder, name)
            state = file.lstat()
            own = os.readlink(file) if file.is_symlink() else (
                sha256(file.read_bytes()).hexdigest() if file.is_file() else "")
            when = (0, 0) if file == without else (state.st_size, state.st_mtime_ns)
            found[str(file)] = (state.st_mode, *when, own)
    return found


def _nodes(tree: Any) -> Iterator[tuple[Any, Any]]:
    """All places of a tree as container and key."""
    for key in list(tree) if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else ():
        yield tree, key
        yield from _nodes(tree[key])


def _names(rng: random.Random, folder: Path, content: dict[str, Any]) -> None:
    """Names that lead to files elsewhere, with their right digests."""
    victim = folder.parent / "victims/notes.txt"
    for name in rng.sample(["../victims/notes.txt", str(victim), "c/../../victims/notes.txt", "link/notes.txt",
                            "./../victims/notes.txt", "..", "", "\0", "x" * 300], 3):
        content["files"][name] = sha256(victim.read_bytes()).hexdigest()
    (folder / "link").symlink_to(victim.parent)
    if rng.random() < 0.3:
        content["machine"]["name"] = rng.choice(["../victims/notes", "/etc/passwd", "a/b", "..", "\0"])


def _links(rng: random.Random, folder: Path, content: dict[str, Any]) -> None:
    """A symbolic link, a pipe, a device or a directory in place of a file."""
    file = folder / rng.choice(["estimate.json", *content["files"]])
    elsewhere = folder.parent / "victims" / f"copy-{file.name}"
    how = rng.randrange(6)
    shutil.copy(file, elsewhere)
    file.unlink()
    if how == 0:
        os.mkfifo(file)
    elif how == 1:
        file.mkdir()
    else:
        file.symlink_to(["/dev/zero", elsewhere, elsewhere, file][how - 2])


def _types(rng: random.Random, folder: Path, content: dict[str, Any]) -> None:
    """Other types and sizes of one to three values."""
    for _ in range(rng.randint(1, 3)):
        tree, key = rng.choice(list(_nodes(content)))
        tree[key] = rng.choice(VALUES)


def _numbers(rng: random.Random, folder: Path, content: dict[str, Any]) -> None:
    """Numbers in a table that are huge, not finite or none."""
    tables = [name for name in content["files"] if name.endswith((".csv", ".toml"))]
    file = folder / rng.choice(tables)
    words = file.read_text("utf-8").split(",")
    for _ in range(rng.randint(1, 4)):
        words[rng.randrange(len(words))] = rng.choice(
            ["1e308", "-1e308", "nan", "inf", "9" * 400, "", "x", "1e-320", "0"])
    file.write_text(",".join(words), "utf-8")


def _cut(rng: random.Random, folder: Path, content: dict[str, Any]) -> None:
    """A file that is cut, or of which a byte is changed."""
    file = folder / rng.choice(["estimate.json", *content["files"]])
    data = bytearray(file.read_bytes())
    at = rng.randrange(len(data))
    if rng.random() < 0.5:
        del data[at:]
    else:
        data[at] = rng.randrange(256)
    file.write_bytes(data)


def _exchanged(rng: random.Random, folder: Path, content: dict[str, Any]) -> None:
    """A file of another answer, or two files exchanged."""
    names = list(content["files"])
    one, other = rng.choice(names), rng.choice(names)
    kinds = [each for each in MACHINES if (folder.parent / "good" / each / one).exists()]
    source = folder.parent / "good" / rng.choice(kinds) / one if rng.random() < 0.5 else folder / other
    (folder / one).write_bytes(source.read_bytes())


def _deep(rng: random.Random, folder: Path, content: dict[str, Any]) -> None:
    """Tables in tables without end, in any place."""
    deep: Any = 1.0
    for _ in range(rng.choice([20, 40, 900])):
        deep = [deep] if rng.random() < 0.5 else {"a": deep}
    tree, key = rng.choice(list(_nodes(content)))
    tree[key] = deep


def _leftovers(rng: random.Random, folder: Path, content: dict[str, Any]) -> None:
    """A journal of the former kind that names files elsewhere, and what writers leave, as links to elsewhere."""
    victims = folder.parent / "victims"
    (folder / ".complete/files").mkdir(parents=True)
    names = ["../victims/notes.txt", str(victims / "notes.txt"), "parameters.csv", "../victims/new.txt"]
    for name in names[2:3]:
        (folder / ".complete/files" / name).write_text("new")
    (folder / ".complete/order.json").write_text(json.dumps({"new": names, "old": names[:2]}))
    if rng.random() < 0.5:
        (folder / ".hydroopt-left").symlink_to(victims)
    if rng.random() < 0.3:
        (folder / ".hydroopt.lock").symlink_to(victims / "notes.txt")


def _without(rng: random.Random, folder: Path, content: dict[str, Any]) -> None:
    """A file or a key that is gone."""
    if rng.random() < 0.5:
        (folder / rng.choice(["estimate.json", *content["files"]])).unlink()
    else:
        tree, key = rng.choice([place for place in _nodes(content) if isinstance(place[0], dict)])
        del tree[key]


WAYS: tuple[Callable[[random.Random, Path, dict[str, Any]], None], ...] = (
    _names, _links, _types, _types, _numbers, _cut, _exchanged, _deep, _leftovers, _without)


def spoil(rng: random.Random, good: Path, folder: Path) -> str:
    """A copy of an answer's folder, spoilt in one way, whose name is returned."""
    shutil.copytree(good, folder)
    file = folder / "estimate.json"
    content = json.loads(file.read_text("utf-8"))
    way = rng.choice(WAYS)
    way(rng, folder, content)
    listed = content.get("files")
    if rng.random() < 0.5 and isinstance(listed, dict):
        for name in listed:
            if os.path.isfile(folder / name) and not os.path.islink(folder / name):
                listed[name] = sha256((folder / name).read_bytes()).hexdigest()
    if way not in (_links, _cut) and file.is_file():
        file.write_text(json.dumps(content, indent=1), "utf-8")
    return way.__name__.lstrip("_")


def readers(folder: Path) -> dict[str, Callable[[], object]]:
    """All that reads the folder of an answer, by name."""
    model = ho.Model(MACHINES["identified"])
    answer: list[ho.Answer] = []

    def said() -> ho.Answer:
        return answer[0] if answer else ho.load(folder)

    return {
        "load": lambda: answer.append(ho.load(folder)),
        "text": lambda: (str(said()), repr(said()), said().card().html()),
        "tables": lambda: (said().to_frame(), said().fit_to_frame(), said().parameters.to_csv()),
        "files": lambda: dict(said().files()), "machine": lambda: said().machine, "view": lambda: ho.view(folder),
        "plots": lambda: said().plot.parameters().axes, "codegen": lambda: parameter_source.read(str(folder)),
        "control": lambda: nominal_of(folder, model), "compare": lambda: stored_information(model, folder),
        "excite": lambda: identified(model, folder), "machine file": lambda: ho.load_machine(str(folder)),
        **{f"what-next {kind}": lambda name=name: ho.what_next_problem(name, [folder])  # type: ignore[misc]
           for kind, name in MACHINES.items()}}


def commands(folder: Path, out: Path) -> dict[str, list[str]]:
    """Commands that read the folder of an answer, by name."""
    name, log = MACHINES["identified"], str(folder.parent / "log.csv")
    return {"show": ["show", str(folder)], "view": ["view", str(folder), "-o", str(out)],
            "convert": ["convert", str(folder), str(out / "machine.toml")],
            "codegen": ["codegen", str(folder), "-o", str(out / "c"), "--functions", "gravity_torques"],
            "compare": ["compare", name, str(folder), log, "-o", str(out / "changes")],
            "what-next": ["what-next", name, str(folder), "--force-std", "5 %", "-o", str(out / "next")]}


@contextmanager
def _counted(counts: Counter[str], failures: list[str], what: str) -> Iterator[None]:
    """Count what a reader does: reads, refuses in a sentence, or fails."""
    counts["reads"] += 1
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()), np.errstate(all="ignore"):
            yield
        counts["read"] += 1
    except HydrooptError as error:
        counts["refused"] += 1
        if len(str(error)) > LONGEST + 1 or "\n" in str(error):
            failures.append(f"{what}: {error}")
    except Exception:
        failures.append(f"{what}: {traceback.format_exc()[-1500:]}")


def trial(rng: random.Random, place: Path, counts: Counter[str], failures: list[str], *, by_commands: bool) -> None:
    """Spoil an answer, read it, write into it, and count."""
    folder, out = place / "answer", place / "out"
    kind = rng.choice([*MACHINES])
    what = f"{kind}, {spoil(rng, place / 'good' / kind, folder)}"
    counts["tampered"] += 1
    before = snapshot(place)
    for name, read in readers(folder).items():
        with _counted(counts, failures, f"{what}, {name}"):
            read()
    counts["changes_by_readers"] += snapshot(place) != before
    if by_commands:
        out.mkdir()
        before = snapshot(place, without=out)
        for name, arguments in commands(folder, out).items():
            with _counted(counts, failures, f"{what}, {name}"):
                app(arguments, standalone_mode=False)
        counts["changes_by_readers"] += snapshot(place, without=out) != before
    before = snapshot(place, without=folder)
    with _counted(counts, failures, f"{what}, save"):
        ho.load(place / "good" / kind).save(folder)
    counts["writes_outside"] += snapshot(place, without=folder) != before


def run(number: int = 1000, seed: int = 0, *, by_commands: bool = True) -> dict[str, float]:
    """Counts of folders, reads, refusals, tracebacks and changes."""
    rng, counts, failures = random.Random(seed), Counter[str](), list[str]()
    with tempfile.TemporaryDirectory(prefix="answers-") as made:
        place = Path(os.path.realpath(made))
        prepared(place)
        with chdir(place):
            for k in range(number):
                trial(rng, place, counts, failures, by_commands=by_commands and k % SHARE == 0)
                for left in ("answer", "out"):
                    shutil.rmtree(place / left, ignore_errors=True)
                for file in (place / "victims").glob("copy-*"):
                    file.unlink()
    for failure in failures:
        print(failure, flush=True)
    return {f"answer_folders_{name}": float(counts[name]) for name in (
        "tampered", "reads", "read", "refused", "changes_by_readers", "writes_outside")} | {
        "answer_folders_tracebacks": float(len(failures))}


if __name__ == "__main__":
    print(run())
