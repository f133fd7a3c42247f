"""The program of the process in which SciPy reads a MATLAB file, since damaged ones crash the interpreter.

It imports nothing of hydroopt, so that it starts fast. `hydroopt.logs.formats.mat_file` starts it with the file as its
input.
"""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.io.matlab import MatReadError


class UnusableError(Exception):
    """What is wrong with a variable, and what to do about it."""


ROWS = 64
"""Rows of a matrix up to which each is listed as a vector."""


def answer(data: bytes, keys: Sequence[tuple[str, int | None]] | None) -> bytes:
    """Sizes of the vectors `keys` (variable, row) as a line of JSON, then their numbers; or what is wrong in that line.

    Without keys, the names of all vectors. Variables have dots for the fields of structs.

    >>> from scipy.io import savemat
    >>> savemat(file := io.BytesIO(), {"q": [[1.0, 2.0]]})
    >>> answer(file.getvalue(), [("q", None)])[:16]
    b'{"sizes": [2]}\\n\\x00'
    """
    try:
        names = None if keys is None else sorted({variable.partition(".")[0] for variable, _ in keys})
        content = loadmat(io.BytesIO(data), variable_names=names)  # type: ignore[arg-type]
    except MemoryError:
        return _line({"unreadable": "it declares more than memory can hold"})
    except Exception as error:  # whatever SciPy raises, the file is at fault
        return _line({"unreadable": str(error) if isinstance(error, ValueError | MatReadError) else "it is damaged"})
    if keys is None:
        return _line({"names": [name for variable, value in content.items() if not variable.startswith("__")
                                for name in _listed(variable, value)]})
    found = []
    for variable, row in keys:
        try:
            found.append(_vector(content, variable, row))
        except UnusableError as error:
            return _line({"variable": variable, "what": error.args[0], "remedy": error.args[1]})
    return _line({"sizes": [vector.size for vector in found]}) + b"".join(vector.tobytes() for vector in found)


def _listed(name: str, value: Any) -> Iterator[str]:
    """Names of the vectors of a variable: its own, those of its rows or of its fields."""
    if not isinstance(value, np.ndarray) or value.ndim != 2 or not value.size:
        return
    if value.dtype.names:
        for field, part in zip(value.dtype.names, value.item(), strict=True) if value.size == 1 else ():
            yield from _listed(f"{name}.{field}", part)
    elif value.dtype.kind in "fiu" and value.size > 1:
        rows, columns = value.shape
        if 1 in value.shape:
            yield name
        elif rows <= min(ROWS, columns):
            yield from (f"{name}[{row}]" for row in range(rows))


def _line(content: dict[str, Any]) -> bytes:
    return json.dumps(content).encode() + b"\n"


def _vector(content: object, variable: str, row: int | None) -> NDArray[np.float64]:
    value = content
    for part in variable.split("."):
        if isinstance(value, np.ndarray) and value.dtype.names and value.size == 1:
            value = dict(zip(value.dtype.names, value.item(), strict=True))
        if not isinstance(value, dict) or part not in value:
            present = [k for k in value if not str(k).startswith("__")] if isinstance(value, dict) else []
            raise UnusableError(f"there is no '{part}' (present: {', '.join(present[:40]) or 'nothing'})",
                                "correct the map")
        value = value[part]
    array = np.asarray(value)
    if array.dtype.kind not in "fiu" or array.ndim != 2:
        raise UnusableError("this is not a real matrix", "map a numeric vector or matrix")
    if (1 not in array.shape) if row is None else row >= array.shape[0]:
        raise UnusableError(f"it has {array.shape[0]} rows and {array.shape[1]} columns",
                            f"state row = 0 to {array.shape[0] - 1} in the map")
    return np.asarray(array.ravel() if row is None else array[row], dtype=float)


def main() -> None:
    """Answer for the file in the standard input; the arguments are the keys as JSON and the limits [bytes, s]."""
    keys, memory, seconds = json.loads(sys.argv[1])
    data = sys.stdin.buffer.read()
    try:
        import resource  # noqa: PLC0415 (there is none on Windows)
    except ImportError:
        pass
    else:
        for limit, most in ((resource.RLIMIT_AS, memory), (resource.RLIMIT_CPU, seconds), (resource.RLIMIT_CORE, 0)):
            resource.setrlimit(limit, (most, most))
    sys.stdout.buffer.write(answer(data, keys))


if __name__ == "__main__":
    main()
