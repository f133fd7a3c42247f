"""One page for each study, from its README."""

from __future__ import annotations

from pathlib import Path


def pages(studies: Path) -> dict[str, str]:
    """Text of each page by its path below ``docs/generated``."""
    return {f"studies/{path.parent.name}.md": path.read_text("utf-8") for path in sorted(studies.glob("*/README.md"))}
