"""CPU time of `hydroopt control`."""

import resource
import subprocess
import tempfile
from pathlib import Path

from hydroopt import Model, load_machine
from hydroopt.logs.table import encoded_columns
from studies.bench.jobs import HYDROOPT, as_installed
from studies.cat215b_tracking.run import feasible

MOTION = 34 * 50 + 1
"""Samples of the motion to follow."""


def control() -> None:
    """CPU of the command, six runs along 34 s of motion, page included: with no kernel in the cache, and with all."""
    model = Model(load_machine("cat215b"))
    motion = feasible(model, 28.0, 3)
    columns = {f"{joint}.q [rad]": motion.q[:MOTION, k] for k, joint in enumerate(model.machine.joints)}
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "motion.csv").write_bytes(encoded_columns({"t [s]": motion.t[:MOTION], **columns}))
        for command in (["simulate", "cat215b", "-o", "log", "--truth", "random", "--seed", "1", "--quiet"],
                        ["identify", "cat215b", "log/log.csv", "-o", "estimate", "--quiet"]):
            subprocess.run([HYDROOPT, *command], check=True, cwd=folder)
        for kernels in ("none cached", "all cached", "all cached"):
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            command = [HYDROOPT, "control", "estimate", "--motion", "motion.csv", "--truth", "log/truth.json",
                       "-o", "loop", "--quiet"]
            subprocess.run(command, check=True, cwd=folder,
                           env=as_installed(folder) | {"HYDROOPT_CACHE": f"{folder}/kernels"})
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            print(f"  kernels {kernels}: {after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime:.1f} s "
                  "(target 4)")
