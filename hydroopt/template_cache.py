"""Templates compiled to Python's bytecode, kept beside the compiled kernels: to compile them takes longer than to fill
them in."""

from __future__ import annotations

import hashlib
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
        code = cache.kept(self._name(bucket))  # damaged bytecode would end the interpreter
        if code is not None:
            bucket.bytecode_from_string(code)

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Keep the template's code."""
        cache.keep(self._name(bucket), bucket.bytecode_to_string())

    def _name(self, bucket: Bucket) -> str:
        key = hashlib.sha256(self._stated)
        for part in (bucket.key, bucket.checksum):
            key.update(part.encode())
        return f"{key.hexdigest()[:32]}.template"
