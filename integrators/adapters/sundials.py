"""The SUNDIALS libraries inside scikit-sundae, called from this process without Python between.

scikit-sundae's own modules are linked to them, so that their functions are found through these,
whatever the files are called. Version, types and every function that is used are checked first.
"""

from __future__ import annotations

import contextlib
import ctypes
from ctypes import POINTER, byref, c_char, c_double, c_int, c_long, c_void_p
from functools import cache
from importlib import import_module
from typing import Any

from integrators.adapters.library_runs import EarlyEnd
from integrators.lowering.graph import NotLowered

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
    "IDASetId": (c_int, c_void_p, c_void_p),
    "IDASetSuppressAlg": (c_int, c_void_p, c_int),
    "IDASolve": (c_int, c_void_p, c_double, _FLOATS, c_void_p, c_void_p, c_int),
    "IDAGetNumResEvals": (c_int, c_void_p, POINTER(c_long)),
    "CVodeCreate": (c_void_p, c_int, c_void_p),
    "CVodeInit": (c_int, c_void_p, c_void_p, c_double, c_void_p),
    "CVode": (c_int, c_void_p, c_double, c_void_p, _FLOATS, c_int),
    "CVodeGetNumRhsEvals": (c_int, c_void_p, POINTER(c_long)),
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
    "GetNumJacEvals": (c_int, c_void_p, POINTER(c_long)),
    "GetNumLinSolvSetups": (c_int, c_void_p, POINTER(c_long)),
    "GetNumErrTestFails": (c_int, c_void_p, POINTER(c_long)),
    "GetNumStepSolveFails": (c_int, c_void_p, POINTER(c_long)),
    "GetNumNonlinSolvIters": (c_int, c_void_p, POINTER(c_long)),
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
    if flag < 0:
        unknown = (
            "crashed",
            f"{solver} gave up, and SUNDIALS does not tell why",
            "use another rtol or another method",
        )
        raise EarlyEnd(*_ENDINGS.get(flag, unknown))


class Library:
    """Functions of SUNDIALS by their own names, and its index type.

    Raises
    ------
    NotLowered
        If the libraries are not those that are known here.
    """

    def __init__(self) -> None:
        kinds = dict(import_module("sksundae._cy_common").config)
        if kinds.get("SUNDIALS_FLOAT_TYPE") != "double":
            raise NotLowered("SUNDIALS does not compute with 64-bit floats")
        if kinds.get("SUNDIALS_INT_TYPE") not in _INDICES:
            raise NotLowered("the index type of SUNDIALS is not known")
        self.index = _INDICES[kinds["SUNDIALS_INT_TYPE"]]
        modules = (import_module(f"sksundae._cy_{solver}") for solver in ("ida", "cvode"))
        self._libraries = [ctypes.CDLL(module.__file__) for module in modules]
        major = self._major()
        if major != _MAJOR:
            raise NotLowered(f"SUNDIALS {major} is not the release {_MAJOR} that is known")
        for name, (result, *arguments) in _SIGNATURES.items():
            function = self._function(name)
            function.restype = result
            function.argtypes = [self.index if kind is _INDEX else kind for kind in arguments]
            setattr(self, name, function)

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"{name} is not among the functions of SUNDIALS that are used here")

    def address(self, name: str) -> int:
        """The address of a function, for C."""
        return ctypes.cast(getattr(self, name), c_void_p).value or 0

    def _major(self) -> int:
        numbers, label = [c_int() for _ in range(3)], (c_char * 64)()
        version = self._function("SUNDIALSGetVersionNumber")
        version(*(byref(number) for number in numbers), label, 64)
        return numbers[0].value

    def _function(self, name: str) -> Any:
        for library in self._libraries:
            with contextlib.suppress(AttributeError):
                return getattr(library, name)
        raise NotLowered(f"SUNDIALS has no function {name}")


@cache
def library() -> Library:
    """The libraries of this process.

    Raises
    ------
    NotLowered
        If they cannot be used.
    """
    try:
        return Library()
    except (ImportError, OSError, AttributeError) as error:
        raise NotLowered(f"the libraries of scikit-sundae are not found ({error})") from error
