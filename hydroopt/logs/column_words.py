"""What a column's name says of a machine's channels: part, device, quantity, chamber and axis, by `spellings.toml`.

A name is split into words; each word has one meaning or several, so that a name has readings. A channel fits a reading
that names its part and its quantity and nothing else.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property

from hydroopt.logs.unit_words import header_of, is_unit, spellings

Word = tuple[str, str]
"""A kind of word, as the tables of `spellings.toml`, and its meaning; of the kind "other" where it has none."""
Reading = frozenset[Word]
ASKED: Mapping[str, tuple[frozenset[str], frozenset[str]]] = {suffix: (frozenset(one.split()), frozenset(also.split()))
                                                              for suffix, one, also in (
    ("q", "angle position inclination", ""), ("slide", "length position", ""), ("qd", "velocity", "angle position"),
    ("qdd", "acceleration", "angle position"), ("length", "length position", ""), ("force", "force", ""),
    ("tau", "torque", "force position"), ("u", "command", ""), ("p", "pressure", ""),
    ("gyro", "gyro velocity", "angle"), ("accel", "acceleration", ""),
    ("roll", "roll", "angle"), ("pitch", "pitching inclination", "angle"))}
"""Quantities of which a channel of each suffix needs one, and those that may stand beside it."""
IMPLIED = {"rad": "q", "m": "length slide", "rad/s": "qd", "N": "force", "N*m": "tau"}
"""Suffixes whose quantity an SI unit says by itself."""
DEVICES = {"q": "joint", "qd": "joint", "qdd": "joint", "tau": "joint", "length": "cylinder", "p_head": "cylinder",
           "p_a": "motor", "p_supply": "pump", "gyro_x": "imu", "roll": "imu"}
"""The device that a part with a channel of such a suffix is."""
OF_JOINTS = frozenset({"angle", "position", "length", "pressure"})
"""Quantities that a name without a part may have."""
COUNTED = frozenset({("chambers", "a"), ("chambers", "b")} | {
    ("other", side) for side in ("left", "right", "links", "rechts")})
"""Words that tell chambers, ports or sensors apart, without saying which is which, beside numbers."""
LINKS = "sn"
"""Letters that link the parts of a compound word."""
SHORTEST = 3
"""Letters of the shortest part of a compound word."""
_FOLDED = str.maketrans(dict(zip("äöüÄÖÜß", ("ae", "oe", "ue", "Ae", "Oe", "Ue", "ss"), strict=True)))


@cache
def _meanings() -> dict[str, list[Word]]:
    """The meanings of each word, those of parts before a machine says which of its parts that is."""
    found: dict[str, list[Word]] = {}
    for kind in ("parts", "devices", "quantities", "chambers", "axes", "phrases", "numbers", "nothing"):
        for meaning, words in spellings()[kind].items():
            own = meaning if kind not in ("phrases", "nothing") else ""
            for word in (*own.split(), *words.split()) if " " not in own else words.split():
                found.setdefault(word, []).append((kind, meaning))
    return found


@dataclass(frozen=True)
class Naming:
    """What a header says.

    Attributes:
        bare: the name without its unit; `readings`: what its words may mean.
        units: that it states, several where the word for it has several meanings; `text`: that word as it stands.
    """

    bare: str
    readings: tuple[Reading, ...]
    units: tuple[str, ...]
    text: str = ""

    @property
    def is_time(self) -> bool:
        """Whether it names the time, and nothing else."""
        return self.bare == "t" or any(reading == {("quantities", "time")} for reading in self.readings)


@dataclass(frozen=True)
class _Part:
    """A part of a machine: the words of its name, those among them that a column of it has, what devices it is."""

    words: frozenset[str]
    needed: frozenset[str]
    devices: frozenset[str]


class ChannelNames:
    """The names of a machine's channels, with the SI unit of each; of `upright` joints no inclination is the angle.

    >>> names = ChannelNames({"boom.q": "rad", "boom_cylinder.p_head": "Pa", "boom_cylinder.length": "m"})
    >>> [names.fit(channel, names.naming("Ausleger Winkel (°)")) for channel in names.channels]
    [2, 0, 0]
    >>> [names.fit(channel, names.naming("Hubzylinder Druck Boden")) for channel in names.channels]
    [0, 2, 0]
    """

    def __init__(self, channels: Mapping[str, str], upright: frozenset[str] = frozenset()) -> None:
        self.channels, self.upright = channels, upright

    @cached_property
    def _parts(self) -> dict[str, _Part]:
        made = {}
        for name in dict.fromkeys(channel.rpartition(".")[0] for channel in self.channels):
            words = frozenset(_split(name))
            named = {word: [meaning for kind, meaning in _meanings().get(word, ()) if kind == "devices"]
                     for word in words}
            found = {DEVICES[suffix] for suffix in DEVICES if f"{name}.{suffix}" in self.channels}
            made[name] = _Part(words, frozenset(word for word in words if not named[word]) or words,
                               frozenset(found.union(*named.values())))
        return made

    @cached_property
    def _own(self) -> frozenset[str]:
        return frozenset().union(*(part.needed for part in self._parts.values()))

    def naming(self, header: str, group: str = "") -> Naming:
        """What a header says, in a group of columns (a sheet or topic) whose name says what the header leaves out."""
        found = header_of(header, self._own)
        if found.name == found.text and found.units:
            return Naming(found.name, (frozenset({("quantities", "time")}),), found.units, found.text)
        units, text = found.units, found.text
        if not units:  # behind a name that goes on, as in "boom_deg_raw"
            stated = [word for word in _split(found.name) if word not in self._own and is_unit(word)]
            if len(stated) == 1:
                units, text = header_of(f"name [{stated[0]}]").units, stated[0]
        readings = self._readings(found.name)
        kinds = [{kind for kind, _ in reading} for reading in readings]
        beside = [reading | {word for word in other if word[0] not in {*held, "other", "numbers"}}
                  for reading, held in zip(readings, kinds, strict=True)
                  for other in (self._readings(group) if group else ())]
        return Naming(found.name, tuple(dict.fromkeys([*readings, *beside])), units, text)

    def fit(self, channel: str, named: Naming) -> int:
        """How well a name fits a channel: 3 its very name, 2 part and quantity, 1 one of these inferred, 0 not.

        A quantity is inferred from a unit that no other channel of the part has, and an angle from an inclination.
        """
        if _split(named.bare) == _split(channel):
            return 3
        part = self._parts[channel.rpartition(".")[0]]
        return max((self._quantity(channel, reading, bool(named.units)) for reading in named.readings
                    if part.needed <= {word for kind, word in reading if kind == "parts"}), default=0)

    def fit_alone(self, named: Naming) -> str | None:
        """The channel of a name without a part, if there is but one of that quantity.

        Speeds and forces have other things than joints, such as an engine.
        """
        readings = [reading for reading in named.readings if not reading & COUNTED and not any(
            kind == "parts" or (kind == "quantities" and meaning not in OF_JOINTS) for kind, meaning in reading)]
        found = [channel for channel in self.channels
                 if any(self._quantity(channel, reading, stated=False) == 2 for reading in readings)]
        return found[0] if len(found) == 1 else None

    def may_be(self, channel: str, named: Naming) -> bool:
        """Whether a name leaves open that it is a channel's: it names part or quantity, and nothing else."""
        part = self._parts[channel.rpartition(".")[0]]
        for reading in named.readings:
            rest = frozenset(word for word in reading - COUNTED if word[0] != "numbers")
            parts = {word for kind, word in rest if kind == "parts"}
            asks = self._quantity(channel, rest, stated=False, open_end=True)
            if asks and (parts & part.needed or not parts) and (parts or asks > 1):
                return True
        return False

    def _quantity(self, channel: str, reading: Reading, stated: bool, *, open_end: bool = False) -> int:
        """How well a reading names what a channel of its part is: 2 it does, 1 its unit alone says it, 0 not.

        Args:
            stated: whether the unit is.
            open_end: whether the chamber or the axis may be left out, and the quantity: 2 it is named, 1 not.
        """
        name, _, suffix = channel.rpartition(".")
        part, si = self._parts[name], self.channels[channel]
        kind, _, which = suffix.partition("_")
        kind = "slide" if (kind, si) == ("q", "m") else kind
        if kind not in ASKED:
            return 0
        of = {each: {word for found, word in reading if found == each}
              for each in ("parts", "devices", "quantities", "chambers", "axes", "other", "numbers")}
        one, also = ASKED[kind]
        ends = of["chambers"] | of["axes"]
        if (of["other"] or of["numbers"] or not of["parts"] <= part.words or not of["devices"] <= part.devices
                or not of["quantities"] <= one | also or not ends <= {which} or (which and not ends and not open_end)):
            return 0
        found = of["quantities"] & one
        if kind == "length" and found == {"position"} and "cylinder" not in of["devices"]:
            return 0
        if found == {"inclination"} and kind == "q" and name in self.upright:
            return 0
        if found == {"inclination"} and ("imu" if kind == "pitch" else "joint") not in of["devices"]:
            return 1 + open_end
        if found or of["chambers"]:
            return 2
        return int(open_end or (stated and kind in IMPLIED.get(si, "").split() and not ends))

    def _readings(self, name: str) -> list[Reading]:
        """What the words of a name may mean together."""
        found: list[Reading] = [frozenset()]
        for word in dict.fromkeys(_split(name)):
            found = list(dict.fromkeys(one | other for one in found for other in self._alternatives(word)))
        return found

    def _alternatives(self, word: str) -> list[Reading]:
        """What one word may mean: for itself, for a part that the machine calls so, as a compound of known words."""
        made = [frozenset({("parts", word)})] if word in self._own else []
        called = any(part.needed == {word} for part in self._parts.values())
        made += [each for kind, meaning in _meanings().get(word, ()) if not (called and kind == "parts")
                 for each in self._meant(kind, meaning)]
        if not made and is_unit(word):
            made = [frozenset()]
        if not made and word.isdigit():
            made = [frozenset({("numbers", word)})]
        if not made:
            compound = next(_compounds(word, self._own), ())
            made = [frozenset()] if compound else []
            for each in compound:
                made = [one | other for one in made for other in self._alternatives(each)]
        return list(dict.fromkeys(made)) or [frozenset({("other", word)})]

    def _meant(self, kind: str, meaning: str) -> Iterator[Reading]:
        """The readings of one meaning of a word."""
        if kind == "nothing":
            yield frozenset()
        elif kind == "phrases":
            first, second = (self._alternatives(word) for word in meaning.split())
            yield from (one | other for one in first for other in second)
        elif kind != "parts":
            yield frozenset({(kind, meaning)})
        else:
            for rank in spellings()["stands_for"].get(meaning, [meaning]):
                known = [phrase for each in rank.split(", ") if (phrase := self._called(each.split()))]
                if known:
                    yield from known
                    return
            yield frozenset({("other", meaning)})

    def _called(self, words: list[str]) -> Reading | None:
        """The words of a part's name that mean these words; None where no part has them."""
        for part in self._parts.values():
            called = {word: next((own for own in sorted(part.needed) if own == word or ("parts", word) in
                                  _meanings().get(own, ())), None) for word in words}
            if all(called.values()):
                return frozenset(("parts", str(own)) for own in called.values())
        return None


def _split(name: str) -> list[str]:
    """The words of a name, without accents and in lower case; numbers are words.

    >>> _split("BoomCyl_pRod2"), _split("Löffelzylinder")
    (['boom', 'cyl', 'p', 'rod', '2'], ['loeffelzylinder'])
    """
    folded = "".join(each for each in unicodedata.normalize("NFD", name.translate(_FOLDED))
                     if not unicodedata.combining(each))
    return [part.lower() for part in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[^\W\d_A-Z]+|\d+", folded)]


def _compounds(word: str, own: frozenset[str]) -> Iterator[tuple[str, ...]]:
    """The known words that a word such as "auslegerzylinder" or "neigungswinkel" consists of."""
    for cut in range(SHORTEST, len(word) - SHORTEST + 1):
        if word[:cut] in own or word[:cut] in _meanings():
            for linked in range(1 + (word[cut] in LINKS)):
                rest = word[cut + linked:]
                if rest in own or rest in _meanings():
                    yield word[:cut], rest
                yield from ((word[:cut], *more) for more in _compounds(rest, own))
