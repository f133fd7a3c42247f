"""The README is short, and what the machine files in README and site say is true; `test_pages` runs them."""

import re
import tomllib
from pathlib import Path

import pytest

import hydroopt
from fixtures import documents
from hydroopt.cli.machine_facts import machine_facts

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text("utf-8")


def test_it_is_short_and_shows_one_picture() -> None:
    assert len(README.splitlines()) <= 100
    (picture,) = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", README)
    assert (ROOT / picture).stat().st_size < 200e3


def test_it_names_every_command_and_the_distribution() -> None:
    from hydroopt.cli import COMMANDS

    assert not [name for name in COMMANDS if f"`{name}`" not in README]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert f"`{project['name']}`" in README
    assert "pip install hydroopt\n" not in README


def test_links_lead_to_files() -> None:
    assert not [path for path in re.findall(r"\]\(([^)#]+)\)", README) if not (ROOT / path).exists()]


def test_python_is_short() -> None:
    (code,) = (block.text for block in documents.blocks(ROOT / "README.md") if block.language == "python")
    assert len([line for line in code.splitlines() if line.strip()]) <= 15


def test_gravity_loads_the_boom_of_the_crane_by_hand() -> None:
    """Level, by moments about the joint: 125 kg at 1.1 m on a lever arm of 0.304 m."""
    page = ROOT / "docs/tutorials/crane_by_hand.md"
    *_, text = (block.text for block in documents.blocks(page) if block.file == "crane.toml")
    machine = hydroopt.read_machine(text)
    assert machine.joints == ("boom",)
    model = hydroopt.Model(machine)
    held = model.inverse_dynamics(0, 0, 0, model.parameters.nominal)
    assert float(held) == pytest.approx(125 * 9.81 * 1.1 / 0.304, rel=2e-3)
    assert "4.4 kN" in page.read_text("utf-8")
    facts = {row["name"]: row["identifiability"] for row in machine_facts(machine)["parameters"]}
    assert (facts["boom.mc_x"], facts["boom.m"]) == ("full", "none")


def test_the_linkage_of_the_guide_is_that_of_the_bundled_machine(tmp_path: Path) -> None:
    bundled = hydroopt.load_machine("excavator_bucket")
    text = (ROOT / "models" / "excavator_bucket.toml").read_text("utf-8")
    without, count = re.subn(r"\[\[linkages\]\].*?(?=\[\[motors\]\])", "", text, flags=re.DOTALL)
    assert count == 1
    stated = next(block.text for block in documents.blocks(ROOT / "docs/how-to/linkages.md"))
    file = tmp_path / "excavator.toml"
    file.write_text(f"{without}\n{stated}", "utf-8")
    machine = hydroopt.load_machine(str(file))
    at = [0.0, 0.5, -1.0, -0.3]
    lengths = [hydroopt.Model(one).cylinder_kinematics(at, 0, 0)[0] for one in (machine, bundled)]
    assert [float(length) for length in lengths[0].nz] == pytest.approx([*map(float, lengths[1].nz)], abs=2e-3)
