"""One log of a crane with one cylinder, in every format that is read."""

import datetime
import gzip
import json
import zipfile

import h5py
import numpy as np
from asammdf import MDF, Signal
from mcap.writer import Writer as McapWriter
from nptdms import ChannelObject, TdmsWriter
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

from hydroopt.logs.column_map import LogMap
from hydroopt.logs.log import Log
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory, simulate

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
    savemat(folder / "run.mat", {name.replace(".", "_"): x[:, None] for name, x in {"t": T, **CHANNELS}.items()})
    return folder / "run.mat", variables()


def variables():
    return LogMap.model_validate({"columns": {"t": {"variable": "t", "unit": "s"}} | {
        name: {"variable": name.replace(".", "_"), "unit": unit} for name, unit in UNITS.items()}})


def mat73(folder):
    with h5py.File(folder / "run.mat", "w", userblock_size=512) as file:
        for name, x in {"t": T, **CHANNELS}.items():
            file[name.replace(".", "_")] = x[None, :]
    with (folder / "run.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(512))
    return folder / "run.mat", variables()


def hdf5(folder):
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
    with TdmsWriter(str(folder / "run.tdms")) as file:
        file.write_segment([ChannelObject("log", name, x, properties={
            "unit_string": UNITS[name], "wf_increment": 0.02, "wf_start_time": START}) for name, x in CHANNELS.items()])
    return folder / "run.tdms", None


def mdf(folder):
    with MDF(version="4.10") as file:
        file.start_time = datetime.datetime(2026, 11, 23, 4, 20, tzinfo=datetime.UTC)
        file.append([Signal(samples=x, timestamps=T, name=name, unit=UNITS[name]) for name, x in CHANNELS.items()])
        file.save(folder / "run.mf4", overwrite=True)
    return folder / "run.mf4", None


def ros2(plugin):
    def write(folder):
        with rosbag2.Writer(folder / "run", version=9, storage_plugin=rosbag2.StoragePlugin[plugin]) as bag:
            _fill(bag, ros1=False)
        return folder / "run", bag_map()
    return write


def ros1(folder):
    with rosbag1.Writer(folder / "run.bag") as bag:
        _fill(bag, ros1=True)
    return folder / "run.bag", bag_map()


def bag_map():
    return LogMap.model_validate({"columns": {
        name: {"column": column, "unit": UNITS[name]} for name, column in zip(CHANNELS, (
            "position[lift]", "effort[lift]", "effort[cylinder]", "position[cylinder]"), strict=True)}})


def _fill(bag, *, ros1):
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
    with (folder / "run.mcap").open("wb") as file:
        writer = McapWriter(file)
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
