"""CPU time of `hydroopt control`."""

import subprocess
import tempfile
from pathlib import Path

from hydroopt import Model, load_machine
from hydroopt.logs.table import encoded_columns
from studies.bench.goals import Row
from studies.bench.jobs import ITS_LIBRARIES
from studies.bench.process import HYDROOPT, libraries, measured
from studies.cat215b_tracking.run import feasible

MOTION = 34 * 50 + 1
"""Samples of the motion to follow."""
RUNS = 3


def control() -> list[Row]:
    """CPU of the command, six runs along 34 s of motion, page included: with no kernel in the cache, and with all."""
    model = Model(load_machine("cat215b"))
    motion = feasible(model, 28.0, 3)
    columns = {f"{joint}.q [rad]": motion.q[:MOTION, k] for k, joint in enumerate(model.machine.joints)}
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "motion.csv").write_bytes(encoded_columns({"t [s]": motion.t[:MOTION], **columns}))
        for made in (["simulate", "cat215b", "-o", "log", "--truth", "random", "--seed", "1", "--quiet"],
                     ["identify", "cat215b", "log/log.csv", "-o", "estimate", "--quiet"]):
            subprocess.run([HYDROOPT, *made], check=True, cwd=folder)
        command = [HYDROOPT, "control", f"{folder}/estimate", "--motion", f"{folder}/motion.csv", "--truth",
                   f"{folder}/log/truth.json", "-o", f"{folder}/loop", "--quiet"]

        def cpu(cache: str) -> float:
            return measured(command, HYDROOPT_CACHE=f"{folder}/{cache}").cpu

        cpu("first")  # leaves bytecode
        anew = min(cpu(f"kernels{run}") for run in range(RUNS))
        cached = min(cpu("first") for _ in range(RUNS))
    loaded = libraries()
    return [Row("control", cached, ITS_LIBRARIES, loaded), Row("control anew", anew, ITS_LIBRARIES, loaded)]
