"""What numbers options take, checked in one place before a command runs: finite, and within what can be computed."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from typer.core import TyperCommand

from hydroopt.errors import ProblemError, shortened

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


class Command(TyperCommand):
    """A command whose options take finite numbers within `LARGEST`."""

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
