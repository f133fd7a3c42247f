"""The map of thesis equations in docs/architecture.md agrees with the docstrings, and these have examples."""

import doctest
import inspect
import re
from importlib import import_module
from pathlib import Path

import pytest

import hydroopt
from hydroopt.estimation.inference.problem import StatedProblem

ROOT = Path(__file__).parents[1]
DOCUMENT = (ROOT / "docs/architecture.md").read_text("utf-8")
NUMBER = r"\d\.\d+[a-z]?(?:, [a-z]\b)?"
CITATION = re.compile(rf"\bEqs?\. ({NUMBER}(?:(?:, | and | to |–|-){NUMBER})*)")


def equations(text: str) -> set[str]:
    """Numbers of the thesis's equations that a text cites, ranges written out."""
    found = set()
    for cited in CITATION.findall(" ".join(text.split())):
        for chapter, first, last in re.findall(r"(\d)\.(\d+)[a-z]?(?:(?: to |–|-)\d\.(\d+))?", cited):
            found |= {f"{chapter}.{k}" for k in range(int(first), int(last or first) + 1)}
    return found


FILES = {"hydroopt.lock", "hydroopt.toml", "hydroopt.py"}
"""Names of files, not of modules."""
CITED = {str(file.relative_to(ROOT / "hydroopt")): equations(file.read_text("utf-8"))
         for file in sorted((ROOT / "hydroopt").rglob("*.py"))}
ROWS = {row: re.findall(r"`([^`]+)`", files)
        for row, files in re.findall(r"^\| (Eq\. .*?) \| .*? \| (.*?) \|$", DOCUMENT, re.MULTILINE)}


def test_equations_are_read() -> None:
    assert equations("(Eq. 4.33, 4.61), Eqs. 3.24a, b and Eq. 4.58 to\n4.60") == {
        "4.33", "4.61", "3.24", "4.58", "4.59", "4.60"}


@pytest.mark.parametrize("row", ROWS)
def test_every_file_cites_the_equations_of_its_row(row: str) -> None:
    assert ROWS[row]
    assert not {file for file in ROWS[row] if not CITED[file] & equations(row)}
    assert equations(row) <= set().union(*(CITED[file] for file in ROWS[row]))


def test_every_cited_equation_is_in_the_map() -> None:
    mapped = set().union(*map(equations, ROWS))
    assert not {file: cited - mapped for file, cited in CITED.items() if cited - mapped}


@pytest.mark.parametrize("path", sorted(set(re.findall(r"`([\w/]+\.pyi?)`", DOCUMENT))))
def test_every_file_exists(path: str) -> None:
    assert (ROOT / "hydroopt" / path).exists() or (ROOT / path).exists()


TEXTS = [ROOT / "README.md", *(file for folder in ("docs", "studies") for ending in ("md", "py", "toml")
                               for file in sorted((ROOT / folder).rglob(f"*.{ending}")))]


def exists(dotted: str) -> bool:
    """Whether a name such as `hydroopt.model.model.Model` is a module, or what a module defines."""
    parts = dotted.split(".")
    for k in range(len(parts), 0, -1):
        try:
            found = import_module(".".join(parts[:k]))
        except ModuleNotFoundError:
            continue
        return k == len(parts) or hasattr(found, parts[k])
    return False


@pytest.mark.parametrize("file", TEXTS, ids=lambda file: str(file.relative_to(ROOT)))
def test_every_module_that_a_text_names_exists(file: Path) -> None:
    text = file.read_text("utf-8")
    places = (ROOT, ROOT / "hydroopt", file.parent)
    paths = re.findall(r"`([\w-]+/[\w/]+\.py)`", text) if file.suffix == ".md" else []
    assert not {path for path in paths if not any((place / path).exists() for place in places)}
    assert not {path for path in re.findall(r"\bhydroopt/[\w/]+\.\w+", text) if not (ROOT / path).exists()}
    assert not {name for name in re.findall(r"(?<![\w./-])hydroopt(?:\.[A-Za-z_]\w*)+", text)
                if name not in FILES and not exists(name)}


def test_it_fits_on_two_screens() -> None:
    assert len(DOCUMENT.splitlines()) <= 120


def examples() -> str:
    """What the examples of public names and their methods execute."""
    classes = [each for name in hydroopt.__all__ if inspect.isclass(each := getattr(hydroopt, name))]
    texts = [getattr(hydroopt, name).__doc__ or "" for name in hydroopt.__all__]
    texts += [inspect.getdoc(each) or "" for one in classes for each in vars(one).values()]
    return "\n".join(example.source for text in texts for example in doctest.DocTestParser().get_examples(text))


INNER = {
    "Answer": {"typed", "marked"},
    "ExcitationProblem": {"coefficients", "hung", "objective", "constraints", "slopes", "jacobian",
                          "directional_derivative", "weighted_gradient", "excess", "bounds"},
    "HydraulicProblem": {"stretches_of"},
    "StatedProblem": {"statements", "requirements", "prior_misfit"},
    "KinematicModel": {"scene_graph", "loop_sines", "place_of", "tip_in_frame"}, "Log": {"pieces", "sampled"},
    "Model": {"refuse_seals"}, "ParameterTable": {"card_tables"},
    "Plant": {"integrator", "chamber_pressures", "supply_pressure", "flow_and_contact"}}
"""Methods that solvers and pages call, not users."""


def test_every_method_that_users_call_is_in_an_example() -> None:
    used = set(re.findall(r"\.(\w+)", examples()))
    lacking = {}
    for name, one in {**{name: getattr(hydroopt, name) for name in hydroopt.__all__},
                      "StatedProblem": StatedProblem}.items():
        if inspect.isclass(one):
            methods = {method for method, value in vars(one).items() if not method.startswith("_")
                       and (inspect.isfunction(value) or isinstance(value, classmethod | staticmethod))}
            assert INNER.get(name, set()) <= methods, name
            if missing := methods - used - INNER.get(name, set()):
                lacking[name] = missing
    assert not lacking


def test_every_public_name_has_an_example() -> None:
    """Its own, which runs with the tests, or that of the function that it refers to."""
    texts = {name: inspect.getdoc(getattr(hydroopt, name)) or "" for name in hydroopt.__all__}
    own = {name for name, text in texts.items() if ">>> " in text}
    lacking = {name for name, text in texts.items() if name not in own
               and not set(re.findall(r"See `(\w+)`", text)) & own}
    assert len(texts) > 50
    assert not lacking
