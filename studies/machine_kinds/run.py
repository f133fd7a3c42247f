"""Machines of other kinds than a chain with one actuator a joint: whether their 95 % intervals hold."""

import tempfile

import numpy as np

from hydroopt import load_machine
from hydroopt.study.montecarlo import montecarlo
from hydroopt.study.run import run as computed
from studies.machine_kinds.swinging import KINDS, swinging

MACHINES = ("backhoe", "knuckle_boom_crane", "wheel_loader", "forestry_crane", "scissor_lift", "mini_excavator")
"""Two swing cylinders; dual link; Z-bar; chained telescope, swinging grapple; loops in a chain; bucket linkage."""
CELLS, QUICK_CELLS = 32, 4
"""Machines drawn from each file's confidences, each on a random motion of its own of 33 s; of the quick variant."""
RATE = 50.0
"""Samples per second [Hz]."""
SWINGING = ("rotator.", "sway.", "swing.")
"""What swings freely on the forestry crane, with its friction: no force is measured there."""


def run() -> dict:
    kinds = {key: value for name in MACHINES for key, value in coverage(name).items()}
    return kinds | {key: value for name in KINDS for key, value in swinging(name).items()}


def quick() -> dict:
    """A few machines of two kinds, in a few minutes."""
    return coverage("scissor_lift", QUICK_CELLS) | coverage("wheel_loader", QUICK_CELLS)


def coverage(name: str, cells: int = CELLS) -> dict:
    """Share of true parameters inside their 95 % intervals, and errors of the forces of an unseen motion."""
    machine = load_machine(name)
    with tempfile.TemporaryDirectory() as folder:
        table = computed(montecarlo(machine, cells=cells, rate=RATE), folder, workers=2)
    names = [key for key in table.results[0] if key.endswith(".inside") and not key.endswith(" in all.inside")]
    inside = np.column_stack([table.column(key) for key in names])
    shown = np.isfinite(inside).any(axis=0)
    inside, names = inside[:, shown], [key for key, kept in zip(names, shown, strict=True) if kept]
    lowest = np.nanmean(inside, axis=0)
    found = {"machines": len(inside), "intervals": len(names), "coverage": np.nanmean(inside),
             "coverage_std_error": np.std(np.nanmean(inside, axis=1), ddof=1) / np.sqrt(len(inside)),
             "lowest": lowest.min(), "lowest_of": names[int(lowest.argmin())].removesuffix(".inside"),
             "unseen_sigma_median_worst": max(np.median(table.column(f"{each.name}.rms")) for each in machine.balances)}
    free = np.array([key.startswith(SWINGING) for key in names])
    if name == "forestry_crane":
        found |= {"swinging_coverage": np.nanmean(inside[:, free]), "other_coverage": np.nanmean(inside[:, ~free])}
    return {f"{name}_{key}": value if isinstance(value, str | int) else round(float(value), 4)
            for key, value in found.items()}
