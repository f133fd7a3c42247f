"""Pages that are written from the code and the studies before Sphinx reads the site."""

from __future__ import annotations

from pathlib import Path

from extension import commands, figures, studies


def generate(docs: Path) -> None:
    """Write all generated pages below ``docs/generated``, each only if it changes."""
    for name, text in (studies.pages(docs.parent / "studies") | commands.pages() | figures.pages()).items():
        _write(docs / "generated" / name, text)


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text("utf-8") != text:
        path.write_text(text, "utf-8")
