"""Text files that appear whole or not at all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from hydroopt.errors import ProblemError


def write_files(directory: str | Path, files: dict[str, str]) -> None:
    """Write text files into a directory, each first under a temporary name.

    Raises:
        ProblemError: the directory or a file cannot be written.
    """
    target = Path(directory)
    try:
        target.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=target, prefix=".unfinished-") as temporary:
            for name, text in files.items():
                (Path(temporary) / name).write_text(text, encoding="utf-8")
            for name in files:
                os.replace(Path(temporary) / name, target / name)
    except OSError as error:
        raise ProblemError(f"cannot be written ({error.strerror})", where=str(directory),
                           remedy="choose another directory with -o") from None
