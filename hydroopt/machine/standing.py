"""Machines that stand for another one in a job."""

from hydroopt.machine.machine import Machine


def standing_for(machine: Machine, other: Machine) -> Machine:
    """The machine itself, with the `source` of the one for which it stands, so that commands name that one.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> machine = load_machine("cat215b")
    >>> standing_for(machine.with_values({"boom.a": 5.2}), machine).source
    'cat215b'
    """
    machine.__dict__["source"] = other.source
    return machine
