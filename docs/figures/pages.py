"""Take the pictures of pages that the site shows: ``python docs/figures/pages.py [NAME...]`` (extra ``dev``, Chromium).

A picture ``pages/urdf_arm.drawing.machine.webp`` shows ``drawing/machine.html``, which a reader makes who follows the
page ``urdf_arm`` of the site; a fourth word names a part of it. Pages of the site that show such pictures are followed
in an empty folder.
"""

from __future__ import annotations

import io
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

DOCS = Path(__file__).parents[1]
FOLDER = DOCS / "figures" / "pages"
SHOWN = re.compile(r"\]\(\.\./figures/pages/([\w.-]+)\.webp\)")
PARTS = {"": "", "side": "figure.wide-figure", "correlations": "svg.correlations", "residuals": ".first"}
"""What a picture shows, by the last word of its name: all that a window shows first, or what a selector finds."""
QUALITY = 60


class Picture(NamedTuple):
    """A picture: the page of the site that shows it, what it shows below the reader's folder, and which part of it."""

    name: str
    document: Path
    page: str
    part: str


def pictures() -> list[Picture]:
    """All pictures of pages that the site shows."""
    found = []
    for document in sorted(DOCS.rglob("*.md")):
        for name in SHOWN.findall(document.read_text("utf-8")):
            _, folder, page, *part = name.split(".")
            found.append(Picture(name, document, f"{folder}/{page}.html", "".join(part)))
    return found


@contextmanager
def window(width: int = 1120, height: int = 760, scale: float = 1.0, scheme: str = "light") -> Iterator[Any]:
    """A window of a browser whose 3-D graphics are computed by the processor."""
    from playwright.sync_api import sync_playwright  # noqa: PLC0415 (tests read this file where it is not installed)

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=[
            "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"])
        yield browser.new_page(viewport={"width": width, "height": height}, device_scale_factor=scale,
                               color_scheme=scheme)
        browser.close()


def taken(window: Any, page: Path, part: str) -> bytes:
    """What a window shows of a page, as PNG."""
    window.goto(page.as_uri())
    window.wait_for_timeout(3000)
    return bytes(window.locator(PARTS[part]).first.screenshot() if part else window.screenshot())


def main(names: list[str]) -> None:
    """Take all pictures, or those with these names."""
    from PIL import Image  # noqa: PLC0415

    sys.path.insert(0, str(DOCS.parent / "tests"))
    from fixtures import documents  # noqa: PLC0415

    wanted = [picture for picture in pictures() if not names or picture.name in names]
    FOLDER.mkdir(exist_ok=True)
    for document in dict.fromkeys(picture.document for picture in wanted):
        with tempfile.TemporaryDirectory() as place, window() as shown:
            folder = Path(place) / "empty"
            folder.mkdir()
            documents.follow(document, folder)
            for picture in wanted:
                if picture.document == document:
                    shot = taken(shown, folder / picture.page, picture.part)
                    image = Image.open(io.BytesIO(shot)).convert("RGB")
                    image.save(FOLDER / f"{picture.name}.webp", quality=QUALITY, method=6)


if __name__ == "__main__":
    main(sys.argv[1:])
