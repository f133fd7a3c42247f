"""Kept templates: used while they are whole and of the same source and environment."""

import stat
from pathlib import Path

import jinja2
import pytest

from hydroopt.template_cache import TemplateCache


def environment(module: Path, text: str) -> jinja2.Environment:
    return jinja2.Environment(loader=jinja2.DictLoader({"page": text}), bytecode_cache=TemplateCache(str(module)))


def test_templates_are_kept_and_made_anew_where_they_differ_or_are_damaged(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, module = tmp_path / "cache", tmp_path / "page.py"
    monkeypatch.setenv("HYDROOPT_CACHE", str(folder))
    module.write_text("autoescape = True")
    assert environment(module, "{{ x }}!").get_template("page").render(x=1) == "1!"
    (kept,) = folder.glob("*.template")
    assert stat.S_IMODE(kept.stat().st_mode) == 0o600
    first = kept.read_bytes()

    def refused(*_: object, **__: object) -> None:
        raise AssertionError("compiled again")

    with monkeypatch.context() as patched:  # what is kept is not compiled again
        patched.setattr(jinja2.Environment, "compile", refused)
        assert environment(module, "{{ x }}!").get_template("page").render(x=2) == "2!"
        with pytest.raises(AssertionError):
            environment(module, "another").get_template("page")
    assert environment(module, "{{ x }}?").get_template("page").render(x=1) == "1?"
    module.write_text("autoescape = False")
    environment(module, "{{ x }}!").get_template("page")
    made = jinja2.Environment(loader=jinja2.DictLoader({"page": "{{ x }}!"}),
                              bytecode_cache=TemplateCache(str(module), options="float"))
    made.get_template("page")
    assert len(list(folder.glob("*.template"))) == 4
    kept.write_bytes(first[:40] + b"\0" * (len(first) - 40))  # marshal would end the interpreter
    module.write_text("autoescape = True")
    assert environment(module, "{{ x }}!").get_template("page").render(x=1) == "1!"
    assert kept.read_bytes() == first


def test_where_nothing_can_be_kept_templates_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("HYDROOPT_CACHE", str(tmp_path / "file"))
    assert environment(Path(__file__), "{{ x }}").get_template("page").render(x=1) == "1"
