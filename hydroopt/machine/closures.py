"""Which loops and couplings determine which dependent joints, and which of these follow in closed form."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

from hydroopt.machine.couplings import Coupling
from hydroopt.machine.links import Link
from hydroopt.machine.loops import Loop
from hydroopt.machine.quantity import ImpossibleError

Statement = Loop | Coupling
JOINTLY = 6
"""Up to how many loops and couplings may determine their joints only together."""


class LinearClosure(NamedTuple):
    """A coupling that determines one joint.

    Attributes:
        coupling: the statement.
        joints: the dependent joint.
        follows: the independent joints that it depends on, in the order of q.
    """

    coupling: Coupling
    joints: tuple[str]
    follows: tuple[str, ...]

    @property
    def statements(self) -> tuple[Statement, ...]:
        """What the machine file states."""
        return (self.coupling,)


class DyadClosure(NamedTuple):
    """A planar loop that determines two joints which turn, connected by rigid bars.

    Attributes:
        loop: the statement.
        first, second: its dependent joints. In a `serial` loop the second one turns on the bar of the first.
        serial: whether both stand on one side of the loop's pin.
        follows: the independent joints that both depend on, in the order of q.
    """

    loop: Loop
    first: str
    second: str
    serial: bool
    follows: tuple[str, ...]

    @property
    def joints(self) -> tuple[str, ...]:
        """Its dependent joints."""
        return self.first, self.second

    @property
    def statements(self) -> tuple[Statement, ...]:
        """What the machine file states."""
        return (self.loop,)


class SliderClosure(NamedTuple):
    """A planar loop that determines a joint which turns and one which slides: a bar's pin on a line.

    Attributes:
        loop: the statement.
        turns, slides: its dependent joints.
        carried: whether the line turns with the joint; it is the bar otherwise.
        serial: whether both stand on one side of the loop's pin.
        follows: the independent joints that both depend on, in the order of q.
    """

    loop: Loop
    turns: str
    slides: str
    carried: bool
    serial: bool
    follows: tuple[str, ...]

    @property
    def joints(self) -> tuple[str, ...]:
        """Its dependent joints."""
        return self.turns, self.slides

    @property
    def statements(self) -> tuple[Statement, ...]:
        """What the machine file states."""
        return (self.loop,)


class GeneralClosure(NamedTuple):
    """Loops and couplings that determine as many joints together as they have equations, by Newton's method.

    Attributes:
        statements: the loops and couplings.
        joints: the dependent joints, in the order of the links.
        follows: the independent joints that they depend on, in the order of q.
    """

    statements: tuple[Statement, ...]
    joints: tuple[str, ...]
    follows: tuple[str, ...]


Closure = LinearClosure | DyadClosure | SliderClosure | GeneralClosure


def _and(names: Iterable[str]) -> str:
    return " and ".join(f"'{name}'" for name in names)


def said(closure: Closure) -> str:
    """A closure by the names of its statements: ``the loop 'four_bar'``."""
    kind = "coupling" if isinstance(closure.statements[0], Coupling) else "loop"
    many = "s" * (len(closure.statements) > 1)
    return f"the {kind}{many} {_and(each.name for each in closure.statements)}"


def place(statement: Statement) -> str:
    """Place of a loop or coupling in the machine file."""
    return f"{'couplings' if isinstance(statement, Coupling) else 'loops'}[{statement.name}]"


def closures(links: Sequence[Link], loops: Sequence[Loop], couplings: Sequence[Coupling] = ()) -> tuple[Closure, ...]:
    """What determines the dependent joints of a tree of links, in an order in which each one uses those before.

    Raises:
        ImpossibleError: a loop is over- or underdetermined, or couplings stand in a circle.
    """
    follows: dict[str, tuple[str, ...]] = {}
    waiting: list[Statement] = [*couplings, *loops]
    found: list[Closure] = []
    while waiting:
        group = _determined(links, waiting, follows)
        closure = _closure(links, group, follows)
        waiting = [each for each in waiting if each not in group]
        found.append(closure)
        follows |= dict.fromkeys(closure.joints, closure.follows)
    return tuple(found)


def _determined(links: Sequence[Link], waiting: Sequence[Statement], known: Mapping[str, object]) -> list[Statement]:
    """The fewest statements that have as many equations as joints to determine."""
    unknown = [_open_joints(links, each, known) for each in waiting]
    equations = [_equations(each) for each in waiting]
    for k, (each, names) in enumerate(zip(waiting, unknown, strict=True)):
        if len(names) < equations[k]:
            raise _overdetermined(links, each, names)
    for count in range(1, min(len(waiting), JOINTLY) + 1):
        for group in combinations(range(len(waiting)), count):
            joints = {name for k in group for name in unknown[k]}
            if len(joints) == sum(equations[k] for k in group):
                return [waiting[k] for k in group]
            if len(joints) < sum(equations[k] for k in group):
                raise ImpossibleError(f"{_and(waiting[k].name for k in group)} have "
                                      f"{sum(equations[k] for k in group)} equations, but only {len(joints)} dependent "
                                      f"joints to determine, {', '.join(sorted(joints))}",
                                      "make more of their joints dependent, or remove what repeats another statement",
                                      place(waiting[group[0]]))
    raise _underdetermined(waiting, unknown)


def _equations(statement: Statement) -> int:
    return 1 if isinstance(statement, Coupling) else statement.equations


def sides(links: Sequence[Link], loop: Loop) -> tuple[list[str], list[str]]:
    """Moving joints from each end of a loop to the link that both ends hang on, those nearest to the pin first."""
    of = {link.name: link for link in links}
    chains: list[list[str]] = []
    for end in (loop.link, loop.to.link):
        chain, name = [], end
        while name in of:
            chain.append(name)
            name = of[name].parent
        chains.append(chain)
    one, other = ([name for name in chain if of[name].joint.moving] for chain in chains)
    return [name for name in one if name not in other], [name for name in other if name not in one]


def _joints(links: Sequence[Link], statement: Statement) -> tuple[str, ...]:
    """Moving joints of a loop or coupling."""
    if isinstance(statement, Coupling):
        return statement.joints
    one, other = sides(links, statement)
    return (*one[::-1], *other[::-1])


def _open_joints(links: Sequence[Link], statement: Statement, known: Mapping[str, object]) -> list[str]:
    dependent = {link.name for link in links if link.joint.dependent}
    return [joint for joint in _joints(links, statement) if joint in dependent and joint not in known]


def _overdetermined(links: Sequence[Link], statement: Statement, found: Sequence[str]) -> ImpossibleError:
    if isinstance(statement, Coupling):
        return ImpossibleError(f"the coupling '{statement.name}' has no dependent joint to determine",
                               f"make one of {', '.join(statement.joints)} dependent, which no other loop or coupling "
                               "determines", place(statement))
    others = _joints(links, statement)
    named = f"only {_and(found)}" if found else "no dependent joint"
    kind, count = statement.closed_by, {1: "one", 2: "two", 3: "three"}[statement.equations]
    return ImpossibleError(f"the loop '{statement.name}' has {named} to determine, but a {kind} determines {count}",
                           f"make {count} of {', '.join(others)} dependent" if len(others) >= statement.equations else
                           "close it over links that move relative to each other", place(statement))


def _underdetermined(waiting: Sequence[Statement], unknown: Sequence[Sequence[str]]) -> ImpossibleError:
    if all(isinstance(each, Coupling) for each in waiting):
        names = _and(each.name for each in waiting)
        return ImpossibleError(f"the {'couplings' if len(waiting) > 1 else 'coupling'} {names} cannot determine "
                               f"{', '.join(dict.fromkeys(name for each in unknown for name in each))}",
                               "let all but one of a coupling's joints move by themselves, or state what determines "
                               "them",
                               place(waiting[0]))
    loop, found = next((each, names) for each, names in zip(waiting, unknown, strict=True) if isinstance(each, Loop))
    count = {1: "one", 2: "two", 3: "three"}[loop.equations]
    return ImpossibleError(f"the loop '{loop.name}' cannot determine {len(found)} dependent joints, "
                           f"{', '.join(found)}: a {loop.closed_by} determines {count}",
                           "let the others move by themselves, or state the loops or couplings that determine them",
                           place(loop))


def _closure(links: Sequence[Link], group: Sequence[Statement], known: Mapping[str, tuple[str, ...]]) -> Closure:
    if len(group) > 1 and all(isinstance(each, Coupling) for each in group):
        names = _and(each.name for each in group)
        raise ImpossibleError(f"the couplings {names} follow each other in a circle",
                              "state each dependent joint by joints that are determined before it", place(group[0]))
    own = [joint for each in group for joint in _open_joints(links, each, known)]
    joints = tuple(link.name for link in links if link.name in own)
    moves = {name for each in group for joint in _joints(links, each) if joint not in own
             for name in known.get(joint, (joint,))}
    follows = tuple(link.name for link in links if link.name in moves)
    if not moves:
        statement = group[0]
        kind = "coupling" if isinstance(statement, Coupling) else "loop"
        raise ImpossibleError(f"nothing can move in the {kind} '{statement.name}': all of its joints are dependent or "
                              "locked", f"let one of its joints move by itself, or lock them all and remove the {kind}",
                              place(statement))
    if len(group) == 1:
        return _alone(links, group[0], own, follows) or GeneralClosure(tuple(group), joints, follows)
    return GeneralClosure(tuple(group), joints, follows)


def _alone(links: Sequence[Link], statement: Statement, own: Sequence[str],
           follows: tuple[str, ...]) -> LinearClosure | DyadClosure | SliderClosure | None:
    """The closed form of one statement; None if it has none."""
    if isinstance(statement, Coupling):
        return LinearClosure(statement, (own[0],), follows)
    chains = sides(links, statement)
    if statement.closed_by != "pin" or any(_loose(side, own) for side in chains):
        return None
    first, second = own
    serial = any(first in side and second in side for side in chains)
    slides = [link.name for link in links if link.name in own and link.joint.type == "prismatic"]
    if not slides:
        return DyadClosure(statement, first, second, serial, follows)
    if len(slides) == 2:
        return None
    turns = second if slides[0] == first else first
    return SliderClosure(statement, turns, slides[0], serial and turns == first, serial, follows)


def _loose(side: Sequence[str], own: Iterable[str]) -> bool:
    """Whether another joint lies between the dependent ones and the pin."""
    inner = [joint for joint in side if joint in own]
    return bool(inner) and any(joint not in inner for joint in side[:side.index(inner[-1])])
