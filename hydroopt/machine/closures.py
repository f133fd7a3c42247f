"""Which loops and couplings determine which dependent joints, and which of these follow in closed form."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

from hydroopt.machine.links import Link
from hydroopt.machine.loops import Coupling, Loop, Statement
from hydroopt.machine.quantity import ImpossibleError

JOINTLY = 6
"""Up to how many loops and couplings may determine their joints only together."""


class Closure(NamedTuple):
    """Loops and couplings that determine as many joints together as they have equations.

    Attributes:
        statements: what the machine file states.
        joints: the dependent joints, in the order of the links; of a `planar` closure in that of the loop, one that
            slides last.
        follows: the independent joints that they depend on, in the order of q.
        planar: whether it is a loop by a pin with a closed form, see `hydroopt.machine.planar_loops`.
    """

    statements: tuple[Statement, ...]
    joints: tuple[str, ...]
    follows: tuple[str, ...]
    planar: bool = False

    def __str__(self) -> str:
        first, many = self.statements[0], "s" * (len(self.statements) > 1)
        return f"the {first.kind}{many} {_and(each.name for each in self.statements)}"

    @property
    def linear(self) -> bool:
        """Whether its equations are linear in its joints: those of couplings."""
        return all(isinstance(each, Coupling) for each in self.statements)


def _and(names: Iterable[str]) -> str:
    return " and ".join(f"'{name}'" for name in names)


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
    for each, names in zip(waiting, unknown, strict=True):
        if len(names) < each.equations:
            raise _overdetermined(links, each, names)
    for count in range(1, min(len(waiting), JOINTLY) + 1):
        for group in combinations(range(len(waiting)), count):
            joints, equations = {name for k in group for name in unknown[k]}, sum(waiting[k].equations for k in group)
            if len(joints) == equations:
                return [waiting[k] for k in group]
            if len(joints) < equations:
                raise ImpossibleError(f"{_and(waiting[k].name for k in group)} have {equations} equations, but only "
                                      f"{len(joints)} dependent joints to determine, {', '.join(sorted(joints))}",
                                      "make more of their joints dependent, or remove what repeats another statement",
                                      waiting[group[0]].place)
    raise _underdetermined(waiting, unknown)


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
    others = _joints(links, statement)
    if isinstance(statement, Coupling):
        return ImpossibleError(f"the coupling '{statement.name}' has no dependent joint to determine",
                               f"make one of {', '.join(others)} dependent, which no other loop or coupling "
                               "determines", statement.place)
    named = f"only {_and(found)}" if found else "no dependent joint"
    count = _in_words(statement)
    return ImpossibleError(f"the loop '{statement.name}' has {named} to determine, but a {statement.closed_by} "
                           f"determines {count}", f"make {count} of {', '.join(others)} dependent"
                           if len(others) >= statement.equations else
                           "close it over links that move relative to each other", statement.place)


def _in_words(statement: Statement) -> str:
    return ("one", "two", "three")[statement.equations - 1]


def _underdetermined(waiting: Sequence[Statement], unknown: Sequence[Sequence[str]]) -> ImpossibleError:
    loop, found = next(((each, names) for each, names in zip(waiting, unknown, strict=True) if isinstance(each, Loop)),
                       (None, ()))
    if loop is None:
        names = _and(each.name for each in waiting)
        return ImpossibleError(f"the coupling{'s' * (len(waiting) > 1)} {names} cannot determine "
                               f"{', '.join(dict.fromkeys(name for each in unknown for name in each))}",
                               "let all but one of a coupling's joints move by themselves, or state what determines "
                               "them", waiting[0].place)
    return ImpossibleError(f"the loop '{loop.name}' cannot determine {len(found)} dependent joints, "
                           f"{', '.join(found)}: a {loop.closed_by} determines {_in_words(loop)}",
                           "let the others move by themselves, or state the loops or couplings that determine them",
                           loop.place)


def _closure(links: Sequence[Link], group: Sequence[Statement], known: Mapping[str, tuple[str, ...]]) -> Closure:
    own = [joint for each in group for joint in _open_joints(links, each, known)]
    moves = {name for each in group for joint in _joints(links, each) if joint not in own
             for name in known.get(joint, (joint,))}
    found = Closure(tuple(group), tuple(link.name for link in links if link.name in own),
                    tuple(link.name for link in links if link.name in moves))
    first = group[0]
    if len(group) > 1 and found.linear:
        raise ImpossibleError(f"{found} follow each other in a circle",
                              "state each dependent joint by joints that are determined before it", first.place)
    if not moves:
        raise ImpossibleError(f"nothing can move in the {first.kind} '{first.name}': all of its joints are dependent "
                              "or locked", f"let one of its joints move by itself, or lock them all and remove the "
                              f"{first.kind}", first.place)
    slides = [joint for joint in own if next(link for link in links if link.name == joint).joint.type == "prismatic"]
    if len(group) > 1 or not isinstance(first, Loop) or first.closed_by != "pin" or len(slides) > 1 or any(
            _loose(side, own) for side in sides(links, first)):
        return found
    return found._replace(planar=True, joints=tuple(sorted(own, key=slides.count)))


def _loose(side: Sequence[str], own: Iterable[str]) -> bool:
    """Whether another joint lies between the dependent ones and the pin."""
    inner = [joint for joint in side if joint in own]
    return bool(inner) and any(joint not in inner for joint in side[:side.index(inner[-1])])
