"""A command: what numbers its options take, and the folder that it alone writes into until it ends."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from functools import partial
from inspect import unwrap
from pathlib import Path
from typing import Any, get_type_hints

from typer.core import TyperCommand

from hydroopt.errors import ProblemError, StoppedError, shortened

LARGEST = {"duration": 1e5, "period": 1e5, "blend": 1e5, "per_actuator": 1e5, "search_seconds": 1e7, "rate": 1e5,
           "bandwidth": 1e5, "harmonics": 1e5, "pieces": 1e5, "starts": 1e5, "cells": 1e6, "poses": 1e4,
           "candidates": 1e6, "processes": 1024, "seed": 2.0**63, "truth_seed": 2.0**63, "accuracy": 1e6}
"""Largest magnitude by the name of the option."""
LARGEST_OTHERS = 1e9
"""The same of all other options."""


def refuse(name: str, value: float, where: str) -> None:
    """Refuse a number that is not finite, or beyond what the option of this name can mean.

    Raises:
        ProblemError: with the place `where`.
    """
    most = LARGEST.get(name, LARGEST_OTHERS)
    if isinstance(value, float) and not math.isfinite(value):
        raise ProblemError(f"{value} is not a finite number", where=where, remedy="give a finite number")
    if abs(value) > most:
        said = f"{value:g}" if isinstance(value, float) else shortened(str(value), 20)
        raise ProblemError(f"{said} is too large", where=where, remedy=f"give at most {most:g}")


def off_unless_given(flag: Any) -> Any:
    """The same option, off by default: to convert None to that, typer would import pydantic, which takes half of the
    time of a help."""
    if flag is not None and flag.default is None:
        flag.default = False
    return flag


class Command(TyperCommand):
    """A command whose options take finite numbers within `LARGEST`, and that keeps other processes from writing into
    its folder until it ends."""

    def get_help_option(self, ctx: Any) -> Any:
        """The option --help."""
        return off_unless_given(super().get_help_option(ctx))

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        output = ctx.params.get("output")
        if output is None:
            return super().invoke(ctx)
        from hydroopt.support.files import claimed, temporary_files

        with claimed(output) as claim:
            _refuse_inputs(self, ctx.params)
            temporary_files(Path(output))
            try:
                return super().invoke(ctx)
            except KeyboardInterrupt:
                if claim.written:
                    raise StoppedError("interrupted after the result was written", where=str(output),
                                       remedy="use it as it is") from None
                raise

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """The arguments, parsed and checked."""
        for option in self.params:
            if not option.required and option.callback is None:
                option.process_value = partial(_given, option.process_value, option.default)  # type: ignore[method-assign]
        rest = super().parse_args(ctx, args)
        for option in self.params:
            value = ctx.params.get(option.name or "")
            if isinstance(value, int | float):
                refuse(option.name or "", value, max(option.opts, key=len))
        return rest


def _given(convert: Callable[[Any, Any], Any], default: Any, context: Any, value: Any) -> Any:
    """The value of an option, converted where it was given as text: typer makes a pydantic validator of every option
    that it converts, which takes a twentieth of a second in all."""
    return value if value is default and not isinstance(value, str | list) else convert(context, value)


def _refuse_inputs(command: Any, given: Mapping[str, object]) -> None:
    """Refuse an output directory that holds a file or a folder which the command reads, at any depth.

    Args:
        command: whose function states which of its parameters are paths.
        given: their values by name.

    Raises:
        ProblemError: the directory holds one of them.
    """
    from hydroopt.machine.bundled_files import bundled_files

    output, kinds = os.path.realpath(str(given["output"])), get_type_hints(unwrap(command.callback))
    for parameter in command.params:
        value = given.get(parameter.name)
        if parameter.name == "output" or value is None:
            continue
        folders = "Path" in str(kinds.get(parameter.name)) or "DIR" in (parameter.metavar or "")
        for text in map(str, value if isinstance(value, list | tuple) else [value]):
            for part in (text, text.rpartition(":")[2]):  # MASS:LOG
                if os.path.isfile(part) or (folders and os.path.isdir(part) and part not in bundled_files()):
                    path = os.path.realpath(part)
                    if os.path.commonpath((output, path)) == output:
                        raise ProblemError(f"this directory holds '{part}', which the command reads",
                                           where=str(given["output"]), remedy="choose another directory with -o")
