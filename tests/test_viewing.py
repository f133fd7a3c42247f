"""What `hydroopt.view` and the command `view` show, and what they refuse."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

import hydroopt
from fixtures.browser import SETTLED, browser, needs_browser, opened
from fixtures.pages import data_of, stands_alone
from hydroopt.cli import app
from hydroopt.errors import ProblemError


def run(*arguments: str) -> str:
    answer = CliRunner().invoke(app, list(arguments))
    assert answer.exit_code == 0, answer.output
    return answer.output.strip()


def test_a_machine_is_shown_over_the_ranges_of_its_joints(tmp_path: Path) -> None:
    file = Path(run("view", "wheel_loader", "-o", str(tmp_path)))
    page = file.read_text("utf-8")
    assert stands_alone(page)
    loader = hydroopt.load_machine("wheel_loader")
    scene = data_of(page)["scene"]
    assert [joint["name"] for joint in scene["joints"]] == [*loader.joints]
    assert [(joint["lower"], joint["upper"]) for joint in scene["joints"]] == [
        loader.link(joint).joint.range for joint in loader.joints]
    assert {"bellcrank", "bucket"} <= {body["name"] for body in scene["bodies"]}


def test_a_folder_of_results_is_shown_with_its_verdict(tmp_path: Path) -> None:
    model = hydroopt.Model(hydroopt.load_machine("patu655_lift"))
    motions = [hydroopt.random_trajectory(model, duration=10, rate=20, seed=k) for k in (1, 2)]
    logs = [hydroopt.simulate(model, motion, seed=1) for motion in motions]
    estimate = hydroopt.solve(hydroopt.identification_problem(model, logs[:1], logs[1:]))
    assert "measured" in hydroopt.view(estimate).page
    estimate.save(tmp_path)
    assert run("view", str(tmp_path), "-o", str(tmp_path / "page")) == str(tmp_path / "page/view.html")
    page = (tmp_path / "page/view.html").read_text("utf-8")
    assert 'aria-label="verdict"' in page
    assert "lift_cylinder.f_coulomb" in page
    assert "uncertainty of masses" in page
    assert repr(hydroopt.view(hydroopt.load(tmp_path))).startswith("View(")


def test_what_has_no_page_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ProblemError, match="a int has no page"):
        hydroopt.view(3)
    with pytest.raises(ProblemError, match="holds no estimate"):
        hydroopt.view(tmp_path)


@needs_browser
def test_sliders_move_joints_and_linkages_follow(tmp_path: Path) -> None:
    file = hydroopt.view("wheel_loader").save(tmp_path)
    with browser() as using, opened(using, file) as page:
        before = page.evaluate("hydroopt.view.pins()")
        page.locator("input[data-joint=bucket]").focus()
        page.keyboard.press("End")
        page.evaluate(SETTLED)
        after = page.evaluate("hydroopt.view.pins()")
        assert after["tilt_cylinder.rod"][0] != before["tilt_cylinder.rod"][0]
        assert all(max(abs(a - b) for a, b in zip(*ends, strict=True)) < 1e-4 for ends in after.values())
        assert page.evaluate("hydroopt.view.joints[1]") == pytest.approx(
            hydroopt.load_machine("wheel_loader").link("bucket").joint.range[1])
