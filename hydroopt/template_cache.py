"""Templates compiled to Python's bytecode, kept beside the compiled kernels: to compile them takes longer than to fill
them in."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from pathlib import Path

import jinja2
from jinja2.bccache import Bucket

from hydroopt import cache


class TemplateCache(jinja2.BytecodeCache):
    """Keeps the templates of one environment; where nothing can be kept they are compiled at each start.

    Jinja applies filters to what is constant in a template when it compiles it.

    Args:
        files: Python files that state the environment and its filters, and what these call.
        options: in words, what else decides what a template compiles to.
    """

    def __init__(self, *files: str, options: str = "") -> None:
        read = [Path(file).read_bytes() for file in files]
        self._stated = b"\0".join([*read, options.encode(), jinja2.__version__.encode()])

    def load_bytecode(self, bucket: Bucket) -> None:
        """Take the template's code where it is there and whole."""
        with suppress(OSError):
            content = cache.read(self._place(bucket))
            digest, code = content[:32], content[32:]
            if hashlib.sha256(code).digest() == digest:  # damaged bytecode ends the interpreter
                bucket.bytecode_from_string(code)

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Keep the template's code."""
        code = bucket.bytecode_to_string()
        with suppress(OSError):
            place = self._place(bucket)
            with cache.scratch(place.parent) as made:
                file = made / place.name
                file.write_bytes(hashlib.sha256(code).digest() + code)
                file.chmod(0o600)  # whatever the umask: nobody else may write it
                file.replace(place)

    def _place(self, bucket: Bucket) -> Path:
        key = hashlib.sha256(self._stated)
        for part in (bucket.key, bucket.checksum):
            key.update(part.encode())
        return cache.folder() / f"{key.hexdigest()[:32]}.template"
