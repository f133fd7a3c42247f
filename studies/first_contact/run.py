"""What a stranger's files, names and machine do to hydroopt: counts of inputs tried, read and refused, part by part."""

from __future__ import annotations

from importlib import import_module

PARTS = ("layouts", "spellings", "names", "robot_files", "machine_files", "answer_folders", "memory", "process")
"""Modules of this folder, each with ``run() -> dict[str, float]``."""


def run(*parts: str) -> dict[str, float]:
    """The figures of some parts, of all by default; each figure's name begins with what its part counts."""
    figures: dict[str, float] = {}
    for part in parts or PARTS:
        figures |= import_module(f"studies.first_contact.{part}").run()
    return figures
