"""Take docs/figures/readme.png, the README's picture of a report: ``python docs/figures/readme.py`` (extra ``dev``)."""

from __future__ import annotations

import io
import tempfile
from pathlib import Path

from pages import window
from PIL import Image

import hydroopt as ho
from hydroopt.report import identification

MACHINE = "excavator_bucket"
COLOURS = 96
SHORTEN = """() => {
    for (const figure of document.querySelectorAll(".first figure.chart"))
        if (!/^(boom|stick|bucket)_cylinder/.test(figure.textContent.trim())) figure.remove()
    document.querySelector(".first section .note").remove()
}"""
"""Leaves the figures of the cylinders."""


def report() -> str:
    """The page of an identification: 40 s of training, 20 s that the estimate has not seen."""
    machine = ho.load_machine(MACHINE)
    model = ho.Model(machine)
    truth = ho.random_truth(model, seed=4)
    train, unseen = (ho.simulate(model, ho.random_trajectory(model, duration=duration, rate=50, seed=k), truth, seed=k)
                     for k, duration in ((1, 40), (2, 20)))
    return identification.render(ho.solve(ho.identification_problem(machine, [train], [unseen])))


def picture(page: Path) -> bytes:
    """What a browser shows of the machine in space and of the forces beside it."""
    with window(width=1280, height=900, scale=1.5) as tab:
        tab.goto(page.as_uri())
        tab.wait_for_timeout(3000)
        tab.evaluate(SHORTEN)
        return bytes(tab.locator(".first").screenshot())


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "report.html"
        page.write_text(report(), "utf-8")
        shot = Image.open(io.BytesIO(picture(page))).convert("RGB")
    shot.quantize(COLOURS).save(Path(__file__).with_suffix(".png"), optimize=True)
