"""Seeded spoiling of inputs: tokens of texts, nodes of JSON, types of Parquet and MATLAB files, and bytes of all."""

from __future__ import annotations

import contextlib
import copy
import io
import json
import random
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.io import savemat

NUMBERS = ("0", "-0.0", "1", "-1", "1e-320", "1e-200", "1e-9", "1e6", "1e9", "1e12", "1e30", "1e200", "1e308", "1e309",
           "-1e308", "nan", "inf", "-inf", "9" * 309, "9" * 5000, "0x" + "f" * 400, "1_000", "1,5", "٣", "2147483648",
           "-9223372036854775809", "1e", "--1", "0.1.2", "")
WORDS = ("", " ", "a", "\x1b[2J\x1b]0;owned\x07", "\u202egnp.exe", "\u200b", "x" * 500, "x" * 70_000, "'", '"', "\\",
         "{", "}", "{0}", "%s", "%n", "$\\frac", "*/ int", "../../etc/passwd", "/dev/zero", "<script>alert(1)</script>",
         "&amp;", "null", "true", "[deg]", "boom", "base", "é" * 40, "\ud800", "\n", "\r", "\t", "\0", "#", "[", "]",
         "[[", "=", ",", ";", "deg", "m", "kg", "bar", "m^9^9^9", "furlong", "N*m*s/rad", "%", "a.b.c", "a." * 50)
_TOKEN = re.compile(r'"[^"\n]*"|[-+]?\d[\d_.eE+-]*|[A-Za-z_][\w.]*|[^\s\w]')


SPARED: list[bool] = [False]
"""Whether texts stay as they are."""


@contextlib.contextmanager
def sparing(spared: bool) -> Iterator[None]:
    """Leave texts and trees as they are, where that is asked for."""
    SPARED.append(spared)
    try:
        yield
    finally:
        SPARED.pop()


def text(rng: random.Random, good: str) -> bytes:
    """A text with one to four faults; often still of the right grammar."""
    if SPARED[-1]:
        return good.encode()
    for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 4))):
        good = _FAULTS[rng.randrange(len(_FAULTS))](rng, good)
    data = good.encode("utf-8", "surrogatepass")
    fault = rng.random()
    if fault < 0.02:
        return good.encode("utf-16", "surrogatepass")
    if fault < 0.04:
        return b"\xef\xbb\xbf" + data
    if fault < 0.06:
        return good.encode("latin-1", "replace")
    return flipped(rng, data) if fault < 0.16 else data


def flipped(rng: random.Random, data: bytes) -> bytes:
    """Bytes of which some are changed, cut out, doubled or cut off."""
    spoilt = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4, 16))):
        if not spoilt:
            break
        at, way = rng.randrange(len(spoilt)), rng.random()
        if way < 0.4:
            spoilt[at] = rng.choice((0, 1, 9, 127, 128, 255, rng.randrange(256)))
        elif way < 0.6:
            spoilt[at] ^= 1 << rng.randrange(8)
        elif way < 0.75:
            spoilt[at:at + 4] = rng.choice((b"\xff\xff\xff\x7f", b"\xff\xff\xff\xff", b"\0\0\0\0", b"\0\0\0\x80"))
        elif way < 0.85:
            del spoilt[at:at + rng.choice((1, 4, 64))]
        elif way < 0.95:
            spoilt[at:at] = spoilt[at:at + rng.choice((1, 8, 256))]
        else:
            del spoilt[at:]
    return bytes(spoilt)


def _token(rng: random.Random, good: str) -> str:
    """Another number for a number, another word for a word, anything for anything."""
    start = rng.randrange(len(good) + 1)
    found = _TOKEN.search(good, start) or _TOKEN.search(good)
    if found is None:
        return good + rng.choice(WORDS)
    token = found.group()
    if token[0] == '"' and " " in token and rng.random() < 0.7:  # a quantity
        number, _, unit = token[1:-1].partition(" ")
        new = f'"{rng.choice(NUMBERS)} {unit}"' if rng.random() < 0.7 else f'"{number} {rng.choice(WORDS)}"'
    elif token[0] == '"':
        new = f'"{rng.choice(WORDS)}"' if rng.random() < 0.8 else rng.choice(NUMBERS)
    elif token[-1].isdigit():
        new = rng.choice(NUMBERS) if rng.random() < 0.8 else rng.choice(WORDS)
    else:
        new = rng.choice(WORDS)
    return good[:found.start()] + new + good[found.end():]


def _other(rng: random.Random, good: str) -> str:
    """A token of the same text instead of another one: right words in the wrong place."""
    tokens = list(_TOKEN.finditer(good))
    if not tokens:
        return good
    one, other = rng.choice(tokens), rng.choice(tokens)
    return good[:one.start()] + other.group() + good[one.end():]


def _lines(rng: random.Random, good: str) -> str:
    """A line left out, doubled, moved, joined with the next or cut."""
    lines = good.split("\n")
    at, way = rng.randrange(len(lines)), rng.randrange(6)
    if way == 0:
        del lines[at]
    elif way == 1:
        lines.insert(at, lines[at])
    elif way == 2:
        lines.insert(rng.randrange(len(lines)), lines.pop(at))
    elif way == 3:
        lines[at] = lines[at][:rng.randrange(len(lines[at]) + 1)]
    elif way == 4:
        lines = lines[:at]
    else:
        stop = rng.randrange(len(lines))
        lines[at:at] = lines[min(at, stop):max(at, stop)]
    return "\n".join(lines)


def _deep(rng: random.Random, good: str) -> str:
    """Brackets in brackets."""
    found = _TOKEN.search(good, rng.randrange(len(good) + 1))
    at, count = (found.start() if found else 0), rng.choice((2, 40, 3000))
    left, right = rng.choice((("[", "]"), ("{a=", "}"), ("<a>", "</a>"), ("(", ")"), ('{"a":', "}")))
    return good[:at] + left * count + "1" + right * rng.choice((count, 0)) + good[at:]


_FAULTS = (_token, _token, _token, _token, _other, _other, _lines, _lines, _deep)

VALUES = (None, True, False, 0, -1, 2**63, 10**309, 1e308, -1e-320, float("nan"), float("inf"), "", "x", "x" * 70_000,
          "\x1b[2J", "\ud800", [], {}, [[]], {"a": 1}, [None], "ok", "failed", 3, "1e400", {"value": None})


def tree(rng: random.Random, good: Any) -> bytes:
    """JSON of which some nodes are others, missing, or of another type."""
    if SPARED[-1]:
        return json.dumps(good).encode()
    spoilt = json.loads(json.dumps(good))
    for _ in range(rng.choice((1, 1, 2, 3, 8))):
        node, key, above = spoilt, None, None
        while isinstance(node, dict | list) and node and rng.random() < 0.85:
            above, key = node, rng.choice(list(node)) if isinstance(node, dict) else rng.randrange(len(node))
            node = node[key]
        if above is None:
            continue
        way = rng.random()
        if way < 0.15:
            del above[key]
        elif way < 0.25 and isinstance(above, dict):
            above[rng.choice(WORDS)] = above.pop(key)
        else:
            above[key] = copy.deepcopy(rng.choice(VALUES))
    data = json.dumps(spoilt).encode()
    return flipped(rng, data) if rng.random() < 0.1 else data


def columns(rng: random.Random, good: dict[str, np.ndarray]) -> dict[str, Any]:
    """Columns with other names, values or types."""
    made: dict[str, Any] = dict(good)
    for _ in range(rng.choice((1, 1, 2, 3))):
        if not made:
            break
        name = rng.choice(list(made))
        values, way = made[name], rng.randrange(9)
        if way == 0:
            del made[name]
        elif way == 1:
            made[rng.choice((*WORDS[:20], name + rng.choice(WORDS[:40]), name.replace("q", "p_head"))).replace(
                "\ud800", "?")] = made.pop(name)
        elif way in (2, 3, 4) and isinstance(values, np.ndarray) and values.dtype.kind == "f" and values.size:
            values = values.copy()
            with np.errstate(over="ignore"):
                values[rng.randrange(values.size):rng.choice((None, 3, 10**6))] = rng.choice(
                    (0.0, np.nan, np.inf, -np.inf, 1e308, -1e308, 1e31, 1e12, 1e-310, 7.0))
            made[name] = values
        elif way == 5:
            made[name] = np.zeros(len(values), rng.choice((np.int8, np.uint64, np.float16, np.float32, bool)))
        elif way == 6:
            made[name] = [rng.choice(("x", "1", "", None)) for _ in range(len(values))]
        elif way == 7:
            size = rng.choice((0, 1, 2, 3))
            made = {key: value[:size] for key, value in made.items()}
        else:
            made[name] = np.repeat(np.asarray(values, dtype=object)[:1], len(values))
    return made


def parquet(rng: random.Random, good: dict[str, np.ndarray]) -> bytes:
    """A Parquet file of spoilt columns or with spoilt bytes."""
    file = io.BytesIO()
    whole = rng.random() < 0.5
    try:
        table = pa.table({name: pa.array(values) for name, values in (good if whole else columns(rng, good)).items()})
        if rng.random() < 0.1 and table.num_columns:
            k = rng.randrange(table.num_columns)
            kind = rng.choice((pa.string(), pa.timestamp("ns"), pa.decimal128(38, 3), pa.int64(), pa.float16()))
            table = table.set_column(k, table.column_names[k], pa.nulls(table.num_rows, kind))
        pq.write_table(table, file, compression=rng.choice(("snappy", "gzip", "none", "zstd")),
                       use_dictionary=rng.random() < 0.5, data_page_version=rng.choice(("1.0", "2.0")))
    except (pa.ArrowException, ValueError, OverflowError, TypeError):
        return b"PAR1" + bytes(rng.randrange(64)) + b"PAR1"
    return flipped(rng, file.getvalue()) if whole or rng.random() < 0.1 else file.getvalue()


@np.errstate(all="ignore")
def matlab(rng: random.Random, good: dict[str, np.ndarray]) -> bytes:
    """A MATLAB file of other types and shapes, or with spoilt bytes."""
    content: dict[str, Any] = {name: values[:, None] for name, values in good.items()}
    whole = rng.random() < 0.6
    if not whole:
        name = rng.choice(list(content))
        values = content[name]
        content[name] = rng.choice((values.T, values[:, :, None], values.astype(np.int16), values + 1j, "text",
                                    {"a": values}, np.array([[values]], dtype=object), values[:0], values[:1],
                                    np.tile(values, (1, 3)), values * 1e307, values * np.nan, values > 0))
    file = io.BytesIO()
    savemat(file, content, do_compression=rng.random() < 0.3, format=rng.choice(("5", "5", "5", "4")) if whole else "5")
    return flipped(rng, file.getvalue()) if whole else file.getvalue()
