"""Native regressors against CasADi's own C, the exported C and Pinocchio, from runs that take turns: the least CPU time
of each where one thread works, medians of wall times elsewhere."""

import os
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

from hydroopt import Model, load_machine
from hydroopt.kernels.native import Runner
from studies.bench import robot_libraries
from studies.bench.contenders import CONTROLLER, FLAGS, KEPT, SAMPLES, Contender, Regressor, motions, toolchain
from studies.bench.goals import Row
from studies.bench.process import HYDROOPT

REPEATS = 15
FEW, MILLION, ROOM = 1664, 1_000_000, 8e9
"""Samples of a usual log and of the batch, and the free memory [bytes] from which it takes them all."""
KERNEL = "hydroopt's kernel"
PLAIN, FOLDED = "CasADi, as written", "exported, geometry folded"
HELD, FRESH, COPIED = "memory written before", "fresh memory", "NumPy's copy of these bytes"


def excavator() -> list[Row]:
    """The complete regressor of the CAT 215B in C, one thread, its own time."""
    print(toolchain())
    with tempfile.TemporaryDirectory() as folder:
        regressor = Regressor("cat215b", folder)
        groups: dict[str, dict[str, Contender]] = {}
        for flags in (FLAGS, CONTROLLER):
            groups[" ".join(flags)] = {
                **regressor.casadi(flags), **({KERNEL: regressor.kernel()} if flags == FLAGS else {}),
                FOLDED: regressor.exported(flags, fold_geometry=True)}
            groups[f"{' '.join(flags[:2])}, geometry as an argument"] = {
                PLAIN: regressor.parametric(flags),
                "exported": regressor.exported(flags, fold_geometry=False)}
        walls = race(regressor, groups)
    ours, theirs = " ".join(FLAGS), " ".join(CONTROLLER)
    return [Row("kernel", walls[ours, KERNEL, KEPT], "CasADi's C, gcc -O3", walls[ours, PLAIN, KEPT]),
            Row("one sample", walls[theirs, FOLDED, KEPT], "CasADi's C", walls[theirs, PLAIN, KEPT])]


def arm() -> list[Row]:
    """The regressor of a six-joint arm, the UR10, in C and from Python, one thread, its own time."""
    print(toolchain())
    with tempfile.TemporaryDirectory() as folder:
        regressor = Regressor("ur10", folder)
        race(regressor, {" ".join(FLAGS): {**regressor.casadi(), KERNEL: regressor.kernel()}})
        first = [regressor.model.parameters.names.index(f"{link.name}.m") for link in regressor.machine.links]
        bodies = np.add.outer(first, [0, 1, 2, 3, 4, 5, 7, 6, 8, 9]).ravel()  # Pinocchio has I_yy before I_xz
        others = robot_libraries.contenders(regressor.machine, [x[:FEW] for x in regressor.state],
                                            regressor.expected[0][:, bodies], folder)
        with environment(OMP_NUM_THREADS="1"):
            walls = {name: 1e9 * wall / FEW for name, wall in in_turns(others, clock=time.thread_time, of=min).items()}
            many = portion(regressor)
            for count, repeats in ((FEW, 3 * REPEATS), (many, 3)):
                walls |= from_python(regressor, count, repeats)
    base = next(wall for name, wall in walls.items() if "from Python" in name)
    print(f"{'UR10, one thread':64} {'ns/sample':>10} {'x Pinocchio from Python':>24}")
    for name, wall in walls.items():
        print(f"  {name:62} {wall:10.0f} {base / wall:24.2f}")
    return [Row(goal, walls[f"{KERNEL}, {count} samples, {FRESH}"], "NumPy's copy, both to fresh memory,",
                        walls[f"{COPIED}, {count} samples, {FRESH}"])
            for goal, count in (("python", FEW), ("python many", many))]


def portion(regressor: Regressor) -> int:
    """A million samples, or as many as memory takes twice over."""
    free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return int(min(MILLION, free / (4 * regressor.expected[0].nbytes)))


def from_python(regressor: Regressor, count: int, repeats: int) -> dict[str, float]:
    """Nanoseconds a sample of the regressor at so many samples, and of NumPy's copy of as many bytes."""
    runner, state = Runner(), motions(regressor.machine, count)
    held = runner.over(regressor.function, *state)
    plain = np.ones(held[0].shape)
    copied = np.empty_like(plain)
    walls = in_turns({
        f"{KERNEL}, {count} samples, {HELD}": lambda: runner.over(regressor.function, *state, out=held),
        f"{KERNEL}, {count} samples, {FRESH}": lambda: runner.over(regressor.function, *state),
        f"{COPIED}, {count} samples, {HELD}": lambda: np.copyto(copied, plain),
        f"{COPIED}, {count} samples, {FRESH}": plain.copy}, repeats, time.thread_time, min)
    return {name: 1e9 * wall / count for name, wall in walls.items()}


def batch() -> None:
    """A million regressors of the CAT 215B from Python, against one call of the same kernel in C."""
    print(toolchain())
    count = int(MILLION * min(1.0, os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / ROOM))
    bare = "one call in C, 1 thread, memory written before"
    with tempfile.TemporaryDirectory() as folder:
        regressor, runner = Regressor("cat215b", folder), Runner()
        kernel, state = regressor.kernel(), motions(regressor.machine, count)
        held = runner.over(regressor.function, *state)
        runs: dict[str, Callable[[], object]] = {bare: partial(kernel.over, state, held[0], count)}

        def over(out: list[np.ndarray] | None, threads: int) -> None:
            with environment(OMP_NUM_THREADS=str(threads)):
                runner.over(regressor.function, *state, out=out)

        for threads in sorted({1, len(os.sched_getaffinity(0))}):
            for memory, out in ((HELD, held), (FRESH, None)):
                runs[f"from Python, {threads} thread{'s' * (threads > 1)}, {memory}"] = partial(over, out, threads)
        walls = in_turns(runs)
    print(f"{f'{count} samples, {held[0].nbytes / 1e9:.1f} GB':50} {'ns/sample':>18} {'times the time in C':>21}")
    for name, wall in walls.items():
        print(f"  {name:48} {1e9 * wall / count:18.0f} {wall / walls[bare]:21.2f}")
    print("target: at most 1.5 times the time in C")


def first() -> None:
    """What the CAT 215B's regressor takes before its first result, and its folder of C before it is tested."""
    machine = load_machine("cat215b")
    function, state, runner = Model(machine).regressor, motions(machine, 1664), Runner()

    def from_cache(folder: str) -> None:
        with environment(HYDROOPT_CACHE=folder):
            Runner().over(function, *state)

    def from_nothing() -> None:
        with tempfile.TemporaryDirectory() as folder:
            from_cache(folder)

    with tempfile.TemporaryDirectory() as folder:
        walls = in_turns({"first call, compiled": from_nothing, "first call, cached": partial(from_cache, folder),
                          "later call": lambda: runner.over(function, *state)})
        for name, wall in walls.items():
            print(f"  {f'{name}, 1664 samples':48} {1e3 * wall:18.1f} ms")
        for kind, options in (("double", []), ("float32", ["--float32"])):
            where = f"{folder}/{kind}"
            commands = {"hydroopt codegen cat215b": [HYDROOPT, "codegen", "cat215b", "-o", where, *options],
                        "make check": ["make", "-C", where, "clean", "check"]}
            walls = in_turns({name: partial(subprocess.run, command, capture_output=True, check=True)
                              for name, command in commands.items()}, repeats=3)
            for name, wall in (walls | {"together": sum(walls.values())}).items():
                print(f"  {f'{name}, {kind}':48} {wall:18.1f} s")
    print("target: 20 s together; medians of 3 runs, of 15 above")


def in_turns(runs: Mapping[Any, Callable[[], object]], repeats: int = REPEATS,
             clock: Callable[[], float] = time.perf_counter,
             of: Callable[[list[float]], float] = statistics.median) -> dict[Any, float]:
    """Median time [s] of each run, or another `of` its times; they take turns, so that what else the machine does meets
    them all.
    """
    taken: dict[Any, list[float]] = {name: [] for name in runs}
    for _ in range(repeats + 1):
        for name, run in runs.items():
            began = clock()
            run()
            taken[name].append(clock() - began)
    return {name: of(times[1:]) for name, times in taken.items()}  # the first time warms up


def race(regressor: Regressor, groups: Mapping[str, Mapping[str, Contender]]) -> dict[tuple[str, str, int], float]:
    """Nanoseconds per sample by group, contender and results kept; print them, and how many times as fast as the
    fastest of CasADi's in its group each is."""
    runs: dict[tuple[str, str, int], Callable[[], object]] = {}
    for group, contenders in groups.items():
        for name, contender in contenders.items():
            out = contender.room()
            for kept in (KEPT, 1):
                runs[group, name, kept] = partial(contender.over, regressor.state, out, kept)
    walls = {key: 1e9 * wall / SAMPLES for key, wall in in_turns(runs, 3 * REPEATS, time.thread_time, min).items()}
    for group, contenders in groups.items():
        base = min(walls[key] for key in walls if key[0] == group and "CasADi" in key[1])
        print(f"{group:50} {f'ns, {KEPT} results kept':>18} {'one kept':>10} {'x CasADi':>10}")
        for name in contenders:
            many, one = (walls[group, name, kept] for kept in (KEPT, 1))
            print(f"  {name:48} {many:18.0f} {one:10.0f} {base / many:10.2f}")
    return walls


@contextmanager
def environment(**variables: str) -> Iterator[None]:
    before = dict(os.environ)
    os.environ.update(variables)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)
