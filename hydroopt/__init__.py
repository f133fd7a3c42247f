"""hydroopt calibrates hydraulically actuated manipulators: a machine and its logs in, a model with error bars out."""

from hydroopt.description import bundled, dump_machine, load_machine, read_machine
from hydroopt.driving import commands_for, drive
from hydroopt.errors import HydrooptError, IdentifiabilityError, LogError, MachineError, ProblemError, SolverError
from hydroopt.estimation.actuator import ActuatorProblem, actuator_problem
from hydroopt.estimation.actuator_estimate import ActuatorEstimate, identify_actuators
from hydroopt.estimation.calibrated import calibrated_machine
from hydroopt.estimation.calibration import Calibration, calibrate
from hydroopt.estimation.change import Change, detect_change
from hydroopt.estimation.closure import CalibrationProblem, calibration_problem
from hydroopt.estimation.estimate import Estimate
from hydroopt.estimation.friction import FrictionChoice, choose_friction, with_friction
from hydroopt.estimation.payload import Payload, payload
from hydroopt.estimation.problem import Problem, identification_problem
from hydroopt.estimation.solve import solve
from hydroopt.estimation.verdict import doubts
from hydroopt.excitation.design import design, excitation_problem
from hydroopt.machine import Machine
from hydroopt.model.build import Model
from hydroopt.model.loops import KinematicModel
from hydroopt.model.plant import Plant
from hydroopt.report.folder import save
from hydroopt.signals.conditioning import Butterworth, Fourier, SmoothingSpline
from hydroopt.signals.log import Log, read_log
from hydroopt.signals.poses import Poses, read_pose_files, read_poses
from hydroopt.signals.stream import open_log
from hydroopt.synthetic import random_trajectory, random_truth, simulate
from hydroopt.urdf import read_urdf

__all__ = [
    "ActuatorEstimate", "ActuatorProblem", "Butterworth", "Calibration", "CalibrationProblem", "Change", "Estimate",
    "Fourier", "FrictionChoice", "HydrooptError", "IdentifiabilityError", "KinematicModel", "Log", "LogError",
    "Machine", "MachineError", "Model", "Payload", "Plant", "Poses", "Problem", "ProblemError", "SmoothingSpline",
    "SolverError", "actuator_problem", "bundled", "calibrate", "calibrated_machine", "calibration_problem",
    "choose_friction", "commands_for", "design", "detect_change", "doubts", "drive", "dump_machine",
    "excitation_problem", "identification_problem", "identify_actuators", "load_machine", "open_log", "payload",
    "random_trajectory", "random_truth", "read_log", "read_machine", "read_pose_files", "read_poses", "read_urdf",
    "save", "simulate", "solve", "with_friction",
]
