"""ROS 1 bags, ROS 2 bags (SQLite and MCAP) and MCAP files with messages in JSON, without a ROS installation."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from hydroopt.logs.formats.decoders.content import WIDEST, Column, Content

UNITS = {
    "sensor_msgs/msg/JointState": {"position": "rad or m", "velocity": "rad/s or m/s", "effort": "N*m or N"},
    "sensor_msgs/msg/Imu": {"angular_velocity": "rad/s", "linear_acceleration": "m/s^2"},
    "sensor_msgs/msg/FluidPressure": {"fluid_pressure": "Pa"},
    "sensor_msgs/msg/Temperature": {"temperature": "degC"},
    "sensor_msgs/msg/Range": {"range": "m", "min_range": "m", "max_range": "m", "field_of_view": "rad"},
    "sensor_msgs/msg/MagneticField": {"magnetic_field": "T"},
    "sensor_msgs/msg/NavSatFix": {"latitude": "deg", "longitude": "deg", "altitude": "m"},
    "sensor_msgs/msg/BatteryState": {"voltage": "V", "current": "A", "temperature": "degC"},
    "geometry_msgs/msg/Wrench": {"force": "N", "torque": "N*m"},
    "geometry_msgs/msg/Twist": {"linear": "m/s", "angular": "rad/s"},
    "geometry_msgs/msg/Accel": {"linear": "m/s^2", "angular": "rad/s^2"},
    "geometry_msgs/msg/Pose": {"position": "m"}, "geometry_msgs/msg/Transform": {"translation": "m"},
    "geometry_msgs/msg/PointStamped": {"point": "m"},
    "trajectory_msgs/msg/JointTrajectoryPoint": {"positions": "rad or m", "velocities": "rad/s or m/s",
                                                 "accelerations": "rad/s^2 or m/s^2", "effort": "N*m or N"}}
"""Units of the standard messages of ROS by type and field, where several by kind of joint: by their definitions in
common_interfaces, which follow REP 103, https://ros.org/reps/rep-0103.html."""
DEPTH = 6
"""How deep fields are looked for."""
Message = tuple[int, Any]
"""The recorder's stamp [ns], and what was sent."""


def contents(path: Path) -> list[Content]:
    """The topics of a bag whose messages hold numbers, with the stamps of their headers, or else of the recorder."""
    if path.suffix == ".mcap" and (found := _json_topics(path)):
        return found
    reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
    reader.open()
    found = []
    for topic, info in reader.topics.items():
        first = next(_messages(reader, topic), None)
        if first is not None and info.msgcount > 1:
            decoded = cache(lambda topic=topic: list(_messages(reader, topic)))  # once, when first needed
            found.append(_content(topic, str(info.msgtype), decoded, first, int(info.msgcount)))
    return [content for content in found if content.columns]


def _messages(reader: Any, topic: str) -> Iterator[Message]:
    chosen = [each for each in reader.connections if each.topic == topic]
    for connection, stamp, data in reader.messages(connections=chosen):
        yield stamp, reader.deserialize(data, connection.msgtype)


def _content(topic: str, kind: str, messages: Callable[[], Sequence[Message]], first: Message, count: int) -> Content:
    names = _get(first[1], "name")
    columns = [Column(name, unit, partial(_column, messages, path)) for path, name, unit in _numbers(
        first[1], UNITS.get(kind, {}), names if isinstance(names, list) else [])]
    headed = _header_stamp(first[1]) not in (None, 0)
    shown = f"the stamps {'of the headers' if headed else 'of the recorder'} of its messages"

    def stamps() -> NDArray[Any]:
        return np.array([(_header_stamp(message) or 0) if headed else stamp for stamp, message in messages()],
                        dtype="M8[ns]")

    return Content(topic, columns, stamps, shown, rows=count)


def _column(messages: Callable[[], Sequence[Message]], path: Sequence[str | int]) -> NDArray[np.float64]:
    return np.array([_at(message, path) for _, message in messages()])


def _header_stamp(message: Any) -> int | None:
    """The stamp [ns] of a message's header; None where it has none."""
    stamp = _get(_get(message, "header"), "stamp")
    seconds, rest = _get(stamp, "sec"), _get(stamp, "nanosec")
    return None if seconds is None or rest is None else int(seconds) * 10**9 + int(rest)


def _get(item: Any, key: str) -> Any:
    return item.get(key) if isinstance(item, dict) else getattr(item, key, None)


def _fields(item: Any) -> Iterable[str]:
    if isinstance(item, dict):
        return [key for key in item if isinstance(key, str)]
    return [key for key in getattr(item, "__dataclass_fields__", {}) if not key.startswith("_")]


def _numbers(item: Any, units: Mapping[str, str], parts: Sequence[Any], path: tuple[str | int, ...] = (),
             name: str = "", unit: str = "") -> Iterator[tuple[tuple[str | int, ...], str, str]]:
    """Paths, names and units of the numbers in a message, but those of its header.

    Args:
        units: of the fields, by the definition of the message; `parts`: what the elements of its fields are called,
            as ``position[boom]``, if anything.
        path, name, unit: those of the item.
    """
    if isinstance(item, bool | int | float | np.number | np.bool_):
        yield path, name, unit
    elif isinstance(item, np.ndarray | list | tuple):
        for k, each in enumerate(item) if len(item) <= WIDEST and len(path) < DEPTH else ():
            called = parts[k] if len(path) == 1 and k < len(parts) and isinstance(parts[k], str) else k
            yield from _numbers(each, {}, parts, (*path, k), f"{name}[{called}]", unit)
    elif len(path) < DEPTH:
        own = UNITS.get(getattr(item, "__msgtype__", ""), {}) if path else units
        for key in _fields(item):
            if path or key != "header":
                yield from _numbers(_get(item, key), {}, parts, (*path, key), f"{name}.{key}" if name else key,
                                    own.get(key, unit))


def _at(message: Any, path: Sequence[str | int]) -> float:
    """A number of a message, NaN where it is missing."""
    item = message
    for part in path:
        try:
            item = _get(item, part) if isinstance(part, str) else item[part]
        except (IndexError, TypeError, KeyError):
            return float("nan")
    return float(item) if isinstance(item, bool | int | float | np.number | np.bool_) else float("nan")


def _json_topics(path: Path) -> list[Content]:
    """The topics of an MCAP file whose messages are JSON; none where there are others."""
    from mcap.reader import make_reader  # noqa: PLC0415

    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        channels = list(summary.channels.values()) if summary is not None else []
        if not channels or any(channel.message_encoding != "json" for channel in channels):
            return []
        rows: dict[tuple[str, str], list[Message]] = {}
        for schema, channel, message in reader.iter_messages():
            package, _, name = (schema.name if schema is not None else "").partition("/")
            kind = f"{package}/msg/{name.removeprefix('msg/')}"
            rows.setdefault((channel.topic, kind), []).append((message.log_time, json.loads(message.data)))
    return [_content(topic, kind, partial(list, found), found[0], len(found))
            for (topic, kind), found in rows.items() if len(found) > 1]
