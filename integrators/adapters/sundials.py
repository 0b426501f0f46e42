"""The SUNDIALS libraries inside scikit-sundae, called from this process without Python between.

scikit-sundae's own modules are linked to them, so that their functions are found through these,
whatever the files are called. Version, types and every function that is used are checked first.
"""

from __future__ import annotations

import ctypes
from ctypes import POINTER, byref, c_char, c_double, c_int, c_long, c_void_p
from functools import cache
from importlib import import_module
from types import SimpleNamespace
from typing import Any

from integrators.adapters.library_runs import EarlyEnd
from problems.base.spec import SpecError

#: The major release whose interface is written down here.
_MAJOR = 7
#: SUNDIALS' names of its index type.
_INDICES = {"int": ctypes.c_int32, "long int": ctypes.c_int64}
_FLOATS = POINTER(c_double)
_INDEX = "index"  # stands for the index type, which is known when the library is loaded
_SIGNATURES: dict[str, tuple[Any, ...]] = {
    # Result, arguments. Vectors, matrices and solvers are addresses.
    "SUNContext_Create": (c_int, c_int, POINTER(c_void_p)),
    "SUNContext_ClearErrHandlers": (c_int, c_void_p),
    "SUNContext_Free": (c_int, POINTER(c_void_p)),
    "N_VNew_Serial": (c_void_p, _INDEX, c_void_p),
    "N_VGetArrayPointer": (_FLOATS, c_void_p),
    "N_VDestroy": (None, c_void_p),
    "SUNDenseMatrix": (c_void_p, _INDEX, _INDEX, c_void_p),
    "SUNDenseMatrix_Data": (_FLOATS, c_void_p),
    "SUNSparseMatrix": (c_void_p, _INDEX, _INDEX, _INDEX, c_int, c_void_p),
    "SUNSparseMatrix_Data": (_FLOATS, c_void_p),
    "SUNSparseMatrix_IndexValues": (c_void_p, c_void_p),
    "SUNSparseMatrix_IndexPointers": (c_void_p, c_void_p),
    "SUNMatDestroy": (None, c_void_p),
    "SUNLinSol_Dense": (c_void_p, c_void_p, c_void_p, c_void_p),
    "SUNLinSol_SuperLUMT": (c_void_p, c_void_p, c_void_p, c_int, c_void_p),
    "SUNLinSolFree": (c_int, c_void_p),
    "IDACreate": (c_void_p, c_void_p),
    "IDAInit": (c_int, c_void_p, c_void_p, c_double, c_void_p, c_void_p),
    "IDASolve": (c_int, c_void_p, c_double, _FLOATS, c_void_p, c_void_p, c_int),
    "CVodeCreate": (c_void_p, c_int, c_void_p),
    "CVodeInit": (c_int, c_void_p, c_void_p, c_double, c_void_p),
    "CVode": (c_int, c_void_p, c_double, c_void_p, _FLOATS, c_int),
}
#: Functions that both solvers have, each with its own name before these.
_OF_BOTH: dict[str, tuple[Any, ...]] = {
    "SVtolerances": (c_int, c_void_p, c_double, c_void_p),
    "SetUserData": (c_int, c_void_p, c_void_p),
    "SetLinearSolver": (c_int, c_void_p, c_void_p, c_void_p),
    "SetJacFn": (c_int, c_void_p, c_void_p),
    "SetMaxOrd": (c_int, c_void_p, c_int),
    "SetMaxNumSteps": (c_int, c_void_p, c_long),
    "SetStopTime": (c_int, c_void_p, c_double),
    "GetLastOrder": (c_int, c_void_p, POINTER(c_int)),
    **dict.fromkeys(
        (
            *("GetNumLinSolvSetups", "GetNumErrTestFails"),
            *("GetNumStepSolveFails", "GetNumNonlinSolvIters"),
        ),
        (c_int, c_void_p, POINTER(c_long)),
    ),
    "Free": (None, POINTER(c_void_p)),
}
_SIGNATURES |= {
    solver + name: kinds for solver in ("IDA", "CVode") for name, kinds in _OF_BOTH.items()
}
_TOO_CLOSE = (
    "step_too_small",
    "the rest of the interval is as short as the rounding of the time",
    "choose another end of the interval, or events and samples farther apart",
)
#: Status, reason and perhaps remedy of the flags of IDA and CVODE; others that are negative crash.
_ENDINGS = {
    -1: ("budget_exceeded", "SUNDIALS' own limit of steps was reached"),
    -2: ("step_too_small", "the tolerances ask for more than round-off allows"),
    -3: ("step_too_small", "the error test kept failing down to the smallest step"),
    -4: ("newton_failed", "Newton's method kept failing down to the smallest step"),
    -5: ("newton_failed", "the linear solver failed"),
    -6: ("newton_failed", "the Jacobian could not be factorised"),
    -7: ("newton_failed", "the linear solver failed"),
    -8: ("diverged", "the equations could not be evaluated"),
    -27: _TOO_CLOSE,  # of CVODE
    -60: _TOO_CLOSE,  # of IDA
}


def check_step(solver: str, flag: int) -> None:
    """End the run if a step of IDA or CVODE failed."""
    unknown = f"{solver} gave up, and SUNDIALS does not tell why"
    if flag < 0:
        raise EarlyEnd(
            *_ENDINGS.get(flag, ("crashed", unknown, "use another rtol or another method"))
        )


@cache
def library() -> Any:
    """Return functions of SUNDIALS by their own names, and ``index``, its index type.

    A function but those of steps ends the run where it fails, or makes nothing.

    Raises
    ------
    SpecError
        If the libraries are not those that are known here.
    """
    try:
        kinds = dict(import_module("sksundae._cy_common").config)
        modules = (import_module(f"sksundae._cy_{solver}") for solver in ("ida", "cvode"))
        files = [ctypes.CDLL(module.__file__) for module in modules]
    except (ImportError, OSError, AttributeError) as error:
        raise SpecError(f"The libraries of scikit-sundae are not found ({error}).") from error
    number, label = c_int(), (c_char * 64)()
    rest = byref(c_int()), byref(c_int()), label, 64
    _function(files, "SUNDIALSGetVersionNumber")(byref(number), *rest)
    floats, whole = (str(kinds.get(f"SUNDIALS_{kind}_TYPE")) for kind in ("FLOAT", "INT"))
    if (number.value, floats) != (_MAJOR, "double") or whole not in _INDICES:
        raise SpecError(
            f"IDA and CVODE need SUNDIALS {_MAJOR} with 64-bit floats, and scikit-sundae has "
            f"SUNDIALS {number.value} of {floats} and {whole}."
        )
    index = _INDICES[whole]
    found = SimpleNamespace(index=index)
    for name, (result, *arguments) in _SIGNATURES.items():
        function = _function(files, name)
        function.restype = result
        function.argtypes = [index if kind is _INDEX else kind for kind in arguments]
        if name not in ("IDASolve", "CVode"):
            function.errcheck = _succeeded
        setattr(found, name, function)
    return found


def _function(files: list[ctypes.CDLL], name: str) -> Any:
    for one in files:
        if hasattr(one, name):
            return getattr(one, name)
    raise SpecError(f"SUNDIALS has no function {name}.")


def _succeeded(result: Any, function: Any, given: tuple) -> Any:
    """Return what a function of SUNDIALS gave; the run ends if it is a failure, or nothing."""
    failed = function.restype is c_void_p and not result
    if failed or (function.restype is c_int and result < 0):
        reason = f"{function.__name__} of SUNDIALS failed"
        raise EarlyEnd("crashed", reason, "use another method")
    return result
