"""What installs hydroopt: the core without heavy libraries, extras for the rest, and the recipe for conda."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from importlib import metadata
from itertools import chain
from pathlib import Path

import pytest
import rattler_build
import yaml

import hydroopt as ho
from hydroopt.support.packages import DISTRIBUTION, EXTRAS, needed

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
RECIPE = yaml.safe_load((ROOT / "conda/recipe.yaml").read_text("utf-8"))
DEVELOPMENT = ("dev", "docs")
ON_CONDA = {"matplotlib": "matplotlib-base"}
PACKAGES = {"lazy_loader": "lazy-loader", "python_calamine": "python-calamine", "tomli_w": "tomli-w"}
"""Distributions whose name is not that of their module."""


def named(requirements: list[str]) -> dict[str, str]:
    """Versions by distribution; those of hydroopt itself left out."""
    found = (re.fullmatch(r"([\w.-]+)(\[.*\])?\s*(.*)", each) for each in requirements)
    return {match[1]: match[3] for match in found if match and match[1] != DISTRIBUTION}


CORE = named(PROJECT["dependencies"])
OPTIONAL = {extra: named(each) for extra, each in PROJECT["optional-dependencies"].items() if extra not in DEVELOPMENT}


def test_every_library_that_is_imported_is_installed_by_the_core_or_by_its_extra() -> None:
    nodes = [node for file in (ROOT / "hydroopt").rglob("*.py") for node in ast.walk(ast.parse(file.read_text("utf-8")))
             if isinstance(node, ast.Import | ast.ImportFrom)]
    names = {node.module.split(".")[0] for node in nodes if isinstance(node, ast.ImportFrom) and node.module
             and not node.level} | set(chain.from_iterable(
                 [alias.name.split(".")[0] for alias in node.names] for node in nodes if isinstance(node, ast.Import)))
    foreign = names - set(sys.stdlib_module_names) - {"hydroopt"}
    core = {PACKAGES.get(name, name) for name in foreign - EXTRAS.keys()}
    assert core - {"markupsafe"} == CORE.keys()  # jinja2 brings it
    assert EXTRAS.keys() <= foreign | {"mujoco", "pyarrow"}
    for library, extra in EXTRAS.items():
        assert PACKAGES.get(library, library) in OPTIONAL[extra]


def test_an_extra_holds_all_the_others() -> None:
    everything = set(chain.from_iterable(OPTIONAL.values()))
    reached, waiting = set[str](), ["all"]
    while waiting:
        extra = waiting.pop()
        reached |= OPTIONAL[extra].keys()
        for each in PROJECT["optional-dependencies"][extra]:
            waiting += re.findall(r"[\w-]+", each.partition("[")[2]) if each.startswith(DISTRIBUTION) else []
    assert reached == everything


def test_the_conda_recipe_states_what_pyproject_states() -> None:
    assert (RECIPE["package"]["name"], RECIPE["package"]["version"]) == (PROJECT["name"], PROJECT["version"])
    assert RECIPE["about"]["summary"] == PROJECT["description"]
    assert (RECIPE["about"]["license"], RECIPE["about"]["license_file"]) == (PROJECT["license"],
                                                                             PROJECT["license-files"][0])
    run = dict(each.split(" ") for each in RECIPE["requirements"]["run"])
    assert run.pop("python") == PROJECT["requires-python"]
    assert run == {ON_CONDA.get(name, name): version for name, version in CORE.items()}
    limits = dict(each.split(" ") for each in RECIPE["requirements"]["run_constraints"])
    assert limits == {name: version for each in OPTIONAL.values() for name, version in each.items()}
    scripts = [f"{name} = {target}" for name, target in PROJECT["scripts"].items()]
    assert RECIPE["build"]["python"]["entry_points"] == scripts


def test_the_conda_recipe_is_one_that_rattler_build_renders() -> None:
    text = (ROOT / "conda/recipe.yaml").read_text("utf-8")
    (found,) = rattler_build.Stage0Recipe.from_yaml(text).render(rattler_build.VariantConfig())
    assert (found.recipe.package.name, str(found.recipe.package.version)) == (PROJECT["name"], PROJECT["version"])
    with pytest.raises(rattler_build.RattlerBuildError, match="unknown field"):
        rattler_build.Stage0Recipe.from_yaml(text.replace("run_constraints", "run_constraint"))


def test_classifiers_are_those_of_the_index() -> None:
    from trove_classifiers import classifiers

    assert set(PROJECT["classifiers"]) <= classifiers
    assert f"{sys.version_info.major}.{sys.version_info.minor}" in " ".join(PROJECT["classifiers"])
    assert metadata.metadata(DISTRIBUTION)["Name"] == PROJECT["name"]


BLOCKED = f"""
import sys
class Without:
    def __init__(self, finder):
        self.finder = finder
    def __getattr__(self, name):
        return getattr(self.finder, name)
    def find_spec(self, name, path=None, target=None):
        return None if name.partition(".")[0] in {sorted(EXTRAS)!r} else self.finder.find_spec(name, path, target)
sys.meta_path[:] = map(Without, sys.meta_path)
from hydroopt.__main__ import main
sys.argv = ["hydroopt", *sys.argv[1:]]
main()
"""


def without_extras(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A command where no library of an extra is installed."""
    return subprocess.run([sys.executable, "-c", BLOCKED, *arguments], cwd=folder, capture_output=True, text=True,
                          check=False)


@pytest.mark.slow
def test_the_core_identifies_a_machine_without_any_extra(tmp_path: Path) -> None:
    made = without_extras(tmp_path, "simulate", "patu655_lift", "--duration", "10", "--seed", "1", "-o", "run")
    assert not made.returncode, made.stderr
    solved = without_extras(tmp_path, "identify", "patu655_lift", "run/log.csv", "-o", "out")
    assert not solved.returncode, solved.stderr
    assert ho.load(tmp_path / "out").parameters["lift_cylinder.f_coulomb"].value
    refused = without_extras(tmp_path, "control", "patu655_lift", "--motion", "run/log.csv", "-o", "loop")
    assert "bar cannot produce" in " ".join(refused.stderr.split())  # by the motion's forces, not for want of a library


@pytest.mark.parametrize(("library", "extra"), EXTRAS.items())
def test_a_missing_library_is_named_with_its_extra(library: str, extra: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ho.LogError, match=rf"here: x is read with it, which is not installed; run pip install "
                                          rf"'hydroopt-calibration\[{extra}\]'"):
        needed(library, "x is read with it", where="here", error=ho.LogError)


def test_parquet_names_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = ho.Log("run", [0.0, 0.1], {"boom.q": [0.0, 0.1]})
    for library in ("pyarrow", "pyarrow.parquet"):
        monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ho.LogError, match=r"\[parquet\]"):
        log.write(tmp_path / "run.parquet")
    assert not list(tmp_path.iterdir())
    log.write(tmp_path / "run.csv")
    assert ho.read_log(tmp_path / "run.csv").channels["boom.q"].tolist() == [0.0, 0.1]


def test_a_module_that_a_library_lacks_is_not_called_missing() -> None:
    with pytest.raises(ModuleNotFoundError, match="nonsense"):
        needed("json.nonsense", "x", where="here")
