import hashlib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hydroopt.errors import HydrooptError, LogError
from hydroopt.logs.log_files import read_log
from hydroopt.logs.poses import LogMap, Poses, joined, read_map, read_pose_files, read_poses

DATA = Path(__file__).parents[3] / "shared" / "data"
HEADER = "stage,fixture,pose,t [s],boom.q [deg],boom_cylinder.length [mm],tip.x [m],stick.distance [cm]"
ROWS = ["front,A,1,0.5,30,1500,2.5,", "front,\"B, left\",2,1.5,nan,1600,,250", ",,7b,,90,,NaN,300"]
GOOD = "\n".join([HEADER, *ROWS]) + "\n"
PANDA = ("header = false\n[columns]\n"
         + "".join(f'"panda_joint{i + 1}.q" = {{ column = {i}, unit = "rad" }}\n' for i in range(7))
         + '[labels]\nstage = "{folder}"\nfixture = "{file}"\n')


@pytest.fixture
def table(tmp_path):
    def write(content, name="poses.csv"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path
    return write


def measured(folder):
    files = sorted((DATA / folder).rglob("*.csv"))
    if not files:
        pytest.skip(f"measured data absent: {DATA / folder}")
    return files


def the_same(a, b):
    for name in ("stage", "fixture", "pose", "t"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert list(a.channels) == list(b.channels)
    assert dict(a.units) == dict(b.units)
    for name, x in a.channels.items():
        np.testing.assert_array_equal(b.channels[name], x)


def test_units_become_si_labels_stay_text_and_empty_cells_are_not_read(table):
    path = table("\ufeff" + GOOD)
    poses = read_poses(path)
    assert (len(poses), poses.name) == (3, "poses")
    assert list(poses.stage) == ["front", "front", ""]
    assert list(poses.fixture) == ["A", "B, left", ""]
    assert list(poses.pose) == ["1", "2", "7b"]
    np.testing.assert_array_equal(poses.t, [0.5, 1.5, np.nan])
    np.testing.assert_allclose(poses.channels["boom.q"], [np.pi / 6, np.nan, np.pi / 2])
    np.testing.assert_allclose(poses.channels["boom_cylinder.length"], [1.5, 1.6, np.nan])
    np.testing.assert_allclose(poses.channels["tip.x"], [2.5, np.nan, np.nan])
    np.testing.assert_allclose(poses.channels["stick.distance"], [np.nan, 2.5, 3])
    assert poses.units == {"boom.q": "rad", "boom_cylinder.length": "m", "tip.x": "m", "stick.distance": "m"}
    assert list(poses.row) == [1, 2, 3]
    assert set(poses.file) == {str(path)}
    assert poses.sha256 == {str(path): hashlib.sha256(path.read_bytes()).hexdigest()}
    for array in (poses.t, poses.stage, poses.pose, poses.row, poses.file, *poses.channels.values()):
        assert not array.flags.writeable


def test_labels_and_time_may_be_absent_and_one_row_is_enough(table):
    poses = read_poses(table("slide.q [mm],pose\n5,\n"))
    assert (poses.stage[0], poses.fixture[0], poses.pose[0]) == ("", "", "1")
    assert np.isnan(poses.t[0])
    assert poses.units == {"slide.q": "m"}


def test_labels_that_look_like_numbers_or_nothing_stay_as_they_are(table):
    poses = read_poses(table("stage,fixture,pose,a.q [rad]\nNA, 1.0 ,007,1\nnan,1e3,8,2\n"))
    assert list(poses.stage) == ["NA", "nan"]
    assert list(poses.fixture) == ["1.0", "1e3"]
    assert list(poses.pose) == ["007", "8"]


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_written_poses_read_back_exactly(table, tmp_path, suffix):
    poses = read_poses(table(GOOD.replace("front", '"a ""good"" one"')))
    assert poses.stage[0] == 'a "good" one'
    poses.write(tmp_path / f"copy.{suffix}")
    the_same(poses, read_poses(tmp_path / f"copy.{suffix}"))
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(["poses.csv", f"copy.{suffix}"])


def test_what_was_not_read_is_written_as_an_empty_cell(tmp_path):
    Poses("made", channels={"a.q": [1.5, np.nan], "tip.z": [np.nan, 2]}).write(tmp_path / "made.csv")
    assert (tmp_path / "made.csv").read_text() == (
        'stage,fixture,pose,a.q [rad],tip.z [m]\n"","","1",1.5,\n"","","2",,2\n')


@pytest.mark.parametrize(("name", "pattern"), [("poses.txt", "not a kind of table of poses"),
                                               ("none/poses.csv", "cannot be written")])
def test_what_cannot_be_written_leaves_nothing(tmp_path, name, pattern):
    with pytest.raises(LogError, match=pattern):
        Poses("made", channels={"a.q": [1.0]}).write(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_parquet_columns_of_any_kind_become_labels(tmp_path):
    pq.write_table(pa.table({
        "stage": pa.array(["a", None, "b"]).dictionary_encode(), "fixture": [1, 2, 3], "pose": [1.0, None, 3.0],
        "a.q [deg]": pa.array([180.0, None, 90.0])}), tmp_path / "poses.parquet")
    poses = read_poses(tmp_path / "poses.parquet")
    assert list(poses.stage) == ["a", "", "b"]
    assert list(poses.fixture) == ["1", "2", "3"]
    assert list(poses.pose) == ["1", "2", "3"]
    np.testing.assert_allclose(poses.channels["a.q"], [np.pi, np.nan, np.pi / 2])


@pytest.mark.parametrize("which", [np.array([False, True, True]), [1, 2], [False, True, True]])
def test_a_selection_keeps_what_belongs_to_its_rows(table, which):
    chosen = read_poses(table(GOOD)).select(which)
    assert list(chosen.pose) == ["2", "7b"]
    assert list(chosen.row) == [2, 3]
    np.testing.assert_allclose(chosen.channels["stick.distance"], [2.5, 3])
    assert len(chosen.sha256) == 1


def test_an_empty_selection_has_no_rows_and_no_file(table):
    nothing = read_poses(table(GOOD)).select([])
    assert len(nothing) == 0
    assert nothing.sha256 == {}
    assert nothing.channels["tip.x"].shape == nothing.stage.shape == (0,)


def test_joined_tables_lack_what_one_of_them_lacks(table):
    first, second = table(GOOD), table("a.q [deg],tip.x [mm]\n180,1\n90,2\n", "more.csv")
    both = read_pose_files([first, second])
    assert (len(both), both.name) == (5, "poses and 1 more")
    np.testing.assert_allclose(both.channels["tip.x"], [2.5, np.nan, np.nan, 0.001, 0.002])
    np.testing.assert_allclose(both.channels["a.q"], [np.nan, np.nan, np.nan, np.pi, np.pi / 2])
    assert list(both.row) == [1, 2, 3, 1, 2]
    assert list(both.file[2:4]) == [str(first), str(second)]
    assert list(both.sha256) == [str(first), str(second)]
    the_same(both.select(both.file == str(first)).select([0]), joined([read_poses(first).select([0]), both.select([])]))


def test_what_cannot_be_joined_is_refused(table):
    turn, slide = table("a.q [deg]\n1\n", "turn.csv"), table("a.q [mm]\n1\n", "slide.csv")
    with pytest.raises(LogError, match=r"slide\.csv: channel 'a.q' is in 'm' here and in 'rad' .*; .*one kind"):
        read_pose_files([turn, slide])
    with pytest.raises(LogError, match=r"turn\.csv: this file is named twice"):
        read_pose_files([turn, turn.parent / "." / "turn.csv"])
    with pytest.raises(LogError, match="at least one"):
        read_pose_files([])


def edited(old, new):
    assert GOOD.count(old) == 1, old
    return GOOD.replace(old, new)


BROKEN = {
    "text for a number": (edited("1600", "about 1.6"), ", data row 2, column 6 'boom_cylinder.length .*': 'about 1.6'"),
    "infinite": (edited("1600", "-inf"), r", data row 2: 'boom_cylinder.length' is infinite; .*empty"),
    "infinite time": (edited("1.5", "inf"), ", data row 2: 't' is infinite"),
    "beyond all measure": (edited("1600", "1e200"), r"data row 2 .*beyond 1e\+08 m|data row 2 .*beyond"),
    "too few cells": (edited(",2.5,", ",2.5"), r": data row 1 is damaged .*7 of 8 columns.*; .*correct the file"),
    "too many cells": (edited("2,1.5", "2,,1.5"), "data row 2 .*9 of 8 columns"),
    "every row cut": ("a.q [deg],b.q [deg]\n1\n2\n", "data rows 1–2 are damaged .*1 of 2 columns"),
    "open quotation mark": (edited('"B, left"', '"B left'), "data row 2 .*quotation mark"),
    "no channel": ("stage,t [s]\na,1\n", r": there is no channel; .*'boom.q \[deg\]'"),
    "unknown suffix": (edited("tip.x", "tip.w"), r", column 7 'tip.w .*is not a channel; .*\.length"),
    "no unit": (edited("tip.x [m]", "tip.x"), r", column 7 .*no unit; .*'tip.x \[m\]'"),
    "unit of another kind": (edited("tip.x [m]", "tip.x [deg]"), ", column 7 .*'deg' does not suit"),
    "label with unit": (edited("pose,", "pose [1],"), r", column 3 .*; .*'pose'"),
    "channel twice": (edited("tip.x [m]", "boom.q [rad]"), ", column 7 .*channel 'boom.q' occurs twice"),
    "label twice": (edited("pose,", "stage,"), ", column 3 .*label 'stage' occurs twice"),
    "misspelt label": (edited("fixture,", "fixtures,"), ", column 2 'fixtures': .*; .*fixture"),
    "header only": (HEADER + "\n", "no data"),
    "empty": ("", "empty"),
    "blank": ("\n \n", "empty"),
    "binary": (bytes(range(256)) * 20, "binary"),
}


def refused(pattern, path, **more):
    with pytest.raises(LogError, match=pattern) as caught:
        read_poses(path, **more)
    assert "\n" not in str(caught.value)
    assert caught.value.remedy


@pytest.mark.parametrize("case", BROKEN)
def test_damaged_tables_are_refused_in_one_sentence(table, case):
    content, place = BROKEN[case]
    refused(rf"poses\.csv.*{place}", table(content))


@pytest.mark.parametrize(("name", "pattern"), [
    ("none.csv", "no such file"), (".", "not a file"), ("poses.docx", "not a kind"),
    ("poses.xlsx", "not a readable spreadsheet"),
    ("poses.parquet", "not a readable Parquet"), ("poses.mat", "no columns of text; .*csv")])
def test_wrong_files(table, tmp_path, name, pattern):
    if name.startswith("poses"):
        table(GOOD, name)
    refused(pattern, tmp_path / name)


def test_parquet_columns_that_are_no_labels_or_numbers(tmp_path):
    for column, pattern in (("stage", "'stage' cannot be read as text; .*strings"), ("b.q [rad]", "not numbers")):
        pq.write_table(pa.table({column: [[1.0], [2.0]], "a.q [deg]": [1.0, 2.0]}), tmp_path / "poses.parquet")
        refused(pattern, tmp_path / "poses.parquet")


A_Q = '[columns]\n"a.q" = { column = "a", unit = "deg" }\n'


def test_a_map_takes_labels_from_columns_texts_and_paths(table, tmp_path):
    layout = table(A_Q + '[labels]\nstage = "day {file} of {folder}"\nfixture = { column = "socket" }\npose = "x"\n',
                   "map.toml")
    poses = read_poses(table("socket,a,noise\nleft,180,?\nright,,?\n"), mapping=layout)
    assert list(poses.stage) == [f"day poses of {tmp_path.name}"] * 2
    assert list(poses.fixture) == ["left", "right"]
    assert list(poses.pose) == ["x", "x"]
    np.testing.assert_allclose(poses.channels["a.q"], [np.pi, np.nan])


def test_a_column_may_be_both_label_and_channel_and_rows_may_be_chosen(table):
    layout = LogMap.model_validate({"header": False, "delimiter": "whitespace", "rows": [2, 3], "labels": {
        "pose": {"column": 0}}, "columns": {"a.q": {"column": 0, "unit": "rad"}}})
    poses = read_poses(table("garbage\n1   2\n 3 4\n5 6 7"), mapping=layout)
    assert list(poses.pose) == ["1", "3"]
    assert list(poses.row) == [2, 3]
    np.testing.assert_array_equal(poses.channels["a.q"], [1, 3])


BAD_MAPS = {
    "unknown label": ('station = "a"', r"map\.toml: labels\.station: .*unknown; use one of stage, fixture, pose"),
    "unknown brace": ('stage = "{parent}"', r"map\.toml: labels\.stage: '\{parent\}' .*\{folder\} and \{file\}"),
    "open brace": ('stage = "{folder"', r"map\.toml: labels\.stage: .*braces"),
    "a number": ("stage = 3", r"map\.toml: labels\.stage: a label is a text or \{ column"),
    "another key": ("stage = { colum = 1 }", r"map\.toml: labels\.stage: a label is a text"),
    "absent column": ('stage = { column = "b" }', r"poses\.csv: there is no column 'b' \(.*a, c\)"),
    "variable": ('stage = { variable = "b" }', r"map\.toml: labels\.stage: a label is a text"),
}


@pytest.mark.parametrize("case", BAD_MAPS)
def test_bad_labels_are_refused(table, case):
    line, pattern = BAD_MAPS[case]
    refused(pattern, table("a,c\n1,2\n"), mapping=table(f"{A_Q}[labels]\n{line}\n", "map.toml"))


def test_labels_that_are_no_table_are_refused(table):
    refused(r"map\.toml: labels: this is not a table", table("a\n1\n"), mapping=table("labels = 3\n" + A_Q, "map.toml"))


def test_a_map_of_nothing_but_time_has_no_channel(table):
    layout = table('[columns]\nt = { column = "a", unit = "s" }\n', "map.toml")
    refused(r"poses\.csv: there is no channel", table("a\n1\n"), mapping=layout)


def test_logs_refuse_maps_with_labels_and_still_need_time(table):
    labelled = table(A_Q + 't = { column = "t", unit = "s" }\n[labels]\nstage = "x"\n', "map.toml")
    timeless = table(A_Q, "timeless.toml")
    path = table("t,a\n0,1\n1,2\n")
    for layout, place, pattern in ((labelled, "map", "labels belong to tables of poses.*; remove"),
                                   (timeless, r"poses\.csv", "'t' is missing")):
        with pytest.raises(LogError, match=rf"{place}.*: .*{pattern}"):
            read_log(path, mapping=layout)
        with pytest.raises(LogError, match=rf"poses\.csv: .*{pattern}"):
            read_log(path, mapping=read_map(layout, poses=True))
        assert len(read_poses(path, mapping=layout)) == 2


def test_poses_made_in_memory_are_checked():
    for more in ({"channels": {}}, {"channels": {"a": [1.0]}}, {"channels": {"a.q": [1.0], "b.q": [1.0, 2.0]}},
                 {"channels": {"a.q": [1.0]}, "stage": ["x", "y"]}, {"channels": {"a.q": [np.inf]}},
                 {"channels": {"a.q": [[1.0]]}}):
        with pytest.raises(HydrooptError):
            Poses("made", **more)


def test_the_panda_poses_read_with_a_map(table):
    files = measured("mukca_panda_2/panda_2")
    poses = read_pose_files(files, mapping=table(PANDA, "map.toml"))
    assert (len(files), len(poses), len(poses.sha256)) == (18, 559, 18)
    assert {"high", "mid-high", "front_left"} < set(poses.stage)
    assert len(set(poses.stage)) == 9
    assert set(poses.fixture) == {"hole_0", "hole_1"}
    assert list(poses.channels) == [f"panda_joint{i}.q" for i in range(1, 8)]
    assert all(np.all(np.abs(x) < 3.8) for x in poses.channels.values())
    first = poses.select((poses.stage == "back_left") & (poses.fixture == "hole_0"))
    assert list(first.pose) == [str(i) for i in range(1, 32)]
    assert first.channels["panda_joint7.q"][0] == 0.8851449913528783853


def test_the_talos_postures_read_with_a_map():
    (path,) = measured("talos_left_arm/data")
    joints = path.read_text().splitlines()[0].split(",")[4:]
    layout = LogMap.model_validate({"columns": {
        "t": {"column": "t", "unit": "s"}, **{f"tip.{i}": {"column": f"{i}1", "unit": "m"} for i in "xyz"},
        **{f"{name}.q": {"column": name, "unit": "rad"} for name in joints}}, "labels": {"fixture": "mocap"}})
    poses = read_poses(path, mapping=layout)
    assert len(poses) == 61
    assert len(poses.channels) == 12
    assert poses.units["tip.z"] == "m"
    assert (poses.channels["tip.x"][0], poses.t[0]) == (0.115424597820405, 42.3991174697876)
    assert set(poses.fixture) == {"mocap"}


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_where_tapes_end_survives_writing_joining_and_selecting(tmp_path: Path, suffix: str) -> None:
    poses = Poses("taped", stage=["a", "a"], fixture=["one", ""], tape=["two", "one"],
                  channels={"stick.distance": np.array([1.0, 2.0])})
    poses.write(tmp_path / f"taped{suffix}")
    again = read_poses(tmp_path / f"taped{suffix}")
    assert (again.tape.tolist(), again.fixture.tolist()) == (["two", "one"], ["one", ""])
    assert joined([again, Poses("other", channels={"stick.distance": np.ones(1)})]).tape.tolist() == ["two", "one", ""]
    assert again.select([1]).tape.tolist() == ["one"]
    assert "tape" not in Poses("none", channels={"stick.distance": np.ones(1)}).to_frame().columns
