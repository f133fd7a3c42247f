"""How work grows with joints: operations, time to write and to compile the regressor, time of a sample."""

import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from hydroopt import Machine, Model, dump_machine, load_machine
from hydroopt.kernels.expression_graph import program
from hydroopt.kernels.native import CACHED, LANES, Kernel, kernel
from studies.bench.contenders import motions
from studies.bench.goals import Row
from studies.bench.kernels import environment
from studies.bench.process import HYDROOPT, measured

JOINTS = (3, 6, 12, 24)
CODEGEN = 24
"""Joints of the chain whose folder of C is written, too."""
REPEATS = 200


def chain(joints: int) -> Machine:
    """The UR10's links and drives one after the other, as often as so many joints take."""
    data: dict[str, Any] = load_machine("ur10").model_dump()
    names = [f"joint_{k + 1}" for k in range(joints)]
    links = [data["links"][k % 6] | {"name": name, "parent": names[k - 1] if k else data["links"][0]["parent"]}
             for k, name in enumerate(names)]
    drives = [data["drives"][k % 6] | {"name": f"{name}_drive", "joint": name} for k, name in enumerate(names)]
    return Machine.model_validate(data | {"name": f"chain_{joints}", "links": links, "drives": drives, "sensors": (),
                                          "notes": {}, "faults": {}})


def growth() -> list[Row]:
    """The regressor of chains of 3 to 24 joints, one thread, CPU time; nothing is taken from the cache."""
    print(f"{'joints':>8} {'operations':>11} {'written s':>10} {'compiled s':>11} {'ns/sample':>10} {'each ns':>8}")
    rows = []
    with tempfile.TemporaryDirectory() as folder, environment(HYDROOPT_CACHE=folder):
        for joints in JOINTS:
            machine = chain(joints)
            began = time.process_time()
            function = Model(machine).regressor
            operations = sum(program(function).operations.values())
            written, before = time.process_time() - began, os.times().children_user
            run = kernel(function)
            if run is None:
                raise SystemExit(f"the kernel of {joints} joints was not compiled")
            compiled = os.times().children_user - before
            rows.append((operations, written, compiled, sample_time(run, function.numel_out(0), machine)))
            print(f"{joints:8d} {operations:11d} {written:10.2f} {compiled:11.2f} {rows[-1][3]:10.0f} "
                  f"{rows[-1][3] / operations:8.3f}")
        powers = [float(np.polyfit(np.log(JOINTS), np.log(column), 1)[0]) for column in zip(*rows, strict=True)]
        print(f"{'power of':>8} {powers[0]:11.2f} {powers[1]:10.2f} {powers[2]:11.2f} {powers[3]:10.2f}")
        file = Path(folder) / "chain.toml"
        file.write_text(dump_machine(chain(CODEGEN)))
        return [Row("codegen long", measured([HYDROOPT, "codegen", str(file), "-o", f"{folder}/c", "--quiet"]).cpu)]


def sample_time(run: Kernel, entries: int, machine: Machine) -> float:
    """Nanoseconds a sample, results written over and small enough for the caches."""
    count = max(LANES, CACHED // (8 * entries) // LANES * LANES - LANES)
    state = motions(machine, count)
    out, times = run(state, count), []
    for _ in range(REPEATS):
        began = time.thread_time()
        run(state, count, out)
        times.append(time.thread_time() - began)
    return 1e9 * min(times) / count
