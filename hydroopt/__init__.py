"""hydroopt calibrates hydraulically actuated manipulators: a machine and its logs in, a model with error bars out."""

from hydroopt.errors import HydrooptError, IdentifiabilityError, LogError, MachineError, ProblemError, SolverError
from hydroopt.estimation.dynamic.calibrated import calibrated_machine
from hydroopt.estimation.dynamic.change import Change, detect_change
from hydroopt.estimation.dynamic.diagnostics import doubts
from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.estimation.dynamic.friction_choice import FrictionChoice, choose_friction, with_friction
from hydroopt.estimation.dynamic.payload import Payload, payload
from hydroopt.estimation.dynamic.problem import IdentificationProblem, identification_problem
from hydroopt.estimation.hydraulic.estimate import HydraulicEstimate, identify_hydraulics
from hydroopt.estimation.hydraulic.problem import HydraulicProblem, hydraulic_problem
from hydroopt.estimation.kinematic.calibration import Calibration, calibrate
from hydroopt.estimation.kinematic.problem import CalibrationProblem, calibration_problem
from hydroopt.excitation.motion.design import design, excitation_problem
from hydroopt.excitation.poses.plan import PosePlan
from hydroopt.excitation.poses.problem import PoseProblem, pose_problem
from hydroopt.logs.log import Log, read_log
from hydroopt.logs.poses import Poses, read_pose_files, read_poses
from hydroopt.logs.smoothing import Butterworth, Fourier, SmoothingSpline
from hydroopt.logs.stream import open_log
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import bundled, dump_machine, load_machine, read_machine
from hydroopt.machine.urdf import read_urdf
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.report.folder import save
from hydroopt.simulation.drive_valves import commands_for, drive
from hydroopt.simulation.simulate import random_trajectory, random_truth, simulate
from hydroopt.solving import solve

__all__ = [
    "Butterworth",
    "Calibration",
    "CalibrationProblem",
    "Change",
    "Estimate",
    "Fourier",
    "FrictionChoice",
    "HydraulicEstimate",
    "HydraulicProblem",
    "HydrooptError",
    "IdentifiabilityError",
    "IdentificationProblem",
    "KinematicModel",
    "Log",
    "LogError",
    "Machine",
    "MachineError",
    "Model",
    "Payload",
    "Plant",
    "PosePlan",
    "PoseProblem",
    "Poses",
    "ProblemError",
    "SmoothingSpline",
    "SolverError",
    "bundled",
    "calibrate",
    "calibrated_machine",
    "calibration_problem",
    "choose_friction",
    "commands_for",
    "design",
    "detect_change",
    "doubts",
    "drive",
    "dump_machine",
    "excitation_problem",
    "hydraulic_problem",
    "identification_problem",
    "identify_hydraulics",
    "load_machine",
    "open_log",
    "payload",
    "pose_problem",
    "random_trajectory",
    "random_truth",
    "read_log",
    "read_machine",
    "read_pose_files",
    "read_poses",
    "read_urdf",
    "save",
    "simulate",
    "solve",
    "with_friction",
]
