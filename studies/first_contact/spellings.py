"""Spellings of columns as loggers write them: which are proposed for their channel, and whether any is wrong.

Each spelling of `spellings.toml` names all columns of one quantity of a simulated log (CAT 215B; for IMUs an excavator
with four of them), in a CSV of its own, the other columns under their channels' names. A spelling counts as proposed if
each of its columns is sure or likely, for its own channel in its own unit; as wrong if one is sure or likely for
another channel or unit. One in three spellings is held out: no rule was written for it. Headers of other quantities
("traps") carry an angle's or a pressure's values and must not be proposed. The signals of ROS stand in bags of versions
1 and 2 and in MCAP files: JointState, FluidPressure with a topic for each chamber, and Imu; they must be sure.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

from hydroopt.logs.map_proposal import MapProposal, propose_map
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory, simulate
from hydroopt.units import factor

PARTS = {"swing": ("slew", "Drehwerk"), "boom": ("boom", "Ausleger"), "stick": ("arm", "Stiel"),
         "bucket": ("bucket", "Löffel")}
"""What else people call a part, and in German."""
CHAMBERS = {"head": ("extend", "Kolbenseite"), "rod": ("retract", "Stangenseite")}
SCALES = {"deg": (180 / np.pi, "deg"), "rad": (1.0, "rad"), "deg_s": (180 / np.pi, "deg/s"), "rad_s": (1.0, "rad/s"),
          "bar": (1e-5, "bar"), "kPa": (1e-3, "kPa"), "MPa": (1e-6, "MPa"), "psi": (1 / 6894.757293168, "psi"),
          "mbar": (1e-2, "mbar"), "Pa": (1.0, "Pa"), "kgf_cm2": (1 / 98066.5, "kgf/cm^2"), "mm": (1e3, "mm"),
          "m": (1.0, "m"), "cm": (1e2, "cm"), "inch": (1 / 0.0254, "inch"), "dps": (180 / np.pi, "deg/s"),
          "mdps": (180e3 / np.pi, "mdeg/s"), "g": (1 / 9.80665, "g_0"), "mg": (1e3 / 9.80665, "mg_0"),
          "m_s2": (1.0, "m/s^2")}
"""Number in a unit of an SI number, and how a map may state that unit."""
INCLINED = ("pitch", "tilt", "incl", "neigung")
"""Words of spellings that no swing has, whose axis is upright."""
STORAGES = ("ros1", "SQLITE3", "MCAP")
SUFFIXES = {"angle": ("q",), "velocity": ("qd",), "pressure": ("p_head", "p_rod"), "length": ("length",),
            "gyro": ("gyro_x", "gyro_y", "gyro_z"), "acceleration": ("accel_x", "accel_y", "accel_z")}


class Spelling(NamedTuple):
    """A header with holes, of a quantity in a unit; `number` within the list of its quantity and unit."""

    quantity: str
    unit: str
    header: str
    number: int

    @property
    def held_out(self) -> bool:
        """Whether no rule was written for it."""
        return self.number % 3 == 2

    def of(self, channel: str) -> str:
        """The header of a channel."""
        name, _, suffix = channel.rpartition(".")
        part = name.rpartition("_")[0] or name
        end = suffix.rpartition("_")[2]
        other, german = PARTS[part]
        extends, chamber = CHAMBERS.get(end, ("", ""))
        return self.header.format(p=part, P=part.title(), U=part.upper(), s=other, D=german, d=german.lower(), c=end,
                                  C=end.title(), E=end.upper(), e=extends, K=chamber, a=end, A=end.upper())


def spellings() -> list[Spelling]:
    """All spellings of the list."""
    lists = _lists()
    return [Spelling(quantity, unit, header, number) for quantity in SUFFIXES
            for unit, headers in lists[quantity].items() for number, header in enumerate(headers)]


def proposed(spelling: Spelling, folder: Path) -> tuple[bool, bool]:
    """Whether a spelling is proposed for its channels, and whether one of its columns is wrong and sure."""
    machine, columns = _log("excavator_imu" if spelling.quantity in ("gyro", "acceleration") else "cat215b")
    own = [channel for channel in columns if channel.rpartition(".")[2] in SUFFIXES[spelling.quantity] and not (
        channel == "swing.q" and any(word in spelling.header.lower() for word in INCLINED))]
    scale, unit = SCALES[spelling.unit.removeprefix("none-")]
    headers = {spelling.of(channel): channel for channel in own}
    found = _map(columns, {channel: (header, scale) for header, channel in headers.items()}, machine, folder)
    held = {each.column.header: each for each in found.proposals if each.sureness != "guess"}
    right = {header: header in held and (held[header].channel, _same(held[header].unit, unit)) == (channel, True)
             for header, channel in headers.items()}
    return all(right.values()), any(header in held and held[header].sureness == "sure" and not right[header]
                                    for header in headers)


def trapped(folder: Path) -> list[str]:
    """Headers of other quantities that are sure or likely, with an angle's and with a pressure's values."""
    machine, columns = _log("cat215b")
    found = []
    for header in _lists()["traps"]["headers"]:
        for channel, scale in (("boom.q", 180 / np.pi), ("boom_cylinder.p_head", 1e-5)):
            made = _map(columns, {channel: (header, scale)}, machine, folder)
            found += [header for each in made.proposals if each.column.header == header and each.sureness != "guess"]
    return found


def bag(folder: Path, kind: str, storage: str, topic: str) -> tuple[Path, Machine, dict[str, str]]:
    """A bag with one kind of signals ("pressure", "imu", "joints"), and the channel of each column with its topic.

    Args:
        storage: "ros1", "SQLITE3" or "MCAP" of ROS 2; `topic`: its name with holes.
    """
    machine, columns = _log("excavator_imu" if kind == "imu" else "cat215b")
    ros1 = storage == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    types = {name.rpartition("/")[2]: made for name, made in store.types.items()
             if name.startswith(("sensor_msgs/", "geometry_msgs/", "std_msgs/msg/Header", "builtin_interfaces/"))}
    path = folder / (f"{storage}.bag" if ros1 else storage)
    writer = rosbag1.Writer(path) if ros1 else rosbag2.Writer(
        path, version=9, storage_plugin=rosbag2.StoragePlugin[storage])
    ends = {"pressure": ("p_head", "p_rod"), "imu": ("gyro_x",), "joints": ("q",)}[kind]
    own = [channel for channel in columns if channel.rpartition(".")[2] in ends]
    expected: dict[str, str] = {}

    def messages(channel: str) -> Iterator[tuple[str, Any]]:
        name = channel.rpartition(".")[0]
        for k in range(0, columns["t"].size, 5):
            stamp = types["Time"](sec=1_790_000_000 + k // 50, nanosec=k % 50 * 20_000_000)
            header = types["Header"](**({"seq": k} if ros1 else {}), stamp=stamp, frame_id=name)
            if kind == "pressure":
                yield "FluidPressure", types["FluidPressure"](header, columns[channel][k], 0.0)
            elif kind == "joints":
                some = own if "{" not in topic else [channel]
                yield "JointState", types["JointState"](
                    header, [each.removesuffix(".q") for each in some], np.array([columns[each][k] for each in some]),
                    np.zeros(0), np.zeros(0))
            else:
                rate, a = ([columns[f"{name}.{quantity}_{axis}"][k] for axis in "xyz"] for quantity in ("gyro", "accel"))
                yield "Imu", types["Imu"](header, types["Quaternion"](0.0, 0.0, 0.0, 1.0), np.zeros(9), types["Vector3"](
                    *rate), np.zeros(9), types["Vector3"](*a), np.zeros(9))

    with writer:
        for channel in own if "{" in topic else own[:1]:
            called = Spelling(kind, "", topic, 0).of(channel)
            for k, (name, message) in enumerate(messages(channel)):
                if not k:
                    connection = writer.add_connection(called, message.__msgtype__, typestore=store)
                data = (store.serialize_ros1 if ros1 else store.serialize_cdr)(message, message.__msgtype__)
                writer.write(connection, 1_790_000_000 * 10**9 + k * 10**8 + 3_000_000, data)
            if kind == "imu":
                part = channel.rpartition(".")[0]
                expected |= {f"{part}.{quantity}_{axis}": f"{called} {field}.{axis}" for axis in "xyz" for quantity, field
                             in (("gyro", "angular_velocity"), ("accel", "linear_acceleration"))}
            elif kind == "joints":
                expected |= {each: f"{called} position[{each.removesuffix('.q')}]"
                             for each in (own if "{" not in topic else [channel])}
            else:
                expected[channel] = f"{called} fluid_pressure"
    return path, machine, expected


def sure_signals(folder: Path, kind: str, storage: str, topic: str) -> tuple[int, int, int]:
    """How many signals of a bag there are, how many are sure, and how many are proposed as another channel."""
    path, machine, expected = bag(folder, kind, storage, topic)
    found = {each.channel: each for each in propose_map(path, machine).proposals if each.channel != "t"}
    right = [channel for channel, column in expected.items() if channel in found and found[channel].sureness == "sure"
             and f"{found[channel].column.sheet.title} {found[channel].column.header}".startswith(column)]
    others = [channel for channel, each in found.items() if each.sureness != "guess" and channel not in expected]
    return len(expected), len(right), len(others)


def run() -> dict[str, float]:
    """Spellings tried, proposed, wrong; the same of those held out; traps; signals of ROS."""
    figures: dict[str, float] = {}
    with TemporaryDirectory() as directory:
        folder = Path(directory)
        for quantity in SUFFIXES:
            some = [each for each in spellings() if each.quantity == quantity]
            found = {each: proposed(each, folder) for each in some}
            held = [each for each in some if each.held_out]
            figures |= {f"spellings_{quantity}_tried": len(some),
                        f"spellings_{quantity}_share": sum(right for right, _ in found.values()) / len(some),
                        f"spellings_{quantity}_held_out_share": sum(found[each][0] for each in held) / len(held),
                        f"spellings_{quantity}_wrong_and_sure": sum(wrong for _, wrong in found.values())}
        signals = np.zeros(3, int)
        for storage in STORAGES:
            for kind, topics in _lists()["topics"].items():
                for topic in topics:
                    with TemporaryDirectory() as fresh:
                        signals += sure_signals(Path(fresh), kind, storage, topic)
        figures |= dict(zip(("spellings_ros_signals_tried", "spellings_ros_signals_sure", "spellings_ros_signals_wrong"),
                            map(int, signals), strict=True))
        figures["spellings_traps_tried"] = len(_lists()["traps"]["headers"])
        figures["spellings_traps_proposed"] = len(trapped(folder))
    return figures


@cache
def _lists() -> dict[str, dict[str, list[str]]]:
    return tomllib.loads(Path(__file__).with_name("spellings.toml").read_text("utf-8"))


@cache
def _log(name: str) -> tuple[Machine, dict[str, NDArray[Any]]]:
    """A machine, and the columns in SI of a log simulated for it, with rates of its joints."""
    machine = load_machine(name)
    model = Model(machine)
    log = simulate(model, random_trajectory(model, duration=10, rate=50, seed=1), seed=1)
    rates = {channel + "d": np.gradient(values, log.t) for channel, values in log.channels.items()
             if channel.endswith(".q")}
    return machine, {"t": log.t, **log.channels, **rates}


def _map(columns: Mapping[str, NDArray[Any]], renamed: Mapping[str, tuple[str, float]], machine: Machine,
         folder: Path) -> MapProposal:
    """The proposal for a CSV with some columns under another name, the others under their own."""
    def named() -> Iterator[tuple[str, NDArray[Any]]]:
        for channel, values in columns.items():
            header, scale = renamed.get(channel, ("", 1.0))
            if header or not channel.endswith(".qd"):
                si = machine.channel_units.get(channel, "s")
                yield header or f"{channel} [{si}]", scale * values

    pd.DataFrame(dict(named())).to_csv(folder / "log.csv", index=False, sep=";")
    return propose_map(folder / "log.csv", machine)


def _same(one: str, other: str) -> bool:
    return bool(np.isclose(factor(one, other), 1.0))
