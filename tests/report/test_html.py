"""The report is one page that stands alone, shows everything and believes nobody's markup."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from fixtures.pages import stands_alone, text_of
from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.report.identification import render
from hydroopt.report.page import prose
from hydroopt.simulation.simulate import random_trajectory, random_truth, simulate

EVIL = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    machine = load_machine("cat215b").model_copy(update={"description": f"an excavator {EVIL}"})
    model = Model(machine)
    motions = [random_trajectory(model, duration=20.0, rate=25.0, seed=k) for k in (1, 2)]
    truth = random_truth(model, 3)
    logs = [simulate(model, motion, truth, seed=k, name=f'log "{k}" {EVIL}') for k, motion in enumerate(motions)]
    return identify(identification_problem(machine, logs[:1], logs[1:]))


@pytest.fixture(scope="module")
def page(estimate: Estimate) -> str:
    return render(estimate)


class Reader(HTMLParser):
    """Tags with their attributes, open tags in order, and text."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        if self.tags[-1:] and self.tags[-1][0] not in ("script", "style"):
            self.text.append(data)



def test_needs_nothing_from_outside(page: str) -> None:
    reader = Reader(page)
    assert not {tag for tag, _ in reader.tags} & {"link", "iframe", "object", "embed", "base", "img"}
    for tag, attributes in reader.tags:
        for name, value in attributes.items():
            if name in ("src", "href", "xlink:href", "srcset", "data", "action"):
                assert value is not None
                assert value.startswith("#"), (tag, name)
            assert not name.startswith("on")
            if not name.startswith("xmlns"):
                assert not re.match(r"\s*(https?:)?//", value or ""), (tag, name)
    assert "@import" not in text_of(page)
    assert not re.findall(r"url\((?!#)", text_of(page))


def test_the_browser_may_run_the_own_scripts_only_and_load_nothing(page: str) -> None:
    assert stands_alone(page)
    assert not stands_alone(page.replace("window.hydroopt =", "window.other ="))


def test_every_figure_says_what_it_shows_with_figures(page: str) -> None:
    texts = [a["aria-label"] for tag, a in Reader(page).tags if a.get("class") == "plot"]
    assert len(texts) == 15  # forces, and four of residuals, for each of three actuators
    assert all(text and re.search(r"\d", text) for text in texts if text and "over the workspace" not in text)
    assert any("of the variance explained" in (text or "") for text in texts)


def test_words_remain_without_scripts(page: str) -> None:
    kept = re.findall(r'<noscript><p class="small">(.*?)</p></noscript>', page, re.DOTALL)
    assert len(kept) == 16  # of every figure, and of the machine
    assert sum("of the variance explained" in words for words in kept) == 3
    assert sum(words.startswith("The machine ") for words in kept) == 1


def test_has_every_parameter_and_diagnostic(page: str, estimate: Estimate) -> None:
    text = set(Reader(page).text)
    assert set(estimate.problem.parameters.names) <= text
    for each in estimate.diagnostics:
        assert page.count(str(prose(each.text))) == 1, each.text


def test_numbers_are_shown_without_escapes(page: str) -> None:
    assert re.search("\\d\N{NARROW NO-BREAK SPACE}\\d", page)
    assert "\\u" not in text_of(page)
    assert "\\x" not in text_of(page)


def test_order_of_contents(page: str) -> None:
    titles = re.findall(r"<h2>(.*?)</h2>", page)
    assert titles == ["findings", "Fit", "Residuals", "Test of fit", "Parameters",
                      "Masses of links in all", "Base parameters", "Conditioning and weights",
                      "Data and treatment", "Method"]


def test_escapes_what_others_wrote(page: str) -> None:
    assert EVIL not in page
    assert page.count("&lt;script&gt;") >= 4  # description, two logs, doubt


def test_is_small(page: str) -> None:
    assert len(page.encode()) < 3e6


def test_figures_do_not_share_ids(page: str) -> None:
    identifiers = [a["id"] for _, a in Reader(page).tags if "id" in a]
    assert len(identifiers) == len(set(identifiers))
    used = re.findall(r'(?:url\(#|href="#)([^")]+)', page)
    assert set(used) <= set(identifiers)


@pytest.mark.slow
def test_flags_inconsistent_bodies_and_suspect_estimates(page: str, estimate: Estimate) -> None:
    assert "not physically consistent: " not in page
    assert 'role="alert"' not in page
    psi = 10 * estimate.psi
    psi[estimate.problem.parameters.index("stick.m")] = -1.0
    broken = render(replace(estimate, psi=psi))
    assert re.search(r'<td colspan="10">stick<span class="bad">not physically consistent: [^<]*−', broken)
    assert broken.count("not physically consistent: ") == 1
    assert "predicted worse than by zero" in broken
    assert 'role="alert"' in broken
    assert EVIL not in broken


@pytest.mark.slow
def test_dash_where_nothing_is_known(estimate: Estimate) -> None:
    unknown = np.full_like(estimate.std, np.nan)
    blank = render(replace(estimate, value=unknown, std=unknown, ci95=np.column_stack([unknown, unknown])))
    assert "nan" not in "".join(Reader(blank).text)
    assert blank.count('<td class="n">—</td>') >= 2 * len(unknown)
