"""The libraries that pages contain are those that the README of their folder names."""

import hashlib
import re
from importlib.resources import files

import pytest

VENDOR = files("hydroopt.report").joinpath("vendor")
README = VENDOR.joinpath("README.md").read_text("utf-8")
STATED = dict(re.findall(r"^\| `([\w.]+)` \|.*\| `([0-9a-f]{64})` \|$", README, re.MULTILINE))


def test_every_library_is_stated_with_its_licence() -> None:
    kept = {file.name for file in VENDOR.iterdir()}
    assert set(STATED) == {name for name in kept if name.endswith((".min.js", ".min.css"))}
    assert {f"{name}.LICENSE" for name in ("three", "uPlot")} <= kept


@pytest.mark.parametrize("name", STATED)
def test_library_is_the_stated_one(name: str) -> None:
    data = VENDOR.joinpath(name).read_bytes()
    assert hashlib.sha256(data).hexdigest() == STATED[name]
    assert b"</script" not in data
    assert b"</style" not in data
