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
from collections.abc import Iterator, Mapping, Sequence
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
EVERY = 5
"""Samples of the log of which a bag has one."""
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
    """Whether a spelling is proposed for its channels, and whether one of its columns is wrong."""
    machine, columns = _log("excavator_imu" if spelling.quantity in ("gyro", "acceleration") else "cat215b")
    own = [channel for channel in columns if channel.rpartition(".")[2] in SUFFIXES[spelling.quantity] and not (
        channel == "swing.q" and any(word in spelling.header.lower() for word in INCLINED))]
    scale, unit = SCALES[spelling.unit.removeprefix("none-")]
    headers = {spelling.of(channel): channel for channel in own}
    found = _map(columns, {channel: (header, scale) for header, channel in headers.items()}, machine, folder)
    held = {each.column.header: each for each in found.proposals if each.sureness != "guess"}
    right = {header: header in held and (held[header].channel, _same(held[header].unit, unit)) == (channel, True)
             for header, channel in headers.items()}
    return all(right.values()), any(header in held and not right[header] for header in headers)


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
    """A bag with signals of a kind ("pressure", "imu", "joints"), its machine, and topic and column of each channel.

    Args:
        storage: one of `STORAGES`; `topic`: its name, with holes where there are several.
    """
    machine, columns = _log("excavator_imu" if kind == "imu" else "cat215b")
    ros1 = storage == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    path = folder / (f"{storage}.bag" if ros1 else storage)
    writer = rosbag1.Writer(path) if ros1 else rosbag2.Writer(
        path, version=9, storage_plugin=rosbag2.StoragePlugin[storage])
    expected: dict[str, str] = {}
    with writer:
        for group in _groups(kind, topic, columns):
            called = Spelling(kind, "", topic, 0).of(group[0])
            expected |= {channel: f"{called} {_field(channel)}" for channel in group}
            connection = None
            for k in range(0, columns["t"].size, EVERY):
                values = {channel: columns[channel][k] for channel in group}
                message = _message(store.types, group, values, k, ros1=ros1)
                connection = connection or writer.add_connection(called, message.__msgtype__, typestore=store)
                data = (store.serialize_ros1 if ros1 else store.serialize_cdr)(message, message.__msgtype__)
                writer.write(connection, 1_790_000_000 * 10**9 + k * 20_000_000 + 3_000_000, data)
    return path, machine, expected


def _groups(kind: str, topic: str, columns: Mapping[str, NDArray[Any]]) -> list[list[str]]:
    """The channels of each topic: a chamber's pressure, an IMU's six, all joints or one."""
    if kind == "imu":
        names = dict.fromkeys(channel.rpartition(".")[0] for channel in columns if channel.endswith(".gyro_x"))
        return [[f"{name}.{quantity}_{axis}" for quantity in ("gyro", "accel") for axis in "xyz"] for name in names]
    own = [channel for channel in columns if channel.endswith((".p_head", ".p_rod") if kind == "pressure" else ".q")]
    if "{" not in topic:
        return [own[:1] if kind == "pressure" else own]
    return [[channel] for channel in own]


def _field(channel: str) -> str:
    """The column of a channel in its message."""
    name, _, suffix = channel.rpartition(".")
    if suffix == "q":
        return f"position[{name}]"
    quantity, _, axis = suffix.partition("_")
    return {"gyro": f"angular_velocity.{axis}", "accel": f"linear_acceleration.{axis}"}.get(quantity, "fluid_pressure")


def _message(types: Mapping[str, Any], group: Sequence[str], values: Mapping[str, float], k: int, *, ros1: bool) -> Any:
    """Sample k of a group of channels as a message."""
    stamp = types["builtin_interfaces/msg/Time"](sec=1_790_000_000 + k // 50, nanosec=k % 50 * 20_000_000)
    header = types["std_msgs/msg/Header"](**({"seq": k} if ros1 else {}), stamp=stamp, frame_id="")
    if group[0].endswith(".q"):
        return types["sensor_msgs/msg/JointState"](header, [channel.removesuffix(".q") for channel in group],
                                                   np.array([*values.values()]), np.zeros(0), np.zeros(0))
    if len(group) == 1:
        return types["sensor_msgs/msg/FluidPressure"](header, values[group[0]], 0.0)
    rate, a = (types["geometry_msgs/msg/Vector3"](*[values[channel] for channel in part])
               for part in (group[:3], group[3:]))
    still = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    return types["sensor_msgs/msg/Imu"](header, still, np.zeros(9), rate, np.zeros(9), a, np.zeros(9))


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
                        f"spellings_{quantity}_wrong": sum(wrong for _, wrong in found.values())}
        signals = np.zeros(3, int)
        for storage in STORAGES:
            for kind, topics in _lists()["topics"].items():
                for topic in topics:
                    with TemporaryDirectory() as fresh:
                        signals += sure_signals(Path(fresh), kind, storage, topic)
        figures |= {f"spellings_ros_signals_{what}": int(count)
                    for what, count in zip(("tried", "sure", "wrong"), signals, strict=True)}
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
