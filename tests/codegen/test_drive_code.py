"""Machines for which no code is generated, and no motion designed."""

import pytest

from fixtures.drives import crane
from hydroopt.codegen.symbols import Symbols
from hydroopt.errors import ProblemError
from hydroopt.excitation.motion.basis import Fourier
from hydroopt.excitation.motion.design import excitation_problem


def test_no_code_for_several_actuators_on_a_joint() -> None:
    with pytest.raises(ProblemError, match="one measured actuator a joint"):
        Symbols(crane("swing_right"))


def test_no_motion_of_a_passive_joint_is_designed() -> None:
    with pytest.raises(ProblemError, match="'grapple' can be designed, since the joint is passive"):
        excitation_problem(crane(), Fourier(period=6.0, harmonics=2))
