"""The documentation site: it builds without a warning, and a reader needs no network."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from fixtures.browser import browser, needs_browser

ROOT = Path(__file__).parents[1]
LOADED = re.compile(r"""<(?:script|img|link rel="(?:stylesheet|icon|preload)")[^>]*?(?:src|href)="([^"]*)\"""")
"""What a page loads by itself."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site as ``make docs`` builds it."""
    makefile = (ROOT / "Makefile").read_text("utf-8")
    (command,) = re.findall(r"^\t\$\(BIN\)/python -m (sphinx .*)$", makefile, re.MULTILINE)
    folder = tmp_path_factory.mktemp("site")
    words = [word.replace("out/", f"{folder}/") for word in command.split()]
    done = subprocess.run([sys.executable, "-m", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder / "docs"


@pytest.mark.slow
def test_pages_load_nothing_from_the_network(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 50
    loaded = {(page.name, address) for page in pages for address in LOADED.findall(page.read_text("utf-8"))}
    assert any("_static" in address for _, address in loaded)
    assert not {(page, address) for page, address in loaded if "//" in address}
    for sheet in site.rglob("*.css"):
        assert not re.findall(r"url\(['\"]?(?:https?:)?//", sheet.read_text("utf-8")), sheet


def test_every_study_has_its_row() -> None:
    told = set(re.findall(r"^\| \[`(\w+)`\]", (ROOT / "docs/studies.md").read_text("utf-8"), re.MULTILINE))
    assert {path.parent.name for path in (ROOT / "studies").glob("*/expected.json")} == told


@pytest.mark.slow
def test_every_key_of_a_machine_file_has_a_docstring(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    machine_file = runpy.run_path(str(ROOT / "docs/extension/machine_file.py"))
    text = machine_file["pages"]()["machine_file.md"]
    assert "| `dead_zone` | m/s (\\> 0) | – | Speed below which there is no dry friction: neither" in text
    assert "| `type` | `\"revolute\"` or `\"prismatic\"` or `\"locked\"` | **required** |" in text
    assert "| `lower` | 3 × m | **required** |" in text
    assert "| `rocker` | [table](#machine-file-bar) | **required** |" in text
    assert text.count("\n## ") > 40


@pytest.mark.slow
def test_every_row_of_the_commands_page_has_its_two_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    text = runpy.run_path(str(ROOT / "docs/extension/commands.py"))["pages"]()["commands.md"]
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert any("--reserve PART" in row for row in rows)
    assert not [row for row in rows if len(re.findall(r"(?<!\\)\|", row)) != 3]


@pytest.mark.slow
@needs_browser
@pytest.mark.parametrize("page", ["index", "generated/api", "reference/machine_file", "tutorials/own_csv"])
def test_readers_of_screens_find_no_barrier(page: str, site: Path) -> None:
    from axe_playwright_python.sync_playwright import Axe

    with browser() as opened:
        shown = opened.new_context().new_page()
        shown.goto((site / f"{page}.html").as_uri())
        found = Axe().run(shown).response["violations"]
    assert not [(each["id"], each["nodes"][0]["html"][:200]) for each in found
                if each["impact"] in ("serious", "critical")]


@pytest.mark.slow
@needs_browser
def test_pages_fit_a_phone_in_light_and_dark(site: Path) -> None:
    """Only tables and code scroll sideways, and no page writes errors or asks for what is outside."""
    complaints: list[str] = []
    with browser() as opened:
        for scheme in ("light", "dark"):
            context = opened.new_context(viewport={"width": 400, "height": 800}, color_scheme=scheme)
            page = context.new_page()
            page.on("console", lambda said: complaints.append(said.text) if said.type == "error" else None)
            page.on("request", lambda asked: complaints.append(asked.url) if not asked.url.startswith(
                (site.as_uri(), "data:")) else None)
            for file in sorted(site.rglob("*.html")):
                page.goto(file.as_uri())
                if page.evaluate("document.documentElement.scrollWidth > document.documentElement.clientWidth"):
                    complaints.append(f"{file.name} is too wide")
            context.close()
    assert not complaints
