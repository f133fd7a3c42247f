"""What looks wrong in a log, and what does not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from hydroopt.logs.log_files import read_log
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory, simulate


@pytest.mark.parametrize("name", ["cat215b", "excavator_imu", "wheel_loader"])
def test_exact_logs_have_no_findings_and_noisy_ones_keep_theirs(name: str, tmp_path: Path) -> None:
    """An unloaded chamber rests at the pressure of the return line: in a log without noise that is no fault."""
    model = Model(load_machine(name))
    motion = random_trajectory(model, duration=20, rate=50, seed=1)
    exact, noisy = (simulate(model, motion, noise=noise, seed=1) for noise in (False, True))
    exact.write(tmp_path / "exact.csv")
    assert not read_log(tmp_path / "exact.csv").findings
    channel = next(each for each in noisy.channels if each.endswith(".p_head"))
    frozen = noisy.channels[channel].copy()
    frozen[300:700] = frozen[300]
    replace(noisy, channels={**noisy.channels, channel: frozen}).write(tmp_path / "stuck.csv")
    assert {each.channel for each in read_log(tmp_path / "stuck.csv").findings} == {channel}
