"""The machine files that come with hydroopt."""

from pathlib import Path


def bundled_files() -> dict[str, Path]:
    """Files by the name of the machine: inside an installed package, or at the top level of a checkout.

    >>> bundled_files()["cat215b"].name
    'cat215b.toml'
    """
    package = Path(__file__).parents[1]
    folder = package / "models" if (package / "models").is_dir() else package.parent / "models"
    return {file.stem: file for file in sorted(folder.glob("*.toml"))}
