"""hydroopt calibrates hydraulically actuated manipulators: a machine and its logs in, a model with error bars out."""

from hydroopt.description import bundled, dump_machine, load_machine, read_machine
from hydroopt.errors import HydrooptError, IdentifiabilityError, LogError, MachineError, ProblemError, SolverError
from hydroopt.estimation.calibrated import calibrated_machine
from hydroopt.estimation.estimate import Estimate
from hydroopt.estimation.problem import Problem, identification_problem
from hydroopt.estimation.solve import solve
from hydroopt.estimation.verdict import doubts
from hydroopt.machine import Machine
from hydroopt.model.build import Model
from hydroopt.report.folder import save
from hydroopt.signals.conditioning import Butterworth, Fourier, SmoothingSpline
from hydroopt.signals.log import Log, read_log
from hydroopt.synthetic import random_trajectory, random_truth, simulate

__all__ = [
    "Butterworth", "Estimate", "Fourier", "HydrooptError", "IdentifiabilityError", "Log", "LogError", "Machine",
    "MachineError", "Model", "Problem", "ProblemError", "SmoothingSpline", "SolverError", "bundled",
    "calibrated_machine", "doubts", "dump_machine", "identification_problem", "load_machine", "random_trajectory",
    "random_truth", "read_log", "read_machine", "save", "simulate", "solve",
]
