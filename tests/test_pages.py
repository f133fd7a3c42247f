"""What the README and the site show runs as it stands, page by page, in an empty directory."""

import re
import runpy
import shlex
from pathlib import Path

import pytest
import typer
from typer.core import TyperGroup

from fixtures import documents
from hydroopt.cli import app

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted(path for path in (ROOT / "docs").rglob("*.md") if "generated" not in path.parts)]
PICTURES = runpy.run_path(str(ROOT / "docs/figures/pages.py"))["pictures"]()
LARGEST = 1.5e6
"""Bytes of all pictures of the site."""
SHOWING = [page for page in PAGES if any(block.language in ("sh", "python") for block in documents.blocks(page))]


@pytest.mark.slow
@pytest.mark.parametrize("page", SHOWING, ids=lambda page: page.stem)
def test_a_page_can_be_followed(page: Path, tmp_path: Path) -> None:
    folder = tmp_path / "empty"
    folder.mkdir()
    documents.follow(page, folder)
    missing = [each.page for each in PICTURES if each.document == page and not (folder / each.page).is_file()]
    assert not missing, "docs/figures/pages.py pictures what is not there"


def test_pictures_of_pages_are_there_small_and_shown() -> None:
    """`test_a_page_can_be_followed` looks whether what they picture is still made."""
    folder = ROOT / "docs/figures"
    assert {each.name for each in PICTURES} == {file.stem for file in (folder / "pages").glob("*.webp")}
    assert len({each.document for each in PICTURES}) >= 3
    assert sum(file.stat().st_size for file in folder.rglob("*") if file.suffix in (".webp", ".png")) < LARGEST
    for each in PICTURES:
        assert each.name.split(".")[0] == each.document.stem
        made = each.page.partition("/")[0]
        assert any(re.search(rf"-o {made}\b", line) for line in documents.commands(each.document)), each.name


@pytest.mark.parametrize("page", SHOWING, ids=lambda page: page.stem)
def test_commands_parse(page: Path) -> None:
    """Names of commands and options exist; `test_a_page_can_be_followed` runs them."""
    for line in documents.commands(page):
        program, *words = shlex.split(line.partition("&&")[0], comments=True) or [""]
        if program != "hydroopt":
            continue
        context = typer.main.get_command(app).make_context(program, words)
        while isinstance(context.command, TyperGroup):
            name, *words = words
            command = context.command.get_command(context, name)
            assert command is not None, line
            context = command.make_context(name, words, parent=context)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_blocks_have_a_language(page: Path) -> None:
    """Indented or unnamed blocks would not be run."""
    text = page.read_text("utf-8")
    assert not [block.line for block in documents.blocks(page) if not block.language]
    assert not re.findall(r"^    hydroopt .*$", text, re.MULTILINE)


def test_a_page_that_tells_another_output_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# Page\n\n```toml\n# a.toml\nx = 1\n```\n\n```sh\ncat a.toml\n```\n\n```text\n...x = 1\n```\n")
    documents.follow(page, tmp_path)
    page.write_text(page.read_text().replace("...x = 1", "...x = 2"))
    with pytest.raises(AssertionError, match=r"page.md:12 shows"):
        documents.follow(page, tmp_path)
    page.write_text("```python\nprint(1)\n```\n```text\n1\n```\n```python\n1 / 0\n```\n")
    with pytest.raises(ZeroDivisionError):
        documents.follow(page, tmp_path)
