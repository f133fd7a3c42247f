"""What a linkage costs: operations of the regressor against the open tree, and time per operation against today's."""

import tempfile
import time
from collections.abc import Mapping
from functools import partial
from typing import Any

from hydroopt import Machine, Model, load_machine
from hydroopt.kernels.expression_graph import program
from studies.bench.contenders import CONTROLLER, FLAGS, KEPT, SAMPLES, Regressor, toolchain
from studies.bench.kernels import REPEATS, in_turns

BEFORE, LINKED = "cat215b", "excavator_bucket"
"""A machine without loops, whose kernels set what an operation may take, and one with a linkage."""
NEAR, CACHED = 8, 1 << 17
"""Results that stay in a core's first cache, and those [bytes] that stay in its second, of whatever machine; those of
`KEPT` samples need not."""


def operations(machine: Machine) -> int:
    """Of the kernel of the complete regressor."""
    return sum(program(Model(machine).regressor).operations.values())


def cut_open(machine: Machine) -> Machine:
    """The same bodies and cylinders without the pin that closes the bucket's linkage: rocker and coupler move alone."""
    data: dict[str, Any] = machine.model_dump()
    limits = {"lower": -1.0, "upper": 1.0, "dependent": False}
    for link in data["links"]:
        link["joint"] |= limits if link["joint"]["dependent"] else {}
    driven = ({"name": f"{joint}_drive", "joint": joint} for joint in ("bucket", "coupler"))
    return Machine.model_validate(data | {"loops": (), "sensors": (), "notes": {}, "drives": tuple(driven)})


def linkage() -> None:
    """The complete regressor of the excavator with its bucket linkage, one thread, its own time."""
    linked = load_machine(LINKED)
    counts = {name: operations(load_machine(name)) for name in (BEFORE, LINKED)}
    opened = operations(cut_open(linked))
    print(f"{'operations of the regressor':50} {'operations':>18} {'x open tree':>18}")
    print(f"  {'open tree: rocker and coupler move alone':48} {opened:18d} {1.0:18.2f}")
    print(f"  {'closed by the linkage':48} {counts[LINKED]:18d} {counts[LINKED] / opened:18.2f}")
    print("target: at most twice the open tree")
    print(toolchain())
    with tempfile.TemporaryDirectory() as folder:
        regressors = {name: Regressor(name, folder) for name in counts}
        runs: dict[tuple[str, str], Any] = {}
        for name, regressor in regressors.items():
            each = regressor.expected[0].nbytes
            print(f"{name}: {KEPT} results take {KEPT * each / 2**20:.1f} MiB")
            ways = {f"kernel, {' '.join(FLAGS)}": regressor.kernel(),
                    f"exported, {' '.join(CONTROLLER)}": regressor.exported(CONTROLLER, fold_geometry=True)}
            for kept, said in ((NEAR, f"{NEAR} results"), (CACHED // each, f"{CACHED >> 10} KiB"),
                               (KEPT, f"{KEPT} results")):
                runs |= {(f"{said}, {way}", name): partial(made.over, regressor.state, made.room(kept), kept)
                         for way, made in ways.items()}
        taken = in_turns(runs, 10 * REPEATS, time.thread_time, min)
    show({key: 1e9 * each / SAMPLES for key, each in taken.items()}, counts)


def show(nanoseconds: Mapping[tuple[str, str], float], counts: Mapping[str, int]) -> None:
    """Print the time of each way and machine, and what an operation takes against the machine without loops."""
    print(f"{'':62} {'ns/sample':>18} {'ns/operation':>18} {f'x {BEFORE}':>18}")
    for (way, name), taken in nanoseconds.items():
        each, before = taken / counts[name], nanoseconds[way, BEFORE] / counts[BEFORE]
        print(f"  {f'{name}: {way}':60} {taken:18.0f} {each:18.3f} {each / before:18.2f}")
    print("CPU time, the least of all runs. Target: an operation takes about as long as without loops while results")
    print("stay in the cache; a linkage has twice the columns, and writing them costs more where they do not")
