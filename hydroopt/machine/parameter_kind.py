"""What a number of a machine is: its kind decides how it enters, never the ending of its name."""

from __future__ import annotations

from enum import StrEnum


class ParameterKind(StrEnum):
    """The kind of a parameter; its value is the term to print.

    >>> ParameterKind.SEAL_FRICTION.is_friction, ParameterKind.GAS_PRESSURE.is_friction
    (True, False)
    >>> print(ParameterKind.FIRST_MOMENT)
    first moment
    """

    MASS = "mass"
    FIRST_MOMENT = "first moment"
    MOMENT_OF_INERTIA = "moment of inertia"
    ROTOR_INERTIA = "rotor inertia"
    COULOMB_FRICTION = "Coulomb friction"
    VISCOUS_FRICTION = "viscous friction"
    STRIBECK_FRICTION = "Stribeck friction"
    STRIBECK_SPEED = "Stribeck speed"
    SEAL_FRICTION = "seal friction"
    PIN_FRICTION = "pin friction"
    FORCE_OFFSET = "force offset"
    FORCE_GAIN = "relative error of a force reading"
    GAS_PRESSURE = "gas pressure"
    STIFFNESS = "stiffness"
    PRELOAD = "preload"

    LENGTH = "length"
    ANGLE = "angle"
    POSITION = "position"
    ORIENTATION = "orientation"
    DEAD_LENGTH = "dead length"
    COMPLIANCE = "compliance"
    RATIO = "transmission ratio"
    LOCKED_ANGLE = "locked angle"
    DRIFT = "drift"
    BIAS = "bias of a reading"
    DELAY = "delay"
    LAG = "lag of a reading"
    CLOCK_DRIFT = "relative error of a clock"

    BULK_MODULUS = "bulk modulus"
    HOSE_MODULUS = "hose modulus"
    AIR = "free air"
    RATED_FLOW = "rated flow"
    DEAD_BAND = "dead band"
    OVERLAP = "overlap"
    SPOOL_FREQUENCY = "spool frequency"
    SPOOL_DAMPING = "spool damping"
    VOLUME = "volume"
    LEAKAGE = "leakage"

    COEFFICIENT = "coefficient"
    """Of a model that a user states in CasADi: no machine file knows it."""

    @property
    def is_inertial(self) -> bool:
        """Whether it is one of the ten inertial parameters of a body (Eq. 4.12)."""
        return self in (ParameterKind.MASS, ParameterKind.FIRST_MOMENT, ParameterKind.MOMENT_OF_INERTIA)

    @property
    def is_friction(self) -> bool:
        """Whether it describes friction: of an actuator, a joint, a pin or a seal."""
        return self in (ParameterKind.COULOMB_FRICTION, ParameterKind.VISCOUS_FRICTION,
                        ParameterKind.STRIBECK_FRICTION, ParameterKind.STRIBECK_SPEED, ParameterKind.SEAL_FRICTION,
                        ParameterKind.PIN_FRICTION)

    @property
    def is_elastic(self) -> bool:
        """Whether it describes a gas-charged cylinder or a spring."""
        return self in (ParameterKind.GAS_PRESSURE, ParameterKind.STIFFNESS, ParameterKind.PRELOAD)


INERTIAL_KINDS = (ParameterKind.MASS, *[ParameterKind.FIRST_MOMENT] * 3, *[ParameterKind.MOMENT_OF_INERTIA] * 6)
"""Kinds of a body's ten inertial parameters in the order of Eq. 4.12."""
