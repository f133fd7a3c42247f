"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

from hydroopt.errors import ProblemError


def write_files(directory: str | Path, files: Mapping[str, str | bytes]) -> None:
    """Write files into a directory, each first under a temporary name; a name may have folders, ``c/crane.h``.

    Raises:
        ProblemError: the directory or a file cannot be written.
    """
    target = Path(directory)
    try:
        target.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=target, prefix=".unfinished-") as temporary:
            for name, content in files.items():
                file = Path(temporary) / name
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(content.encode() if isinstance(content, str) else content)
            for name in files:
                (target / name).parent.mkdir(exist_ok=True, parents=True)
                os.replace(Path(temporary) / name, target / name)
    except OSError as error:
        raise ProblemError(f"cannot be written ({error.strerror})", where=str(directory),
                           remedy="choose another directory with -o") from None


def refuse_directory(directory: Path, names: tuple[str, ...]) -> None:
    """Refuse a directory that cannot take files of these names, before they are computed.

    Raises:
        ProblemError: it is a file, or holds a directory where a file must be.
    """
    if directory.exists() and not directory.is_dir():
        raise ProblemError("this is a file", where=str(directory), remedy="choose another directory with -o")
    for name in names:
        if (directory / name).is_dir():
            raise ProblemError("this is a directory", where=str(directory / name),
                               remedy="choose another directory with -o")
