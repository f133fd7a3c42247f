"""Widths of intervals are those of samples: their stated standard errors hold between seeds, and without a compiler."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hydroopt as ho

LIFT = "patu655_lift"


def test_standard_errors_of_widths_are_the_scatter_between_seeds() -> None:
    machine = ho.load_machine(LIFT)
    log = ho.simulate(machine, ho.random_trajectory(machine, duration=10.0, rate=50.0, seed=1), seed=1)
    problem = ho.identification_problem(machine, [log])
    seen = [ho.solve(problem, seed=seed).posterior.own for seed in range(16)]
    std, error = np.array([one.std for one in seen]), np.array([one.error for one in seen])
    drawn = error.mean(axis=0) > 0
    scatter = std[:, drawn].std(axis=0, ddof=1) / std[:, drawn].mean(axis=0)
    # each of the ratios scatters by a fifth, and all parameters are of the same chains
    assert 0.7 < np.sqrt(np.mean((scatter / error[:, drawn].mean(axis=0)) ** 2)) < 1.4


SAMPLED = 0.3
"""Difference of values and widths, in deviations: of 128 chains a width has a standard error of 1/√(2·128), even if
each chain stayed in place, and a difference of two 0.09."""
ROUNDED = 1e-6
"""The same where nothing is sampled."""


@pytest.mark.parametrize(("job", "most"), [(["identify"], SAMPLED), *(
    pytest.param(["identify", *options], most, marks=pytest.mark.slow) for options, most in (
        (["--method", "wls"], ROUNDED), (["--method", "nlp"], SAMPLED), (["--fitted-motion"], SAMPLED),
        (["--loss", "huber"], SAMPLED)))])
def test_answers_are_the_same_without_a_compiler(job: list[str], most: float, tmp_path: Path) -> None:
    machine = ho.load_machine(LIFT)
    log = ho.simulate(machine, ho.random_trajectory(machine, duration=10.0, rate=50.0, seed=1), seed=1)
    (tmp_path / "log.csv").write_bytes(log.encoded())
    (tmp_path / "no compiler").mkdir()
    answers = [answer(job, tmp_path, out, path) for out, path in (
        ("with", os.environ["PATH"]), ("without", str(tmp_path / "no compiler")))]
    first, second = ({one["name"]: one for one in each["parameters"]} for each in answers)
    assert answers[0]["status"] == answers[1]["status"]
    assert first.keys() == second.keys()
    for name, one in first.items():
        other = second[name]
        assert one["identifiability"] == other["identifiability"]
        if one["std"]:
            assert abs(one["value"] - other["value"]) < most * one["std"], name
            assert abs(one["std"] - other["std"]) < most * one["std"], name


def answer(job: list[str], folder: Path, out: str, path: str) -> dict[str, Any]:
    """What a command answers that finds compilers on this PATH."""
    name, *options = job
    command = [sys.executable, "-m", "hydroopt", name, LIFT, "log.csv", *options, "-o", out, "--quiet"]
    environment = {key: value for key, value in os.environ.items() if key != "CC"} | {
        "PATH": path, "HYDROOPT_CACHE": str(folder / f"cache {out}")}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode in (0, 3), done.stderr
    assert ("no C compiler found" in done.stderr) == (out == "without")
    found: dict[str, Any] = json.loads((folder / out / "estimate.json").read_text())
    return found
