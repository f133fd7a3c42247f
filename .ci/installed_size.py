"""Size of what `pip install` of the core brings, in the environment of the Python that runs this; fails above LIMIT.

pip itself, which the empty environment has already, does not count.
"""

from __future__ import annotations

import sys
from importlib import metadata
from pathlib import Path

LIMIT = 940
"""[MiB], as `du --apparent-size` counts"""
BROUGHT_ALONG = ("pip", "setuptools")


def megabytes(distribution: metadata.Distribution) -> float:
    """Size of the files of a distribution, compiled modules included."""
    files = (Path(str(distribution.locate_file(file))) for file in distribution.files or ())
    return sum(file.stat().st_size for file in files if file.is_file()) / 2**20


sizes = {each.metadata["Name"]: megabytes(each) for each in metadata.distributions()}
core = {name: size for name, size in sizes.items() if name.lower() not in BROUGHT_ALONG}
largest = sorted(core.items(), key=lambda item: -item[1])[:8]
total = sum(core.values())
print(f"core: {total:.0f} MiB installed in {len(core)} distributions, at most {LIMIT};",
      ", ".join(f"{name} {size:.0f}" for name, size in largest))
sys.exit(total > LIMIT)
