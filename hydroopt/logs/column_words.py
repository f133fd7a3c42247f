"""What the name of a column says: the part of a machine, the quantity and the unit.

Parts are known in English and German, quantities in some more languages, units in those of `unit_words`.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection
from dataclasses import dataclass

from hydroopt.logs.unit_words import header_of

WORDS = {
    "time": ("t", "time", "zeit", "timestamp", "zeitstempel", "sec", "seconds", "clock", "uhrzeit", "datetime",
             "elapsed", "runtime", "laufzeit", "messzeit", "temps", "tiempo", "aika", "tid", "jikan"),
    "boom": ("ausleger", "hubarm", "mainboom"), "stick": ("arm", "dipper", "stiel", "loeffelstiel", "dipperstick"),
    "bucket": ("loeffel", "schaufel", "attachment"),
    "swing": ("slew", "drehwerk", "oberwagen", "schwenk", "schwenkwerk", "house", "cab"),
    "main": ("haupt",), "outer": ("knick", "aussen"),
    "lift": ("hub", "heben"), "tilt": ("kipp", "kippen"), "extension": ("ausschub", "teleskop", "telescope"),
    "cylinder": ("cyl", "zylinder", "zyl", "ram", "jack"), "motor": ("drive", "antrieb"), "pump": ("pumpe",),
    "angle": ("winkel", "ang", "q", "pos", "position", "enc", "encoder", "resolver", "theta", "phi",
              "neigung", "angulo", "kulma", "vinkel", "kakudo"),
    "velocity": ("rate", "speed", "vel", "qd", "gyro", "geschwindigkeit", "drehrate", "omega"),
    "acceleration": ("acc", "accel", "qdd", "beschleunigung"),
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
    """

    bare: str
    words: frozenset[str]
    units: tuple[str, ...]
    text: str = ""
    of_sheet: frozenset[str] = frozenset()


def naming(header: str, names: Collection[str] = ()) -> Naming:
    """The naming of a header such as ``Ausleger Winkel (°)``, ``boom_angle_deg`` or ``boom.q [rad]``.

    Args:
        names: words of a machine's parts, which no unit stands for without brackets.

    >>> found = naming("Ausleger Winkel (Grad)")
    >>> sorted(found.words), found.units
    (['angle', 'boom'], ('deg',))
    """
    found = header_of(header, names)
    words = frozenset({"time"}) if found.name == found.text and found.units else words_of(found.name)
    return Naming(found.name, words, found.units, found.text)


def words_of(name: str) -> frozenset[str]:
    """The words of a name by their meaning; numbers are words.

    >>> sorted(words_of("BoomCyl_pRod2")), sorted(words_of("Löffelzylinder"))
    (['2', 'boom', 'cylinder', 'pressure', 'rod'], ['bucket', 'cylinder'])
    """
    folded = "".join(each for each in unicodedata.normalize("NFD", name.translate(_FOLDED))
                     if not unicodedata.combining(each))
    parts = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", folded)
    return frozenset(MEANING.get(word, word) for part in parts for word in _parted(part.lower())) - ASIDE


def _parted(word: str) -> list[str]:
    """The known words that a word such as "auslegerzylinder" consists of; else itself."""
    if word not in MEANING:
        for cut in range(SHORTEST, len(word) - SHORTEST + 1):
            if word[:cut] in MEANING and (rest := _parted(word[cut:])) and all(part in MEANING for part in rest):
                return [word[:cut], *rest]
    return [word]


def may_be(channel: str, named: Naming, kind: str) -> bool:
    """Whether a header leaves open that it is a channel of an SI unit: it names part or quantity, and nothing else.

    >>> [may_be("boom_cylinder.p_head", naming(text), "Pa") for text in ("Boom bar", "Druck_A (bar)", "boom max bar")]
    [True, True, False]
    """
    part, _, suffix = channel.rpartition(".")
    own, words = words_of(part), named.words | named.of_sheet
    quantity = {IMPLIED.get(kind, ""), *QUANTITIES.get(suffix, words_of(suffix))}
    other = {word for word in named.words - own - GENERIC - quantity if not COUNTED.fullmatch(word)}
    return bool(words & quantity or words & (own - GENERIC or own)) and not other


def matched(channel: str, named: Naming, kind: str) -> int:
    """How well a header names a channel of an SI unit: 3 by its very name, 2 part and quantity, 1 its part, 0 not.

    >>> matched("boom.q", naming("Ausleger Winkel (°)"), "rad"), matched("stick.q", naming("boom.q [deg]"), "rad")
    (2, 0)
    """
    if named.bare == channel:
        return 3
    part, _, suffix = channel.rpartition(".")
    own, words = words_of(part), named.words
    needed = own - GENERIC or own
    if not needed <= words | named.of_sheet:
        return 0
    asked = QUANTITIES.get(suffix, words_of(suffix))
    rest = words - own - GENERIC - asked - {"pressure" if kind == "Pa" else ""}
    if rest:
        return 0
    if asked <= words:
        return 2
    return 1 if suffix in ("q", "length", "force", "tau", "qd") and named.units and not words - own - GENERIC else 0
