"""Time integrators: their contract, native methods, adapters to other libraries."""

from integrators.contract import Integrator, PreparedRun, Trajectory, Work, option
from integrators.native.algebra.step_records import Errors, Reading
from integrators.native.step.step_program import StepFunctions
from integrators.native.step_method import ErrorControl, ImplicitStepMethod, StepMethod
from integrators.resolutions import Steps, Tolerances

__all__ = [
    "ErrorControl",
    "Errors",
    "ImplicitStepMethod",
    "Integrator",
    "PreparedRun",
    "Reading",
    "StepFunctions",
    "StepMethod",
    "Steps",
    "Tolerances",
    "Trajectory",
    "Work",
    "option",
]
