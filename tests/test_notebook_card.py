"""What notebooks show of objects: short, complete as HTML, and without colours or anything from outside."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

import hydroopt as ho
from hydroopt.results.parameter_table import ParameterTable, row
from hydroopt.support.notebook_card import Card, CardTable, Shown

VOID = {"br", "meta", "img"}


class Balance(HTMLParser):
    """Which elements are open, and all text and attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text = ""
        self.attributes: list[tuple[str, str | None]] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.open.append(tag)
        self.attributes += attrs

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(scope="module")
def shown() -> dict[str, Any]:
    machine = ho.load_machine("patu655_lift")
    model, geometry = ho.Model(machine), ho.load_machine("panda_mukca")
    log = ho.simulate(model, ho.random_trajectory(model, duration=10, rate=20, seed=1), seed=1)
    problem = ho.identification_problem(model, [log])
    estimate = ho.solve(problem, "wls")
    poses = ho.Poses("hole <1>", stage=np.array(["low", "low"]), channels={"boom.q": np.array([0.1, np.nan])})
    plant = ho.Plant(model)
    t = np.arange(60) / 50
    driven = ho.drive(plant, t, 5.7 + np.cos(2 * t)[:, None], np.array([0.2]), seed=1)
    return {"machine": machine, "model": model, "log": log, "problem": problem, "estimate": estimate,
            "table": estimate.parameters, "set": model.parameters, "poses": poses, "plant": plant,
            "valves": ho.hydraulic_problem(machine, [driven]), "geometry": ho.KinematicModel(geometry),
            "plan": ho.pose_problem(geometry, 3), "sensors": ho.sensor_problem(machine, [log]),
            "recording": ho.Recording.of(log), "combined": ho.combined_problem(machine, log)}


NAMES = ("machine", "model", "log", "problem", "estimate", "table", "set", "poses", "plant", "valves", "geometry",
         "plan", "sensors", "recording", "combined")


@pytest.mark.parametrize("name", NAMES)
def test_reprs_are_short(shown: dict[str, Any], name: str) -> None:
    text = repr(shown[name])
    assert len(text.splitlines()) <= 15
    assert len(text) < 400
    assert "object at 0x" not in text


@pytest.mark.parametrize("name", NAMES)
def test_cards_are_complete_and_take_the_notebook_s_colours(shown: dict[str, Any], name: str) -> None:
    assert isinstance(shown[name], Shown)
    html = shown[name]._repr_html_()
    found = Balance(html)
    assert not found.open
    assert not re.search(r"https?:|<script|<link|url\(|background|[^-]color:|#[0-9a-fA-F]{3}", html)
    assert len(html) < 200_000


def test_the_card_of_an_estimate_holds_its_numbers(shown: dict[str, Any]) -> None:
    estimate = shown["estimate"]
    text = Balance(estimate._repr_html_()).text
    friction = estimate["lift_cylinder.f_coulomb"]
    assert f"{friction.value:.4g}"[:3] in text
    assert all(each.text in text for each in estimate.diagnostics)
    assert all(name in text for name in estimate.parameters)


def test_names_from_files_are_escaped() -> None:
    html = Card("<b>", {"a&b": "\x1b[2J"}, [CardTable(("<i>",), [("<script>",)])]).html()
    assert "<b>" not in html
    assert "<script>" not in html
    assert "\x1b" not in html
    assert "&lt;script&gt;" in Card("", tables=[CardTable((), [("<script>",)])]).html()


def test_a_parameter_says_all_that_is_known_of_it(shown: dict[str, Any]) -> None:
    estimate = shown["estimate"]
    one = estimate["lift_cylinder.f_coulomb"]
    assert (one.unit, one.identifiability, float(one)) == ("N", "full", one.value)
    assert one.ci95[0] < one.value < one.ci95[1]
    unknown = next(each for each in estimate.parameters.values() if each.value is None)
    assert np.isnan(float(unknown))
    assert "machine file states" in repr(unknown)
    with pytest.raises(ho.ProblemError, match="did you mean"):
        estimate["lift_cylinder.f_coulom"]


@pytest.mark.parametrize(("value", "std", "text"), [
    (1790.04, 12.3, "1790 ± 12"), (0.0123456, 0.00021, "0.01235 ± 0.00021"), (2.5e9, 1e7, "2.5e+09 ± 1e+07"),
    (1790.0, float("nan"), "1790"), (123456.0, 23456.0, "123000 ± 23000"), (-3.0, 1e-12, "-3 ± 1e-12")])
def test_digits_end_where_uncertainty_begins(value: float, std: float, text: str) -> None:
    assert repr(row("a.m", "mass", "kg", value=value, std=std)) == f"a.m = {text} kg"


def test_frames_hold_parameters_and_fits(shown: dict[str, Any]) -> None:
    estimate = shown["estimate"]
    frame, fits = estimate.to_frame(), estimate.fit_to_frame()
    assert frame.loc["lift_cylinder.f_coulomb", "value"] == estimate["lift_cylinder.f_coulomb"].value
    assert fits.loc[("train", "all"), "vaf"] == estimate.fit["train"]["all"].vaf
    assert ParameterTable([]).to_frame().empty


def test_figures_are_matplotlib_s_and_show_in_notebooks(shown: dict[str, Any]) -> None:
    from matplotlib.figure import Figure

    estimate = shown["estimate"]
    for draw in (estimate.plot.forces, estimate.plot.residuals, estimate.plot.parameters, estimate.plot.machine,
                 shown["machine"].plot.machine, shown["model"].plot.machine):
        figure = draw()
        assert isinstance(figure, Figure)
        assert figure._repr_svg_().startswith("<svg ")
    drawn = [line.get_ydata() for ax in estimate.plot.forces().axes for line in ax.get_lines()]
    assert max(np.nanmax(np.abs(y)) for y in drawn if len(y)) > 0


def test_what_has_no_such_figure_says_so(shown: dict[str, Any]) -> None:
    with pytest.raises(ho.ProblemError, match="a Machine has no forces to draw"):
        shown["machine"].plot.forces()
    with pytest.raises(ho.ProblemError, match="a Model has no parameters to draw"):
        shown["model"].plot.parameters()


def test_view_is_the_page_of_the_object(shown: dict[str, Any]) -> None:
    for name in ("machine", "model", "estimate"):
        page = shown[name].view()
        assert page.page == ho.view(shown[name]).page
        assert page._repr_html_().startswith("<iframe srcdoc=")


def test_long_arrays_do_not_fill_the_screen() -> None:
    motion = ho.random_trajectory("cat215b", duration=5, rate=20, seed=1)
    assert repr(motion) == "Trajectory(100 samples, 4.95 s, 3 joints)"
    angles = {"swing": [0.0, 0.3], "boom": [-0.5, -0.3], "stick": [1.4, 1.2]}
    assert repr(ho.path_difference("cat215b", "cat215b", angles, "stick")) == (
        "PathDifference(of stick: RMS 0 mm at 2 places)")


def test_load_takes_the_folder_or_its_file(shown: dict[str, Any], tmp_path: Any) -> None:
    shown["estimate"].save(tmp_path / "out")
    by_folder, by_file = ho.load(tmp_path / "out"), ho.load(tmp_path / "out/estimate.json")
    assert by_folder.parameters == by_file.parameters == shown["estimate"].parameters
    assert by_file.directory == tmp_path / "out"
    for name in ("machine.toml", "run.csv", "other.json"):
        (tmp_path / name).write_text("{}")
        with pytest.raises(ho.ProblemError, match="this file is no answer of hydroopt; name the folder"):
            ho.load(tmp_path / name)
