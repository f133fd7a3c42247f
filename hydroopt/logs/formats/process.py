"""The program of the process in which a library reads a file, since damaged ones crash it or take all memory.

`hydroopt.logs.formats.foreign_file` starts it. It answers each line of its input, a request in JSON, by a line of JSON
and the array that this announces.
"""

from __future__ import annotations

import importlib
import io
import json
import sys
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np


def serve(kind: str, path: Path, requests: BinaryIO, answers: BinaryIO) -> None:
    """Answer requests about a file of a kind until there are no more."""
    from hydroopt.support import memory  # noqa: PLC0415

    try:
        decoder = importlib.import_module(f"hydroopt.logs.formats.decoders.{'hdf5' if kind == 'mat73' else kind}")
        sheets = decoder.contents(path, matlab=True) if kind == "mat73" else decoder.contents(path)
        _answer(answers, {"sheets": [{
            "name": sheet.name, "header": [column.header for column in sheet.columns], "own": sheet.stamps is not None,
            "shown": sheet.shown, "rows": sheet.rows, "text": sheet.text} for sheet in sheets]})
        for line in requests:
            request = json.loads(line)
            sheet = sheets[request["sheet"]]
            read = sheet.stamps if request["column"] < 0 else sheet.columns[request["column"]].values
            array = np.asarray(read())
            file = io.BytesIO()
            numbers = array.dtype.kind in "biufmM" and array.ndim == 1
            np.save(file, array if numbers else np.zeros(len(array), "S1"), allow_pickle=False)
            _answer(answers, {"size": file.tell()}, file.getvalue())
    except Exception as error:
        if memory.exceeded(error):
            _answer(answers, {"exceeded": memory.limit()})
        elif isinstance(error, ImportError):
            _answer(answers, {"missing": str(error.name or error)})
        else:  # whatever the library raises, the file is at fault
            _answer(answers, {"unreadable": (str(error) or type(error).__name__)[:200]})


def _answer(answers: BinaryIO, said: dict[str, Any], array: bytes = b"") -> None:
    answers.write(json.dumps(said).encode() + b"\n" + array)
    answers.flush()


def main() -> None:
    """Serve the file that the arguments name, within limits of memory [bytes] and time [s]."""
    kind, path, most, seconds, root = json.loads(sys.argv[1])
    sys.path.insert(0, root)
    from hydroopt.support import memory  # noqa: PLC0415

    answers = sys.stdout.buffer
    sys.stdout = sys.stderr  # what a library prints is no answer
    memory.restrict(most, seconds)
    serve(kind, Path(path), sys.stdin.buffer, answers)


if __name__ == "__main__":
    main()
