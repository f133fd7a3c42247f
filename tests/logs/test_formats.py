"""One log in every format: the numbers are the same to the last bit, and damaged files end in a sentence."""

import shutil

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from scipy.io import savemat

from fixtures.tiers import tiered
from hydroopt.errors import LogError
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.logs.column_map import LogMap
from hydroopt.logs.log import Log
from hydroopt.logs.log_files import read_log, read_recording
from hydroopt.logs.poses import read_poses
from hydroopt.solving import solve
from studies.first_contact.log_formats import (
    CHANNELS,
    FORMATS,
    MADE,
    MODEL,
    NAMED,
    START,
    UNITS,
    N,
    T,
    npz,
    ros2,
    workbook,
)

DATED = {"tdms", "mdf", "ros2 sqlite", "ros2 mcap", "ros1", "mcap json"}


@pytest.mark.parametrize("kind", tiered(FORMATS, lambda kind: kind not in ("mdf", "ros2 mcap", "mat")))
def test_every_format_gives_the_same_numbers(tmp_path, kind):
    path, layout = FORMATS[kind](tmp_path)
    recording = read_recording(path, mapping=layout)
    log = recording.log()
    assert log.t.tobytes() == T.tobytes()
    assert {name: log.channels[name].tobytes() for name in CHANNELS} == {
        name: x.tobytes() for name, x in CHANNELS.items()}
    assert dict(log.units) == UNITS
    assert len(log.sha256) == 64
    assert recording.start == (START if kind in DATED else None)


@pytest.mark.parametrize("kind", ["mat", "hdf5", "npz"])
@pytest.mark.parametrize("across", [False, True])
def test_channels_run_along_the_shorter_side_of_a_matrix(tmp_path, kind, across):
    matrix = np.array([T, *CHANNELS.values()])
    path = tmp_path / f"run.{kind.replace('hdf5', 'h5')}"
    content = {"log": matrix.T if across else matrix}
    if kind == "hdf5":
        with h5py.File(path, "w") as file:
            file["log"] = content["log"]
    else:
        {"mat": savemat, "npz": lambda path, content: np.savez(path, **content)}[kind](path, content)
    units = {"t": "s", **UNITS}
    log = read_log(path, mapping=LogMap.model_validate({"columns": {
        name: {"variable": "log", "row": k, "unit": units[name]} for k, name in enumerate(units)}}))
    assert {name: x.tobytes() for name, x in log.channels.items()} == {
        name: x.tobytes() for name, x in CHANNELS.items()}


def numbers(log):
    found = solve(identification_problem(MODEL, [log]))
    return [x.tobytes() for x in (found.value, found.std, found.ci95, found.base_value)]


def dated():
    return {"t": START + (T * 1e9).round().astype("m8[ns]"), **NAMED}


FRAMES = {"pandas": lambda: pd.DataFrame({"t [s]": T, **NAMED}), "pandas with dates": lambda: pd.DataFrame(dated()),
          "Arrow": lambda: pa.table({"t [s]": T, **NAMED}), "Arrow with dates": lambda: pa.table(dated())}


@pytest.mark.slow
def test_every_format_gives_the_same_estimate(tmp_path):
    expected = numbers(MADE)
    for kind, write in FORMATS.items():
        (tmp_path / kind).mkdir()
        path, layout = write(tmp_path / kind)
        assert numbers(read_log(path, mapping=layout)) == expected, kind
    for kind, make in FRAMES.items():
        assert numbers(Log.from_frame(make())) == expected, kind


@pytest.mark.parametrize("kind", FRAMES)
def test_every_frame_gives_the_same_numbers(kind):
    log = Log.from_frame(FRAMES[kind]())
    assert log.t.tobytes() == T.tobytes()
    assert {name: x.tobytes() for name, x in log.channels.items()} == {
        name: x.tobytes() for name, x in CHANNELS.items()}


MILD = {"tdms"}
"""Formats whose first bytes may be spoilt without effect on what is read."""


@pytest.mark.parametrize("kind", tiered(
    ["mat 7.3", "hdf5", "npz", "xlsx", "tdms", "mdf", "ros1", "mcap json"], lambda kind: kind in ("hdf5", "mcap json")))
def test_damaged_files_end_in_a_sentence(tmp_path, kind):
    path, layout = FORMATS[kind](tmp_path)
    data = path.read_bytes()
    rng = np.random.default_rng(7)
    damaged = [data[: len(data) // 3]]
    flipped = np.frombuffer(data, np.uint8).copy()
    flipped[rng.integers(0, min(len(data), 4000), 40)] ^= rng.integers(1, 256, 40).astype(np.uint8)
    damaged.append(flipped.tobytes())
    sentences = []
    for content in damaged:
        path.write_bytes(content)
        try:
            read_log(path, mapping=layout)
        except LogError as error:
            sentences.append(str(error))
    assert len(sentences) >= 2 - (kind in MILD)
    assert all(path.name in sentence and "\n" not in sentence for sentence in sentences)


@pytest.mark.parametrize(("cells", "first"), [(("0,125", "1,5"), 1.5), (("0,125", "1,250"), 1.25)])
def test_numbers_typed_as_text_with_a_decimal_comma_are_read(tmp_path, cells, first):
    rows = [["t [s]", "boom.q [rad]"], *[[str(k), cells[k % 2 == 0]] for k in range(30)]]
    path = workbook(tmp_path / "typed.xlsx", {"log": rows})
    assert read_log(path).channels["boom.q"][:2].tolist() == [first, 0.125]


def test_groups_of_a_file_are_merged(tmp_path):
    import h5py

    slow, fast = np.arange(N) / 50, np.arange(4 * N) / 200
    with h5py.File(tmp_path / "run.h5", "w") as file:
        for group, t, names in (("joints", fast, ("lift.q",)), ("can", slow, ("lift_cylinder.p_head",))):
            file[f"{group}/t"] = t
            file[f"{group}/t"].attrs["units"] = "s"
            for name in names:
                file[f"{group}/{name}"] = np.sin(t)
                file[f"{group}/{name}"].attrs["units"] = UNITS[name]
    recording = read_recording(tmp_path / "run.h5")
    assert {group.name: group.size for group in recording.groups} == {"joints": 4 * N, "can": N}
    log = recording.log()
    assert log.size == 4 * N - 3
    np.testing.assert_array_equal(log.channels["lift.q"], np.sin(log.t))


def test_a_table_of_poses_may_be_a_spreadsheet(tmp_path):
    path = workbook(tmp_path / "poses.xlsx", {"poses": [["stage", "pose", "boom.q [deg]"], ["low", "a", 10.0],
                                                        ["low", "b", 0.1 + 0.2]]})
    poses = read_poses(path)
    assert poses.pose.tolist() == ["a", "b"]
    np.testing.assert_array_equal(poses.channels["boom.q"], np.pi / 180 * np.array([10.0, 0.1 + 0.2]))
    workbook(path, {name: [["stage", "boom.q [deg]"], ["low", 10.0]] for name in ("one", "two")})
    with pytest.raises(LogError, match=r"poses\.xlsx: there are 2 sheets or files; save the table of poses alone"):
        read_poses(path)


def test_a_directory_is_one_recording(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    Log("a", T, {"lift.q": CHANNELS["lift.q"]}).write(folder / "joints.csv")
    Log("b", T, {"lift_cylinder.p_head": CHANNELS["lift_cylinder.p_head"]}).write(folder / "more.parquet")
    shutil.copy(folder / "joints.csv", folder / "readme.md")
    recording = read_recording(folder)
    assert [group.name for group in recording.groups] == ["joints", "more"]
    assert recording.name == "run"


def test_a_directory_is_one_recording_with_its_bags(tmp_path):
    """Positions of the bag's topic beside pressures as text."""
    folder = tmp_path / "monday"
    folder.mkdir()
    ros2("MCAP")(folder)
    names = [name for name in CHANNELS if ".p_" in name]
    Log("can", T, {name: CHANNELS[name] for name in names}).write(folder / "can.csv")
    stamps = [str(START + np.timedelta64(20 * k, "ms")) for k in range(N)]
    rows = (folder / "can.csv").read_text().replace("t [s]", "t").splitlines()
    (folder / "can.csv").write_text("\n".join([rows[0], *(f"{stamp},{row.partition(',')[2]}" for stamp, row in
                                                         zip(stamps, rows[1:], strict=True))]))
    layout = LogMap.model_validate({"columns": {
        "lift.q": {"column": "position[lift]", "unit": "rad", "group": "run"}, **{
            name: {"column": f"{name} [Pa]", "unit": "Pa", "group": "can"} for name in names}},
        "clocks": {"can": {"t": {"column": "t"}}}})
    log = read_recording(folder, mapping=layout).log()
    np.testing.assert_allclose(log.channels["lift.q"], CHANNELS["lift.q"], rtol=0, atol=1e-12)
    assert set(names) <= set(log.channels)


def test_a_missing_library_is_named_with_the_command(tmp_path, monkeypatch):
    path, layout = npz(tmp_path)
    (tmp_path / "h5py.py").write_text("raise ImportError('gone', name='h5py')")
    monkeypatch.setattr("hydroopt.logs.formats.foreign_file.ROOT", tmp_path)
    (tmp_path / "hydroopt").symlink_to(__import__("hydroopt").__path__[0])
    path.rename(tmp_path / "run.h5")
    with pytest.raises(LogError, match=r"run\.h5: the library 'h5py' .* HDF5 files is not installed; run "
                                       r"pip install 'hydroopt-calibration\[hdf5\]'"):
        read_log(tmp_path / "run.h5", mapping=layout)
