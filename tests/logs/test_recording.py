"""Groups of channels with stamps of their own, and what their merging keeps, interpolates and leaves out."""

import hashlib

import numpy as np
import pytest

from hydroopt.errors import LogError
from hydroopt.logs.clock import Clock
from hydroopt.logs.log import Log
from hydroopt.logs.log_files import read_log, read_recording
from hydroopt.logs.recording import Recording


def group(name, rate, channel, duration=2.0, start=0.0):
    t = start + np.arange(round(duration * rate) + 1) / rate
    return Log(name, t, {channel: np.sin(t)})


def test_one_group_is_the_log_itself():
    t = np.array([0.0, 0.1, 0.2, 5.0, 5.1])
    log = Log("run", t, {"boom.q": np.sin(t)}, np.array([3, 4, 5, 9, 10]), path="run.csv", sha256="1")
    again = Recording.of(log).log()
    for name in ("t", "sample", "segment"):
        np.testing.assert_array_equal(getattr(again, name), getattr(log, name))
    np.testing.assert_array_equal(again.channels["boom.q"], log.channels["boom.q"])
    assert (again.name, again.path, again.sha256, again.findings) == ("run", "run.csv", "1", ())


def test_the_fastest_group_that_forces_need_is_the_grid():
    recording = Recording("run", (group("imu", 1000, "boom.qd"), group("joints", 100, "boom.q"),
                                  group("can", 20, "boom_cylinder.p_head")))
    log = recording.log()
    assert log.size == 201
    np.testing.assert_array_equal(log.t, recording.groups[1].t)
    np.testing.assert_allclose(log.channels["boom.qd"], np.sin(log.t), atol=1e-15)
    np.testing.assert_allclose(log.channels["boom_cylinder.p_head"], np.sin(log.t), atol=0.05**2 / 8)
    fast, slow = log.findings
    assert (fast.kind, fast.count, slow.kind, slow.count) == ("resampled", 2001 - 201, "resampled", 0)
    assert "1000 Hz" in fast.text
    assert "none of its 41 samples" in slow.text
    assert recording.log("imu").size == 2001
    assert {f.count for f in recording.log("imu").findings} == {0}


def test_every_sample_without_a_partner_is_stated():
    late = group("can", 50, "boom_cylinder.p_head", duration=1.0, start=0.5)
    log = Recording("run", (group("joints", 100, "boom.q"), late)).log()
    assert (log.t[0], log.t[-1], log.size) == (0.5, 1.5, 101)
    finding, resampled = log.findings
    assert (finding.kind, finding.count, finding.first, finding.last) == ("unpaired", 100, 1, 201)
    assert (resampled.kind, resampled.count) == ("resampled", 0)


def test_nothing_is_interpolated_across_a_gap():
    t = np.concatenate([np.arange(0, 0.5, 0.02), np.arange(1.0, 2.001, 0.02)])
    slow = Log("can", t, {"boom_cylinder.p_head": t})
    log = Recording("run", (group("joints", 100, "boom.q"), slow)).log()
    assert not np.any((log.t > 0.48 + 1e-9) & (log.t < 1.0 - 1e-9))
    assert log.segment[0] == 0
    assert log.segment[-1] == 1
    np.testing.assert_allclose(log.channels["boom_cylinder.p_head"], log.t, atol=1e-12)
    assert [f.kind for f in log.findings] == ["unpaired", "resampled"]
    assert "gap of 'can'" in log.findings[0].text


def test_clocks_that_are_hours_apart_are_named():
    with pytest.raises(LogError, match=r"'can' begins 3612 s after 'joints'.*1 h: a time zone\?; .*delay = '3612 s'"):
        Recording("run", (group("joints", 100, "boom.q"),
                          group("can", 50, "boom_cylinder.p_head", start=3612.0))).log()


def test_a_late_and_fast_clock_is_corrected():
    true = group("imu", 100, "boom.qd")
    stamped = Log("imu", true.t * 1.003 + 0.02, true.channels)
    recording = Recording("run", (stamped,), clocks={"imu": Clock(0.02, 0, 0.003)})
    np.testing.assert_allclose(recording.log().t, true.t, atol=1e-15)


@pytest.mark.parametrize(("groups", "sentence"), [
    ((), "no group"),
    ((group("a", 100, "boom.q"), group("b", 50, "boom.q")), "'boom.q' stands in 'a' and in 'b'"),
    ((group("a", 100, "boom.q"), group("a", 50, "stick.q")), "two groups have one name"),
])
def test_what_is_no_recording_is_refused(groups, sentence):
    with pytest.raises(LogError, match=sentence):
        Recording("run", groups)


def test_several_files_are_one_recording(tmp_path):
    joints, can = tmp_path / "joints.csv", tmp_path / "can.csv"
    t = np.arange(200) / 100
    Log("joints", t, {"boom.q": np.sin(t)}).write(joints)
    Log("can", t[::5], {"boom_cylinder.p_head": t[::5]}).write(can)
    recording = read_recording([joints, can])
    assert [each.name for each in recording.groups] == ["joints", "can"]
    assert recording.path == f"{joints}, {can}"
    assert recording.sha256 == hashlib.sha256("".join(
        hashlib.sha256(file.read_bytes()).hexdigest() for file in (joints, can)).encode()).hexdigest()
    log = recording.log()
    assert log.size == 196
    np.testing.assert_allclose(log.channels["boom_cylinder.p_head"], log.t, atol=1e-15)
    assert read_log(joints).sha256 == read_recording(joints).sha256 == hashlib.sha256(joints.read_bytes()).hexdigest()
