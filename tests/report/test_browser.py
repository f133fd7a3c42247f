"""The page of an identification in a real browser: the machine and all figures share one clock, and pins never part."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.browser import SETTLED, browser, needs_browser, opened
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.report.identification import render
from hydroopt.simulation.simulate import random_trajectory, simulate

pytestmark = needs_browser
LARGEST_GAP = 1e-4
"""How far pins may part [m]."""


@pytest.fixture(scope="module")
def loader() -> Model:
    return Model(load_machine("wheel_loader"))


@pytest.fixture(scope="module")
def motion(loader: Model) -> Any:
    return random_trajectory(loader, duration=12.0, rate=20.0, seed=1)


@pytest.fixture(scope="module")
def file(loader: Model, motion: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    estimate = identify(identification_problem(loader.machine, [simulate(loader, motion, noise=False)]))
    made = tmp_path_factory.mktemp("page") / "report.html"
    made.write_text(render(estimate), "utf-8")
    return made


@pytest.fixture(scope="module")
def using() -> Iterator[Any]:
    with browser() as found:
        yield found


@pytest.fixture(scope="module")
def page(using: Any, file: Path) -> Iterator[Any]:
    with opened(using, file) as shown:
        yield shown


def test_pins_never_part_on_screen(page: Any, loader: Model) -> None:
    """Positions in the drawn scene in every frame, against each other and against the model's cylinder lengths."""
    pins = page.evaluate("""() => { const found = [];
        for (let k = 0; k <= hydroopt.clock.last; k += 0.5) { hydroopt.clock.set(k);
            found.push([hydroopt.machine.jointsAt(k), hydroopt.view.pins()]); }
        return found; }""")
    assert len(pins) > 400
    shown = [(q, ends) for q, ends in pins if np.all(np.isfinite(q))]
    assert max(np.linalg.norm(np.subtract(*both)) for _, ends in shown for both in ends.values()) < LARGEST_GAP
    q = np.array([q for q, _ in shown])
    lengths = loader.over(loader.cylinder_kinematics, q, 0 * q, 0 * q)[0][:, :, 0]
    for k, cylinder in enumerate(loader.machine.pinned):
        drawn = [np.linalg.norm(np.subtract(ends[f"{cylinder.name}.barrel"][0], ends[f"{cylinder.name}.rod"][0]))
                 for _, ends in shown]
        np.testing.assert_allclose(drawn, lengths[:, k], atol=LARGEST_GAP)


def test_hovering_over_any_figure_moves_the_machine_and_all_others(page: Any) -> None:
    page.evaluate("hydroopt.clock.set(5)")
    before = page.evaluate("hydroopt.view.pins()")
    over = page.locator("figure.time .u-over").first
    over.scroll_into_view_if_needed()
    box = over.bounding_box()
    page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 0.5 * box["height"])
    page.evaluate(SETTLED)
    time = page.evaluate("hydroopt.clock.time()")
    assert time == pytest.approx(0.7 * 12, abs=0.6)
    assert page.evaluate("hydroopt.view.pins()") != before
    markers = page.evaluate("""() => hydroopt.timePlots.map((plot) => plot.posToVal(
        plot.over.querySelector(".now").getBoundingClientRect().left - plot.over.getBoundingClientRect().left, "x"))""")
    assert len(markers) >= 4
    np.testing.assert_allclose(markers, time, atol=0.1)


def test_the_present_sample_is_marked_among_the_dots(page: Any) -> None:
    page.evaluate("hydroopt.clock.set(40)")
    page.evaluate(SETTLED)
    away = page.evaluate("""() => Array.from(document.querySelectorAll("figure.cloud"), (figure) => {
        const chart = hydroopt.page.charts[+figure.dataset.chart];
        const over = figure.querySelector(".u-over").getBoundingClientRect();
        const plot = hydroopt.plots.find((each) => figure.contains(each.root));
        const here = figure.querySelector(".here").getBoundingClientRect();
        const [x, y] = [plot.posToVal((here.left + here.right) / 2 - over.left, "x"),
            plot.posToVal((here.top + here.bottom) / 2 - over.top, "y")];
        const span = (scale) => plot.scales[scale].max - plot.scales[scale].min;
        return [(x - hydroopt.column(chart.x)[40]) / span("x"), (y - hydroopt.column(chart.y)[40]) / span("y")]; })""")
    assert len(away) == 4
    assert np.max(np.abs(away)) < 0.02


def test_play_runs_and_zoom_is_shared(page: Any) -> None:
    page.evaluate("hydroopt.clock.set(0)")
    page.get_by_role("button", name="play").click()
    for _ in range(50):
        page.evaluate(SETTLED)
        if page.evaluate("hydroopt.clock.time()") > 0.1:
            break
    assert page.evaluate("hydroopt.clock.time()") > 0.1
    page.get_by_role("button", name="play").click()
    page.evaluate("hydroopt.timePlots[0].setScale('x', {min: 2, max: 4})")
    page.evaluate(SETTLED)
    shown = page.evaluate("hydroopt.timePlots.map((plot) => [plot.scales.x.min, plot.scales.x.max])")
    assert shown == [[2, 4]] * len(shown)


def test_headings_sort_their_table(page: Any) -> None:
    table = page.locator("table", has=page.get_by_role("button", name="prior σ")).last
    heading = table.get_by_role("button", name="value", exact=True)
    heading.click()
    assert table.locator("th[aria-sort=ascending]").count() == 1
    names = table.locator("tbody tr:not([hidden]) td:first-child").all_inner_texts()
    heading.click()
    assert table.locator("th[aria-sort=descending]").count() == 1
    assert table.locator("tbody tr:not([hidden]) td:first-child").all_inner_texts() != names
    heading.click()
    assert table.locator("tbody tr.owner:not([hidden])").count() > 0


@pytest.mark.parametrize("width", [400, 1920])
def test_nothing_is_wider_than_the_window(using: Any, file: Path, width: int) -> None:
    with opened(using, file, width, "dark") as shown:
        assert shown.evaluate("document.documentElement.scrollWidth") <= width
