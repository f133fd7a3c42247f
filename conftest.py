"""Examples in docstrings run in an empty folder, as a user's would."""

import pytest


@pytest.fixture(autouse=True)
def _example_runs_in_an_empty_folder(request: pytest.FixtureRequest) -> None:
    if isinstance(request.node, pytest.DoctestItem):
        request.getfixturevalue("monkeypatch").chdir(request.getfixturevalue("tmp_path"))
