"""One log in every format: the numbers are the same to the last bit, and damaged files end in a sentence."""

import datetime
import gzip
import shutil
import zipfile

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from fixtures.tiers import tiered
from hydroopt.errors import LogError
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.logs.column_map import LogMap
from hydroopt.logs.log import Log
from hydroopt.logs.log_files import read_log, read_recording
from hydroopt.logs.poses import read_poses
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory, simulate
from hydroopt.solving import solve

MODEL = Model(load_machine("patu655_lift"))
MADE = simulate(MODEL, random_trajectory(MODEL, duration=4, rate=50, seed=1), seed=1)
T, CHANNELS, UNITS, N = MADE.t, dict(MADE.channels), dict(MADE.units), MADE.size
START = np.datetime64("2026-11-23T04:20:00", "ns")
NAMED = {f"{name} [{unit}]": CHANNELS[name] for name, unit in UNITS.items()}


def mapped(prefix="", **more):
    """A map of columns that are named as the channels are."""
    return LogMap.model_validate({**more, "columns": {
        name: {"column": f"{prefix}{name}", "unit": unit} for name, unit in UNITS.items()}})


def csv(folder):
    Log("run", T, CHANNELS).write(folder / "run.csv")
    return folder / "run.csv", None


def packed(folder):
    path, _ = csv(folder)
    (folder / "run.csv.gz").write_bytes(gzip.compress(path.read_bytes()))
    return folder / "run.csv.gz", None


def german(folder):
    path, _ = csv(folder)
    text = path.read_text().replace(",", ";").replace(".", ",")
    for name in CHANNELS:
        text = text.replace(name.replace(".", ","), name)
    (folder / "run.txt").write_text(text, "utf-16")
    return folder / "run.txt", None


def semicolons(folder):
    path, _ = csv(folder)
    (folder / "run.tsv").write_text("# Excavator 7\n" + path.read_text().replace(",", ";"))
    return folder / "run.tsv", None


def parquet(folder):
    Log("run", T, CHANNELS).write(folder / "run.parquet")
    return folder / "run.parquet", None


def mat(folder):
    from scipy.io import savemat

    savemat(folder / "run.mat", {name.replace(".", "_"): x[:, None] for name, x in {"t": T, **CHANNELS}.items()})
    return folder / "run.mat", variables()


def variables():
    return LogMap.model_validate({"columns": {"t": {"variable": "t", "unit": "s"}} | {
        name: {"variable": name.replace(".", "_"), "unit": unit} for name, unit in UNITS.items()}})


def mat73(folder):
    import h5py

    with h5py.File(folder / "run.mat", "w", userblock_size=512) as file:
        for name, x in {"t": T, **CHANNELS}.items():
            file[name.replace(".", "_")] = x[None, :]
    with (folder / "run.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(512))
    return folder / "run.mat", variables()


def hdf5(folder):
    import h5py

    with h5py.File(folder / "run.h5", "w") as file:
        for name, x in {"t": T, **CHANNELS}.items():
            file[f"log/{name}"] = x
            file[f"log/{name}"].attrs["units"] = UNITS.get(name, "s")
        file["calibration"] = np.eye(3)
    return folder / "run.h5", None


def npz(folder):
    np.savez(folder / "run.npz", **{"t [s]": T, **NAMED})
    return folder / "run.npz", None


def xlsx(folder):
    """A log with a title, and a sheet of notes."""
    return workbook(folder / "run.xlsx", {
        "log": [["Excavator 7"], ["t [s]", *NAMED], *zip(T, *NAMED.values(), strict=True)],
        "notes": [["made today"]]}), None


def workbook(path, sheets):
    """A workbook with numbers of 17 digits, as spreadsheets write them."""
    main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    office = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    package = "http://schemas.openxmlformats.org/package/2006"
    numbers = range(1, len(sheets) + 1)
    relations = "".join(f'<Relationship Id="rId{k}" Type="{office}/worksheet" Target="worksheets/sheet{k}.xml"/>'
                        for k in numbers)
    listed = "".join(f'<sheet name="{name}" sheetId="{k}" r:id="rId{k}"/>'
                     for k, name in zip(numbers, sheets, strict=True))
    parts = {
        "[Content_Types].xml": f'<Types xmlns="{package}/content-types"><Default Extension="xml" '
                               'ContentType="application/xml"/></Types>',
        "_rels/.rels": f'<Relationships xmlns="{package}/relationships"><Relationship Id="rId1" '
                       f'Type="{office}/officeDocument" Target="xl/workbook.xml"/></Relationships>',
        "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{package}/relationships">{relations}</Relationships>',
        "xl/workbook.xml": f'<workbook xmlns="{main}" xmlns:r="{office}"><sheets>{listed}</sheets></workbook>'}
    for k, rows in zip(numbers, sheets.values(), strict=True):
        cells = ("".join(f'<c t="inlineStr"><is><t>{x}</t></is></c>' if isinstance(x, str)
                         else f"<c><v>{float(x)!r}</v></c>" for x in row) for row in rows)
        parts[f"xl/worksheets/sheet{k}.xml"] = (f'<worksheet xmlns="{main}"><sheetData>'
                                                + "".join(f"<row>{row}</row>" for row in cells)
                                                + "</sheetData></worksheet>")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, text in parts.items():
            file.writestr(name, text)
    return path


def tdms(folder):
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(str(folder / "run.tdms")) as file:
        file.write_segment([ChannelObject("log", name, x, properties={
            "unit_string": UNITS[name], "wf_increment": 0.02, "wf_start_time": START}) for name, x in CHANNELS.items()])
    return folder / "run.tdms", None


def mdf(folder):
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        file.start_time = datetime.datetime(2026, 11, 23, 4, 20, tzinfo=datetime.UTC)
        file.append([Signal(samples=x, timestamps=T, name=name, unit=UNITS[name]) for name, x in CHANNELS.items()])
        file.save(folder / "run.mf4", overwrite=True)
    return folder / "run.mf4", None


def ros2(plugin):
    def write(folder):
        from rosbags.rosbag2 import StoragePlugin, Writer

        with Writer(folder / "run", version=9, storage_plugin=StoragePlugin[plugin]) as bag:
            _fill(bag, ros1=False)
        return folder / "run", bag_map()
    return write


def ros1(folder):
    from rosbags.rosbag1 import Writer

    with Writer(folder / "run.bag") as bag:
        _fill(bag, ros1=True)
    return folder / "run.bag", bag_map()


def bag_map():
    return LogMap.model_validate({"columns": {
        name: {"column": column, "unit": UNITS[name]} for name, column in zip(CHANNELS, (
            "position[lift]", "effort[lift]", "effort[cylinder]", "position[cylinder]"), strict=True)}})


def _fill(bag, *, ros1):
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    kinds = {name.rpartition("/")[2]: kind for name, kind in store.types.items() if name in (
        "sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")}
    topic = bag.add_connection("/joint_states", kinds["JointState"].__msgtype__, typestore=store)
    columns = list(CHANNELS.values())
    for k in range(N):
        ns = START.astype(int) + k * 20_000_000
        stamp = kinds["Time"](sec=int(ns // 10**9), nanosec=int(ns % 10**9))
        header = kinds["Header"](**({"seq": k} if ros1 else {}), stamp=stamp, frame_id="")
        q, p = np.array([columns[0][k], columns[3][k]]), np.array([columns[1][k], columns[2][k]])
        message = kinds["JointState"](header=header, name=["lift", "cylinder"], position=q, effort=p,
                                      velocity=np.zeros(0))
        data = (store.serialize_ros1 if ros1 else store.serialize_cdr)(message, kinds["JointState"].__msgtype__)
        bag.write(topic, int(ns) + 3_000_000 + 1_000_000 * (k % 2), data)


def json_mcap(folder):
    import json

    from mcap.writer import Writer

    with (folder / "run.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("Log", "jsonschema", b"{}")
        topic = writer.register_channel("/log", "json", schema)
        for k in range(N):
            ns = int(START.astype(int)) + k * 20_000_000
            writer.add_message(topic, ns, json.dumps({name: float(x[k]) for name, x in CHANNELS.items()}).encode(), ns)
        writer.finish()
    return folder / "run.mcap", mapped()


FORMATS = {"csv": csv, "csv.gz": packed, "semicolons": semicolons,
           "German text": german, "parquet": parquet, "mat": mat, "mat 7.3": mat73,
           "hdf5": hdf5, "npz": npz, "xlsx": xlsx, "tdms": tdms, "mdf": mdf, "ros2 sqlite": ros2("SQLITE3"),
           "ros2 mcap": ros2("MCAP"), "ros1": ros1, "mcap json": json_mcap}
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
