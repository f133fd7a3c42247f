"""What the name of a column says: the part of a machine, the quantity and the unit.

Parts are known in English and German, quantities in some more languages, units in those of `unit_words`.
"""

from __future__ import annotations

import itertools
import re
import unicodedata
from collections.abc import Collection, Iterator
from dataclasses import dataclass

from hydroopt.logs.unit_words import header_of

WORDS = {
    "time": ("t", "time", "zeit", "timestamp", "zeitstempel", "sec", "seconds", "clock", "uhrzeit", "datetime",
             "elapsed", "runtime", "laufzeit", "messzeit", "temps", "tiempo", "aika", "tid", "jikan"),
    "boom": ("ausleger",), "stick": ("arm", "dipper", "stiel", "loeffelstiel", "dipperstick", "crowd", "baggerstiel"),
    "bucket": ("loeffel", "tiefloeffel", "grabenloeffel", "schaufel", "attachment", "curl"),
    "swing": ("slew", "drehwerk", "oberwagen", "schwenk", "schwenkwerk", "house", "cab", "dreh", "drehkranz",
              "kransaeule", "drehsaeule", "turm"),
    "main": ("haupt",), "outer": ("aussen",), "grapple": ("greifer",), "basket": ("korb", "arbeitskorb"),
    "main arm": ("hauptausleger", "hauptarm", "hubarm", "hubausleger", "hubgeruest", "mainboom", "wipp", "wippen"),
    "outer arm": ("knick", "knickarm", "knickausleger", "knickmast"),
    "lift": ("hub", "heben"), "tilt": ("kipp", "kippen", "ankipp", "auskipp"),
    "extension": ("ausschub", "teleskop", "telescope"),
    "cylinder": ("cyl", "zylinder", "zyl", "ram", "jack"), "motor": ("drive", "antrieb"), "pump": ("pumpe",),
    "angle": ("winkel", "ang", "q", "pos", "position", "enc", "encoder", "resolver", "theta", "phi",
              "neigung", "drehwinkel", "gelenkwinkel", "angulo", "kulma", "vinkel", "kakudo"),
    "velocity": ("rate", "speed", "vel", "qd", "gyro", "geschwindigkeit", "drehrate", "drehzahl",
                 "drehgeschwindigkeit", "winkelgeschwindigkeit", "omega"),
    "acceleration": ("acc", "accel", "qdd", "beschleunigung", "winkelbeschleunigung"),
    "length": ("laenge", "len", "stroke", "weg", "travel", "ext", "displacement", "kolbenweg",
               "longueur", "longitud", "pituus", "laengd"),
    "pressure": ("druck", "p", "press", "pression", "presion", "paine", "tryck", "atsuryoku"),
    "force": ("kraft", "load", "f"),
    "torque": ("moment", "drehmoment", "tau", "effort"), "command": ("u", "cmd", "joystick", "valve", "ventil", "pwm"),
    "head": ("bore", "cap", "boden", "bodenseite", "bodenseitig", "kolben", "kolbenseite", "kolbenseitig", "piston",
             "pistonside", "base", "blind", "bottom"),
    "rod": ("ring", "ringseite", "ringseitig", "ringraum", "stange", "stangenseite", "stangenseitig", "kolbenstange",
            "kolbenstangenseite", "annulus", "gland", "rodside"),
    "supply": ("versorgung", "system"), "tank": ("return", "ruecklauf"),
    "1": ("one", "eins"), "2": ("two", "zwei"),
}
"""Words of names by the word that they mean."""
MEANING = {word: meaning for meaning, words in WORDS.items() for word in (meaning, *words)}
PARTS = {
    "lift": (("lift",), ("main boom", "main"), ("boom",)), "boom": (("boom",), ("lift",), ("main",)),
    "main": (("main",), ("boom",), ("lift",)), "main arm": (("main boom", "main"), ("boom",), ("lift",)),
    "stick": (("stick",), ("outer boom", "outer"), ("knuckle",)),
    "outer arm": (("outer boom", "outer"), ("knuckle",), ("stick",)),
    "bucket": (("bucket", "tilt"),), "tilt": (("tilt",), ("bucket",))}
"""What people call a part, and which parts of a machine that may be: the first that the machine has, of those beside
each other any. A loader's lift arm is called a boom, and a cylinder that lifts ("Hubzylinder") is an excavator's boom
cylinder."""
GENERIC = {"cylinder", "motor", "joint", "link", "axis", "imu", "sensor"}
"""Words of a part's name that a column of it need not have."""
ASIDE = {"linear", "angular", "sensor", "log", "data", "daten",
         "raw", "actual", "ist", "value", "wert", "signal", "measured", "mess", "side", "seite", "end", "port",
         "chamber", "kammer", "anschluss", "in", "of",
         "deg", "rad", "bar", "pa", "kpa", "mpa", "psi", "m", "mm", "cm", "s", "ms", "us", "ns", "n", "kn", "grad",
         "nm"}
"""Words that say nothing of part or quantity; a unit before other words is no statement of it."""
QUANTITIES = {"q": {"angle"}, "qd": {"velocity"}, "qdd": {"acceleration"}, "length": {"length"}, "force": {"force"},
              "tau": {"torque"}, "u": {"command"}, "p_head": {"head"}, "p_rod": {"rod"}, "p_a": {"a"}, "p_b": {"b"},
              "p_supply": {"supply"}, "p_tank": {"tank"}}
"""Words that a column of a channel of each suffix has."""
IMPLIED = {"rad": "angle", "m": "length", "Pa": "pressure", "rad/s": "velocity", "N": "force", "N*m": "torque"}
"""The quantity that channels of an SI unit have."""
COUNTED = re.compile("[ab]|left|right|links|rechts|[0-9]+")
"""Words that tell chambers, ports or sensors apart, without saying which is which."""
LINKS = "sn"
"""Letters that link the parts of a compound word."""
SHORTEST = 3
"""Letters of the shortest part of a compound word."""
_FOLDED = str.maketrans(dict(zip("äöüÄÖÜß", ("ae", "oe", "ue", "Ae", "Oe", "Ue", "ss"), strict=True)))


@dataclass(frozen=True)
class Naming:
    """What a header says.

    Attributes:
        bare: the name without its unit; `words`: of the name, by their meaning.
        units: that it states, several where the word for it has several meanings; `text`: that word as it stands.
        of_sheet: words of the sheet or topic, which may name the part.
        others: words with other parts of the machine that they may mean.
    """

    bare: str
    words: frozenset[str]
    units: tuple[str, ...]
    text: str = ""
    of_sheet: frozenset[str] = frozenset()
    others: tuple[frozenset[str], ...] = ()

    @property
    def readings(self) -> tuple[frozenset[str], ...]:
        """What the words may mean."""
        return (self.words, *self.others)


def naming(header: str, parts: Collection[str] = ()) -> Naming:
    """The naming of a header such as ``Ausleger Winkel (°)``, ``boom_angle_deg`` or ``boom.q [rad]``.

    Args:
        parts: names of a machine's parts: no unit stands for their words without brackets, and names that people give
            a part mean those that the machine has.

    >>> found = naming("Ausleger Winkel (Grad)")
    >>> sorted(found.words), found.units
    (['angle', 'boom'], ('deg',))
    >>> [sorted(naming("Hubzylinder Druck Boden", [part]).words) for part in ("boom_cylinder", "lift_cylinder")]
    [['boom', 'cylinder', 'head', 'pressure'], ['cylinder', 'head', 'lift', 'pressure']]
    """
    found = header_of(header, {word.lower() for part in parts for word in re.findall(r"[^\W\d_]+", part)})
    if found.name == found.text and found.units:
        return Naming(found.name, frozenset({"time"}), found.units, found.text)
    words, *others = _readings(_meanings(found.name), [words_of(part) for part in parts])
    return Naming(found.name, words, found.units, found.text, others=tuple(others))


def words_of(name: str) -> frozenset[str]:
    """The words of a name by their meaning; numbers are words.

    >>> sorted(words_of("BoomCyl_pRod2")), sorted(words_of("Löffelzylinder"))
    (['2', 'boom', 'cylinder', 'pressure', 'rod'], ['bucket', 'cylinder'])
    """
    return next(_readings(_meanings(name), ()))


def _readings(meanings: Collection[str], parts: Collection[frozenset[str]]) -> Iterator[frozenset[str]]:
    """The words that meanings stand for on a machine whose parts have these words."""
    def known(phrase: str) -> bool:
        return not parts or any(own.issuperset(phrase.split()) for own in parts)

    choices = []
    for meaning in meanings:
        ranks = PARTS.get(meaning, ((meaning,),))
        some = next((found for rank in ranks if (found := [phrase for phrase in rank if known(phrase)])), ranks[0])
        choices.append(some[:1] if not parts else some)
    for chosen in itertools.product(*choices):
        yield frozenset(word for phrase in chosen for word in phrase.split())


def _meanings(name: str) -> frozenset[str]:
    """What the words of a name mean, before a machine says which of its parts that is."""
    folded = "".join(each for each in unicodedata.normalize("NFD", name.translate(_FOLDED))
                     if not unicodedata.combining(each))
    parts = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", folded)
    return frozenset(MEANING.get(word, word) for part in parts for word in _parted(part.lower())) - ASIDE


def _parted(word: str) -> list[str]:
    """The known words that a word such as "auslegerzylinder" or "neigungswinkel" consists of; else itself."""
    if word not in MEANING:
        for cut in range(SHORTEST, len(word) - SHORTEST + 1):
            for linked in range(1 + (word[:cut] in MEANING and word[cut] in LINKS)):
                rest = _parted(word[cut + linked :])
                if word[:cut] in MEANING and all(part in MEANING for part in rest):
                    return [word[:cut], *rest]
    return [word]


def may_be(channel: str, named: Naming, kind: str) -> bool:
    """Whether a header leaves open that it is a channel of an SI unit: it names part or quantity, and nothing else.

    >>> [may_be("boom_cylinder.p_head", naming(text), "Pa") for text in ("Boom bar", "Druck_A (bar)", "boom max bar")]
    [True, True, False]
    """
    return any(_may_be(channel, reading, named.of_sheet, kind) for reading in named.readings)


def _may_be(channel: str, reading: frozenset[str], of_sheet: frozenset[str], kind: str) -> bool:
    part, _, suffix = channel.rpartition(".")
    own, words = words_of(part), reading | of_sheet
    quantity = {IMPLIED.get(kind, ""), *QUANTITIES.get(suffix, words_of(suffix))}
    other = {word for word in reading - own - GENERIC - quantity if not COUNTED.fullmatch(word)}
    return bool(words & quantity or words & (own - GENERIC or own)) and not other


def matched(channel: str, named: Naming, kind: str) -> int:
    """How well a header names a channel of an SI unit: 3 by its very name, 2 part and quantity, 1 its part, 0 not.

    >>> matched("boom.q", naming("Ausleger Winkel (°)"), "rad"), matched("stick.q", naming("boom.q [deg]"), "rad")
    (2, 0)
    """
    if named.bare == channel:
        return 3
    return max(_matched(channel, reading, named, kind) for reading in named.readings)


def _matched(channel: str, reading: frozenset[str], named: Naming, kind: str) -> int:
    part, _, suffix = channel.rpartition(".")
    own, words = words_of(part), reading
    needed = own - GENERIC or own
    if not needed <= words | named.of_sheet:
        return 0
    asked = QUANTITIES.get(suffix, words_of(suffix))
    if (suffix, kind) == ("q", "m") and "length" in words:  # a sliding joint
        asked = {"length"}
    rest = words - own - GENERIC - asked - {"pressure" if kind == "Pa" else ""}
    if rest:
        return 0
    if asked <= words:
        return 2
    return 1 if suffix in ("q", "length", "force", "tau", "qd") and named.units and not words - own - GENERIC else 0
