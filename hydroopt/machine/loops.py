"""Loops: pins that close a linkage beside the joints of the tree, and which joints each of them determines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from pydantic import Field

from hydroopt.machine.links import Link
from hydroopt.machine.quantity import Angle, ImpossibleError, Lengths, Name, Noun


class SharedPin(Noun):
    """A pin (3,) [m] of a link, in its frame P_i (or the base frame)."""

    link: str
    pin: Lengths


class Loop(Noun):
    """A planar loop: the far end of `link` turns about a pin of another one, which determines two dependent joints.

    The loop can be assembled in two ways. `posture` tells which: positions [rad] of the joints that the loop follows,
    and roughly where at least one of its dependent joints stands then.
    """

    name: Name
    link: str
    to: SharedPin
    posture: dict[str, Angle] = Field(min_length=1)


class Closure(NamedTuple):
    """A loop and what it determines.

    Attributes:
        loop: the loop.
        first, second: its dependent joints. In a `serial` loop the second one turns on the bar of the first.
        serial: whether both stand on one side of the loop's pin.
        follows: the independent joints that both depend on, in the order of q.
    """

    loop: Loop
    first: str
    second: str
    serial: bool
    follows: tuple[str, ...]


def closures(links: Sequence[Link], loops: Sequence[Loop]) -> tuple[Closure, ...]:
    """The loops of a tree of links in an order in which each one determines two more joints.

    Raises:
        ImpossibleError: a loop is over- or underdetermined, or its dependent joints are not connected by rigid bars.
    """
    follows: dict[str, tuple[str, ...]] = {}
    waiting, found = list(loops), []
    while waiting:
        loop = next((each for each in waiting if len(_open_joints(links, each, follows)) == 2), None)
        if loop is None:
            raise _undetermined(links, waiting[0], _open_joints(links, waiting[0], follows))
        waiting.remove(loop)
        closure = _closure(links, loop, follows)
        found.append(closure)
        follows |= dict.fromkeys((closure.first, closure.second), closure.follows)
    return tuple(found)


def _sides(links: Sequence[Link], loop: Loop) -> tuple[list[str], list[str]]:
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


def _open_joints(links: Sequence[Link], loop: Loop, known: Mapping[str, Any]) -> list[str]:
    dependent = {link.name for link in links if link.joint.dependent}
    one, other = _sides(links, loop)
    return [joint for joint in (*one[::-1], *other[::-1]) if joint in dependent and joint not in known]


def _undetermined(links: Sequence[Link], loop: Loop, found: list[str]) -> ImpossibleError:
    where = f"loops[{loop.name}]"
    if len(found) > 2:
        return ImpossibleError(f"the loop '{loop.name}' cannot determine {len(found)} dependent joints, "
                               f"{', '.join(found)}: a pin determines two",
                               "let the others move by themselves, or state the loops that determine them", where)
    others = [joint for side in _sides(links, loop) for joint in side]
    named = f"only '{found[0]}'" if found else "no dependent joint"
    return ImpossibleError(f"the loop '{loop.name}' has {named} to determine, but a pin determines two",
                           f"make two of {', '.join(others)} dependent" if len(others) > 1 else
                           "close it over links that move relative to each other", where)


def _closure(links: Sequence[Link], loop: Loop, known: Mapping[str, tuple[str, ...]]) -> Closure:
    where = f"loops[{loop.name}]"
    sides = _sides(links, loop)
    first, second = _open_joints(links, loop, known)
    for side in sides:
        inner = [joint for joint in side if joint in (first, second)]
        if inner and (loose := next((j for j in side[:side.index(inner[-1])] if j not in inner), None)):
            raise ImpossibleError(f"in the loop '{loop.name}' the joint '{loose}' lies on a bar of the dependent "
                                  f"joints '{first}' and '{second}'",
                                  "make the two joints dependent between which and the pin no other moves", where)
    moves = {name for side in sides for joint in side if joint not in (first, second)
             for name in known.get(joint, (joint,))}
    if not moves:
        raise ImpossibleError(f"nothing can move in the loop '{loop.name}': all of its joints are dependent or locked",
                              "let one of its joints move by itself, or lock them all and remove the loop", where)
    return Closure(loop, first, second, any(first in side and second in side for side in sides),
                   tuple(link.name for link in links if link.name in moves))
