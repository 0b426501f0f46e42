"""Programs of functions that JAX can trace, as steps of StableHLO.

JAX lowers every primitive, whatever its release calls it, to StableHLO: a closed set of operations
with a promise of compatibility, which `jax.export` relies on. Calls of LAPACK keep their names for
the same reason. So those who follow a program need rules for these operations alone.

Source: https://openxla.org/stablehlo/spec
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from problems.base.runtime import jax

#: Steps that call a function of the program, and the attribute that names it.
_CALLS = {"call": "callee", "composite": "decomposition"}


class Type(NamedTuple):
    """The shape of an array, and its numbers; of kind "O" if NumPy has no such."""

    shape: tuple[int, ...]
    dtype: np.dtype

    @property
    def size(self) -> int:
        """The number of entries."""
        return int(np.prod(self.shape))


@dataclass(frozen=True, eq=False)
class Step:
    """One operation of a program.

    Attributes
    ----------
    name
        Of StableHLO's operation; its target if it calls a library.
    given, results
        Numbers of the values that it takes and makes.
    taken, made
        Their types.
    scope
        Names that the traced function gave to this part of it (`jax.named_scope`); a follower adds
        those of the functions that call it.
    value
        Of a constant; None if it is complex.
    """

    name: str
    given: list[int]
    results: list[int]
    taken: list[Type]
    made: list[Type]
    attributes: dict[str, str]
    bodies: list[Body]
    scope: str
    value: np.ndarray | None

    def numbers(self, name: str) -> list[int]:
        """The whole numbers of an attribute; none if it is not there."""
        return _numbers(self.attributes.get(name, ""))

    def fields(self, name: str) -> dict[str, list[int]]:
        """The named numbers of an attribute; none for what is left out."""
        return _fields(self.attributes[name])

    @property
    def operation(self) -> str | None:
        """The operation that a body of this step does with its two values, if it does only one;
        "second" if it returns the second one."""
        (body,) = self.bodies
        if not body.steps and body.returned == body.parameters[1:]:
            return "second"
        if len(body.steps) != 1 or sorted(body.steps[0].given) != body.parameters[:2]:
            return None
        return body.steps[0].name


@dataclass(frozen=True, eq=False)
class Body:
    """Steps from numbered parameters to numbered results."""

    parameters: list[int]
    steps: list[Step]
    returned: list[int]

    @cached_property
    def used(self) -> set[int]:
        """Numbers of all values that it uses, those around it included."""
        inside = [body.used for step in self.steps for body in step.bodies]
        return {*self.returned, *(k for step in self.steps for k in step.given)}.union(*inside)


#: Functions by name.
Program = dict[str, Body]
#: Numbers that NumPy has, too.
_DTYPES = {
    "i1": "bool",
    "f32": "float32",
    "f64": "float64",
    "complex<f32>": "complex64",
    "complex<f64>": "complex128",
    **{f"{sign}i{bits}": f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)},
}

_T = TypeVar("_T")


def program(function: Callable, *arguments: Any) -> Program:
    """Return the functions of a traced program by name; "main" takes the leaves of all arguments.

    Parameters
    ----------
    function
        Traceable, or compiled by `jax.jit` with ``keep_unused``, which is not lowered again.
    arguments
        Arrays, or `jax.ShapeDtypeStruct`; only shapes and types matter.
    """
    jitted: Any = function if hasattr(function, "lower") else jax.jit(function, keep_unused=True)
    module: Any = jitted.lower(*arguments).compiler_ir("stablehlo")
    reader, found = _Reader(), {}
    for one in module.body.operations:
        operation = one.operation
        if operation.name == "func.func":
            found[operation.attributes["sym_name"].value] = reader.body(operation.regions[0])
    return found


class _Reader:
    """Numbers the values of a module, and reads its operations."""

    def __init__(self) -> None:
        self._numbers: dict[Any, int] = {}

    def _of(self, values: Any) -> list[int]:
        return [self._numbers.setdefault(value, len(self._numbers)) for value in values]

    def body(self, region: Any) -> Body:
        """The steps of a region, which end with what it returns."""
        (block,) = region.blocks
        parameters = self._of(block.arguments)
        *operations, last = block.operations
        steps = [self._step(one.operation) for one in operations]
        # A call of Python may have no result.
        return Body(parameters, [step for step in steps if step.made], self._of(last.operands))

    def _step(self, operation: Any) -> Step:
        name = operation.name.rpartition(".")[2]
        attributes, value = {}, None
        if name == "constant":
            try:
                given = operation.attributes["value"]
                value = np.array(given)
                if given.is_splat and value.size:  # jaxlib 0.9 reads masks past their end
                    value = np.full(value.shape, value.flat[0])
            except TypeError as error:  # MLIR's bindings read no complex numbers
                attributes["value"] = str(error)
        else:  # of releases of MLIR one gives attributes there, another one their names
            names = [getattr(one, "name", one) for one in operation.attributes]
            attributes = {one: str(operation.attributes[one]) for one in names}
        if name == "custom_call":
            name = attributes["call_target_name"].strip('"')
        taken, made = operation.operands, operation.results
        return Step(
            name,
            self._of(taken),
            self._of(made),
            [_type(str(one.type)) for one in taken],
            [_type(str(one.type)) for one in made],
            attributes,
            [self.body(region) for region in operation.regions],
            _scope(operation.location),
            value,
        )


def _scope(location: Any) -> str:
    """The name of a place in a program, or the place itself in words."""
    # JAX 0.9 has one class of locations, and crashes where one without a name is asked for it.
    named = getattr(location, "is_a_name", lambda: True)
    return str(getattr(location, "name_str", location) if named() else location)


class Follower(ABC, Generic[_T]):
    """Follows a program from its arguments to its results; a subclass says what a step makes."""

    def __init__(self, functions: Program) -> None:
        self.functions = functions

    def called(self, name: str, given: Sequence[_T], scope: str = "") -> list[_T]:
        """The results of a function of the program, called within named parts of it."""
        return self.run(self.functions[name], given, {}, scope)

    def run(
        self, body: Body, given: Sequence[_T], outer: dict[int, _T], scope: str = ""
    ) -> list[_T]:
        """The results of a body; its steps see the values around it."""
        values = outer | dict(zip(body.parameters, given, strict=True))
        for step in body.steps:
            taken, within = [values[k] for k in step.given], f"{scope}/{step.scope}"
            if step.name in _CALLS:
                callee = step.attributes[_CALLS[step.name]].strip('@"')
                found = self.called(callee, taken, f"{within}/{callee}")
            else:
                found = self.step(step, taken, values, within)
            values.update(zip(step.results, found, strict=True))
        return [values[k] for k in body.returned]

    @abstractmethod
    def step(self, step: Step, given: list[_T], values: dict[int, _T], scope: str) -> list[_T]:
        """The results of a step that calls no function.

        Parameters
        ----------
        values
            All values that the bodies of the step see.
        """


@cache
def _type(text: str) -> Type:
    """The type of a value, such as tensor<3x4xf64>."""
    text = text.removeprefix("tensor<")[:-1]
    *sizes, entry = re.split(r"(?<=\d)x", text)
    return Type(tuple(map(int, sizes)), np.dtype(_DTYPES.get(entry, object)))


@cache
def _numbers(text: str) -> list[int]:
    """Numbers of array<i64: 1, 2>, of [1, 2], or of 1 : i64."""
    return [int(one) for one in re.findall(r"(?<![\w-])-?\d+", text.partition(" : ")[0])]


@cache
def _fields(text: str) -> dict[str, list[int]]:
    """Fields of such as #stablehlo.dot<lhs_contracting_dimensions = [1], ...>."""
    pairs = re.findall(r"(\w+) = (\[[^\]]*\]|\d+)", text)
    return defaultdict(list, {name: _numbers(numbers) for name, numbers in pairs})
