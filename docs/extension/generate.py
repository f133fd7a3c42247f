"""Pages that are written from the code and the studies before Sphinx reads the site."""

from __future__ import annotations

from pathlib import Path

from extension import api, c_interface, commands, figures, machine_file, machines, studies


def generate(docs: Path) -> None:
    """Write all generated pages below ``docs/generated``, each only if it changes."""
    made = (studies.pages(docs.parent / "studies") | commands.pages() | machine_file.pages() | api.pages()
            | c_interface.pages() | machines.pages() | figures.pages(docs))
    for name, text in made.items():
        _write(docs / "generated" / name, text)


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text("utf-8") != text:
        path.write_text(text, "utf-8")
