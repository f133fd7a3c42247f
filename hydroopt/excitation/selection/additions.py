"""What could be measured that the machine file does not state: tapes between pins, and an inclinometer on a link."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from hydroopt.machine.machine import BASE, Machine
from hydroopt.machine.machine_file import dump_machine, read_machine
from hydroopt.machine.survey import TIP
from hydroopt.model.closed_chain import KinematicModel

TAPED = "3 mm"
"""Standard deviation of a tape between pins; assumed."""
MOUNTED, READ = "0.5 deg", "0.1 deg"
"""Standard deviations of an inclinometer's mounting along a link, and of its reading; assumed."""


class Addition(NamedTuple):
    """What to measure with: its name, what to do, and what to add to the machine file before.

    `once` says that its reading is the same in each posture.
    """

    name: str
    text: str
    file: str
    once: bool = False


def additions(machine: Machine) -> Iterator[Addition]:
    """Tapes between the pins of each link of uncertain length and along cylinders whose length nothing reads, and an
    inclinometer on each link that has none.

    >>> import hydroopt
    >>> [each.name for each in additions(hydroopt.load_machine("cat215b"))]
    ['pins_boom', 'inclination_boom', 'inclination_stick']
    """
    model = KinematicModel(machine)
    if not len(model.parameters):
        return
    taken = {*(each.name for each in machine.imus), *(each.name for each in machine.distances), *machine.target_names}
    for link in machine.links:
        ends = [other.name for other in machine.links if other.parent == link.name and other.joint.moving]
        own = machine.calibrator
        tip = own is not None and own.parent == link.name and not own.links
        if f"{link.name}.a" in model.parameters.names and link.parent != BASE and (ends or tip):
            points = [link.name, *ends[:1]]
            name, targets = f"pins_{link.name}", [f"pin_{each}" for each in points]
            if not {name, *targets} & taken:
                yield Addition(name, f"Tape between the pins of {link.name}", _tape(name, points, targets), once=True)
    for cylinder in machine.cylinders:
        if machine.sensor(f"{cylinder.name}.length") is None:
            yield Addition(cylinder.name, f"Tape between the pins of {cylinder.name}",
                           _sensor(f"{cylinder.name}.length", TAPED))
    units = {imu.link for imu in machine.imus}
    for link in machine.links:
        if link.joint.moving and link.parent != BASE and link.name not in units and (
                name := f"inclination_{link.name}") not in taken:
            yield Addition(name, f"Mount an inclinometer on {link.name}, and read it", _inclinometer(name, link.name))


def equipped(machine: Machine, added: Sequence[Addition]) -> Machine:
    """The machine with all that could be added."""
    if not added:
        return machine
    parts = dict.fromkeys(part for each in added for part in each.file.split("\n\n"))  # tapes share pins
    return read_machine("\n\n".join([dump_machine(machine), *parts]))


def _tape(name: str, points: list[str], targets: list[str]) -> str:
    ends = [*targets, TIP][:2]
    return "\n\n".join([*(
        f'[[targets]]\nname = "{target}"\nlink = "{link}"\nposition = ["0 m", "0 m", "0 m"]'
        for target, link in zip(targets, points, strict=True)),
        f'[[distances]]\nname = "{name}"\nbetween = ["{ends[0]}", "{ends[1]}"]', _sensor(f"{name}.length", TAPED)])


def _inclinometer(name: str, link: str) -> str:
    return "\n\n".join([
        f'[[imus]]\nname = "{name}"\nlink = "{link}"\nposition = ["0 m", "0 m", "0 m"]\norientation = {{ value = '
        f'["0 deg", "0 deg", "0 deg"], sigma = "{MOUNTED}", source = "assumed" }}\nrate = "50 Hz"',
        _sensor(f"{name}.pitch", READ)])


def _sensor(channel: str, accuracy: str) -> str:
    return f'[[sensors]]\nchannels = ["{channel}"]\naccuracy = "{accuracy}"\ndistribution = "gaussian"'
