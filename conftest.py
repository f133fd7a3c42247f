"""What all tests share: the same values every time, docstrings in an empty folder, and tools that a test may need."""

import os
import signal
import threading
from collections.abc import Callable

import hypothesis
import pytest

from fixtures.tools import Tool

if threading.current_thread() is threading.main_thread():  # a shell lets what it starts in the background ignore Ctrl-C
    signal.signal(signal.SIGINT, signal.default_int_handler)

os.environ.setdefault("CC", "cc -O0")  # to optimise kernels takes longer than the tests use them
hypothesis.settings.register_profile("reproducible", derandomize=True, deadline=None, database=None)
hypothesis.settings.load_profile("reproducible")


def pytest_addoption(parser: pytest.Parser) -> None:
    """The option of ``make test-tools``."""
    parser.addoption("--need-tools", action="store_true", help="fail instead of skip where a tool is missing")


def pytest_itemcollected(item: pytest.Item) -> None:
    """A test whose parameter is a tool needs it."""
    if isinstance(item, pytest.Function) and hasattr(item, "callspec"):
        for tool in (value for value in item.callspec.params.values() if isinstance(value, Tool)):
            item.add_marker(pytest.mark.needs(tool))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """A test that needs what is missing is skipped, or fails with ``--need-tools``."""
    needed = [tool for mark in item.iter_markers("needs") for tool in mark.args]
    missing = [tool for tool in needed if not (tool if isinstance(tool, Tool) else Tool(tool)).there]
    if missing and item.config.getoption("--need-tools"):
        pytest.fail(f"needs {', '.join(missing)}", pytrace=False)
    if missing:
        pytest.skip(f"needs {', '.join(missing)}")


@pytest.fixture(autouse=True)
def _docstring_runs_in_an_empty_folder(request: pytest.FixtureRequest) -> None:
    if isinstance(request.node, pytest.DoctestItem):
        request.getfixturevalue("monkeypatch").chdir(request.getfixturevalue("tmp_path"))


@pytest.fixture
def in_pieces(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Sets how many samples of a log are a piece."""
    def pieces(samples: int) -> None:
        for module in ("logs.log", "logs.treatment", "estimation.dynamic.experiment"):
            monkeypatch.setattr(f"hydroopt.{module}.PIECE", samples)
    return pieces
