"""Take the picture of a report that README and site show first, for light and dark readers: docs/figures/readme.webp
and readme_dark.webp. ``python docs/figures/readme.py`` (extra ``dev``, Chromium)."""

from __future__ import annotations

import io
import tempfile
from pathlib import Path

from pages import QUALITY, window
from PIL import Image

import hydroopt as ho
from hydroopt.report import identification

MACHINE = "excavator_bucket"
SHORTEN = """() => {
    for (const figure of document.querySelectorAll(".first figure.chart"))
        if (!/^(boom|stick|bucket)_cylinder/.test(figure.textContent.trim())) figure.remove()
    document.querySelector(".first section .note").remove()
    document.querySelector(".first").style.padding = "14px"
}"""
"""Leaves the figures of the cylinders, with a margin around."""


def report() -> str:
    """The page of an identification: 40 s of training, 20 s that the estimate has not seen."""
    machine = ho.load_machine(MACHINE)
    model = ho.Model(machine)
    truth = ho.random_truth(model, seed=4)
    train, unseen = (ho.simulate(model, ho.random_trajectory(model, duration=duration, rate=50, seed=k), truth, seed=k)
                     for k, duration in ((1, 40), (2, 20)))
    return identification.render(ho.solve(ho.identification_problem(machine, [train], [unseen])))


def picture(page: Path, scheme: str) -> bytes:
    """What a browser shows of the machine in space and of the forces beside it, ``light`` or ``dark``."""
    with window(width=1280, height=900, scale=1.5, scheme=scheme) as tab:
        tab.goto(page.as_uri())
        tab.wait_for_timeout(3000)
        tab.evaluate(SHORTEN)
        return bytes(tab.locator(".first").screenshot())


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "report.html"
        page.write_text(report(), "utf-8")
        for scheme, file in (("light", "readme.webp"), ("dark", "readme_dark.webp")):
            shot = Image.open(io.BytesIO(picture(page, scheme))).convert("RGB")
            shot.save(Path(__file__).with_name(file), quality=QUALITY, method=6)
