"""Scenes from equations of motion that SymPy's mechanics package has derived.

The class is written as text, the same that an author would write by hand: it computes by
``jax.numpy`` and needs no SymPy any more. Gede, Peterson, Nanjangud, Moore & Hubbard (2013),
doi:10.1115/DETC2013-13470, describe the package.
"""

from __future__ import annotations

import keyword
import math
import sys
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import sympy as sm
from sympy.core.function import AppliedUndef
from sympy.physics.mechanics import KanesMethod, LagrangesMethod, dynamicsymbols

from problems import spec
from problems.initial_values import CONSISTENCY_TOLERANCE
from problems.models.starts import violation
from problems.models.sympy_text import CLASS, class_of, code_of, function_text
from problems.plain_text import said
from problems.spec import SpecError
from problems.system import MechatronicSystem

#: Time in the text of a class, and in models.
_TIME = sm.Symbol("t")
_MODELS_TIME: Any = vars(dynamicsymbols)["_t"]


def from_sympy(
    method: LagrangesMethod | KanesMethod,
    *,
    constants: Mapping[Any, Any],
    initial: Mapping[Any, Any],
    interval: tuple[float, float],
    nominal_step: float,
    name: str = "sympy_model",
    guess: Mapping[Any, Any] | None = None,
    units: Mapping[Any, str] | None = None,
) -> type[MechatronicSystem]:
    """Return the scene class of a SymPy model: M, g, Phi, and the energy where it is conserved.

    Parameters
    ----------
    method
        Lagrange's method, perhaps with ``hol_coneqs``; or Kane's with speeds u = q', perhaps with
        ``configuration_constraints``, once ``kanes_equations`` was called.
    constants
        A number for each symbol that is no coordinate: the default of a parameter of the scene.
        Symbols and specified functions of time may also be given expressions of t and of other
        constants.
    initial
        Numbers, or expressions of constants, at the start of the interval: of coordinates q1, and
        of velocities q1.diff() or speeds u1. Constraints determine those that are left out; without
        constraints these are zero.
    interval, nominal_step
        Start and end, and the largest step of a convergence study, in s.
    name
        Name of the scene, such as "four_bar"; its class is then called FourBar.
    guess
        Values near which those that are left out are looked for, in place of zero.
    units
        Units of constants and coordinates, as reports show them.

    Returns
    -------
    type
        A class that belongs to the module of the caller, to be used as it is or inherited from. Its
        attribute ``source_text`` is a Python file that defines it without SymPy.

    Raises
    ------
    SpecError
        If the model has quasi-speeds or velocity constraints, a symbol has no value or a value no
        symbol, or the initial values violate the constraints.
    """
    if isinstance(method, LagrangesMethod):
        model = _lagrange(method)
    elif isinstance(method, KanesMethod):
        model = _kane(method)
    else:
        kind = type(method).__name__
        raise SpecError(f"from_sympy takes a LagrangesMethod or a KanesMethod, not {kind}.")
    symbols = _Symbols(model, constants)
    blocks = _blocks(model, symbols)
    start = symbols.start("guess", guess or {}) | (given := symbols.start("initial", initial))
    symbols.check_use()
    units = dict(units or {})
    if unknown := units.keys() - symbols.numbers.keys() - {*model.q}:
        raise SpecError(f"units names {_listed(unknown)}: neither a constant nor a coordinate.")
    size, names = range(len(model.q)), [q.name for q in model.q]
    facts = {
        "name": name,
        "cls": "".join(part[:1].upper() + part[1:] for part in name.split("_")),
        "doc": f"A SymPy model ({type(method).__name__}); coordinates: "
        + ", ".join(f"q{k} = {q}" for k, q in enumerate(names)),
        "interval": tuple(_number("interval", t) for t in np.ravel(interval)),
        "nominal_step": _number("nominal_step", nominal_step),
        "coordinates": tuple(f"{q.name} [{units[q]}]" if q in units else q.name for q in model.q),
        "tags": ("multibody", *["constrained", "index 3"] * ("constraint" in blocks))
        + ("conservative",) * ("energy" in blocks),
        "fields": "".join(
            f"    {key.name}: float = "
            f"parameter({value!r}, {units.get(key, 'SI')!r}, {f'{key} of the model'!r})\n"
            for key, value in symbols.numbers.items()
        ),
        "blocks": "\n".join(
            function_text(block, *parts, len(names)) for block, parts in blocks.items()
        ),
    }
    for group in "qv":
        facts[group] = ", ".join(
            code_of(start.get((group, k), sm.Float(0)), "initial") for k in size
        )
        facts[f"open_{group}"] = [k for k in size if (group, k) not in given]
    if not (spec.is_name(name) and facts["cls"].isidentifier()):
        raise SpecError(f"name={name!r} is no name of a scene, such as 'four_bar'.")
    module = sys._getframe(1).f_globals.get("__name__", __name__)  # as `collections.namedtuple`
    cls = class_of(CLASS.format(**facts), facts["cls"], module)
    _check_start(cls)
    return cls


# ---- what SymPy's methods have -----------------------------------------------------------
class _Model(NamedTuple):
    """Equations in SymPy's symbols.

    ``q``, ``v``
        coordinates q(t) and their derivatives
    ``names``
        all expressions that stand for a coordinate or a velocity, with ("q" or "v", index)
    ``mass``, ``force``, ``constraint``
        M ``(n, n)``, g ``(n, 1)`` and Phi ``(nl, 1)``
    ``lagrangian``
        L where no other force acts, else None
    """

    q: list[Any]
    names: dict[Any, tuple[str, int]]
    mass: Any
    force: Any
    constraint: Any
    lagrangian: Any = None


def _names(q: Sequence[Any]) -> dict[Any, tuple[str, int]]:
    rates = {x.diff(_MODELS_TIME): ("v", k) for k, x in enumerate(q)}
    return rates | {x: ("q", k) for k, x in enumerate(q)}


def _not_supported(what: str) -> SpecError:
    """The sentence on models that need the blocks ``kinematics`` and ``velocity_constraint``: what
    `_kane` and `_lagrange` refuse by it would be two more fields of `_Model`."""
    return SpecError(
        f"{what} are not supported: a model from SymPy has speeds u = q' and holonomic constraints."
    )


def _lagrange(method: Any) -> _Model:
    if len(method.coneqs) > len(method._hol_coneqs):
        raise _not_supported("Velocity constraints (nonhol_coneqs)")
    if method.eom is None:
        method.form_lagranges_equations()
    q, n = list(method.q), len(method.q)
    no_multipliers = dict.fromkeys(method.lam_vec, 0)
    return _Model(
        q,
        _names(q),
        method.mass_matrix[:, :n],
        method.forcing[:n, :].xreplace(no_multipliers),
        method._hol_coneqs,
        None if method.forcelist else method._L[0],
    )


def _kane(method: Any) -> _Model:
    if method._udep:
        raise _not_supported("Dependent speeds and velocity constraints (u_dependent)")
    q, u, rates = list(method.q), list(method.u), method.kindiffdict()
    if {*rates.values()} != {*u}:
        raise _not_supported("Quasi-speeds (kd_eqs other than u = q')")
    order = [u.index(rates[x.diff(_MODELS_TIME)]) for x in q]
    try:
        mass, force = method.mass_matrix, method.forcing
    except ValueError:
        raise SpecError("Call kanes_equations(bodies, loads) of the KanesMethod first.") from None
    names = _names(q) | {u[k]: ("v", i) for i, k in enumerate(order)}
    return _Model(q, names, mass.extract(order, order), force.extract(order, [0]), method._f_h)


# ---- values of symbols -------------------------------------------------------------------
class _Symbols:
    """Puts the symbols of generated text in the place of the model's.

    ``numbers``
        the constants that are numbers, by the user's symbols
    """

    def __init__(self, model: _Model, constants: Mapping[Any, Any]) -> None:
        self.numbers: dict[Any, float] = {}
        self._model, self._constants, self._used = model, constants, set()
        self._specified: dict[Any, Any] = {}
        self._text = {key: sm.Symbol(f"{group}{k}") for key, (group, k) in model.names.items()}
        self._text[_MODELS_TIME] = _TIME
        for key, value in constants.items():
            if not isinstance(key, sm.Symbol | AppliedUndef) or key in self._text:
                raise SpecError(f"constants names {key}, which is no symbol of a constant.")
            value = _read(f"constants: {key}", value)
            if not value.is_number:
                self._specified[key] = value
                continue
            taken = key.name in {other.name for other in self.numbers}
            if taken or not _is_free(key.name):
                raise SpecError(f"A parameter cannot be called {key.name!r}; rename the symbol.")
            self.numbers[key] = _number(f"constants: {key}", value)
            symbol = sm.Symbol(f"self.{key.name}")
            self._text[symbol] = symbol
            if isinstance(key, sm.Symbol):
                self._text[key] = symbol
            else:  # so that its derivatives vanish
                self._specified[key] = symbol

    def written(self, where: str, value: Any) -> Any:
        """Return an expression of the model in symbols of generated text."""
        self._used |= _unknowns(value)
        for _ in self._specified:  # they may be expressions of each other
            value = value.xreplace(self._specified)
            self._used |= _unknowns(value)
        if self._specified:
            value = value.doit()
        if left := _unknowns(value) - self._text.keys():
            raise SpecError(
                f"{where} contains {_listed(left)}: neither a coordinate nor in constants; give a "
                f"number, or an expression of t."
            )
        return value.xreplace(self._text)

    def start(self, where: str, values: Mapping[Any, Any]) -> dict[tuple[str, int], Any]:
        """Return initial values by group and index, in symbols of generated text."""
        found = {}
        for key, value in values.items():
            if key not in self._model.names:
                known = _listed(self._model.names)
                raise SpecError(f"{where} names {key}: no coordinate or velocity; known: {known}.")
            value = self.written(where, _read(f"{where}: {key}", value))
            if not all(symbol.name.startswith("self.") for symbol in value.free_symbols):
                raise SpecError(f"{where}: {key} depends on a coordinate or on time; give a value.")
            if value.is_number:
                value = sm.Float(_number(f"{where}: {key}", value), 17)
            found[self._model.names[key]] = value
        return found

    def check_use(self) -> None:
        """Refuse constants that nothing contains."""
        if unused := self._constants.keys() - self._used:
            raise SpecError(f"The equations do not contain {_listed(unused)} of constants.")


def _unknowns(value: Any) -> set[Any]:
    """Symbols, functions of time and derivatives in an expression."""
    return value.free_symbols | value.atoms(AppliedUndef, sm.Derivative)


def _listed(symbols: Any) -> str:
    return ", ".join(sorted(map(str, symbols)))


def _is_free(name: str) -> bool:
    """Whether a parameter may have this name."""
    usable = spec.is_name(name) and name.isidentifier() and not keyword.iskeyword(name)
    return usable and name != "source_text" and not hasattr(MechatronicSystem, name)


def _read(where: str, value: Any) -> Any:
    try:
        return sm.sympify(value) + 0
    except (sm.SympifyError, TypeError, AttributeError) as error:
        raise SpecError(f"{where}={value!r} is no expression: {said(error)}.") from None


def _number(where: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise SpecError(f"{where}={value} is not a finite number.")
    return number


def _blocks(model: _Model, symbols: _Symbols) -> dict[str, tuple[tuple[str, ...], Any]]:
    """Arguments and values of the blocks of a scene."""
    n = range(len(model.q))
    v = [sm.Symbol(f"v{k}") for k in n]
    mass = symbols.written("The mass matrix", model.mass)
    if mass.free_symbols & {_TIME, *v}:
        raise SpecError("The mass matrix depends on time or velocities; a scene's is M(q).")
    blocks = {
        "mass": (("q",), mass),
        "force": (("q", "v", "t"), symbols.written("The force", model.force)),
    }
    moving = False
    if model.constraint:
        phi = symbols.written("The constraint", model.constraint)
        if phi.free_symbols & {*v}:
            raise _not_supported("Constraints of velocities")
        blocks["constraint"] = (("q", "t"), phi)
        moving = _TIME in phi.free_symbols
    if model.lagrangian is not None:
        lagrangian = symbols.written("The Lagrangian", model.lagrangian)
        momenta = [lagrangian.diff(rate) for rate in v]
        # Without terms that are linear in v, T is v M v / 2, and the rest the potential energy.
        linear = any(sm.expand(p.xreplace(dict.fromkeys(v, 0))) != 0 for p in momenta)
        if not (moving or linear or _TIME in lagrangian.free_symbols):
            energy = sum(p * rate for p, rate in zip(momenta, v, strict=True)) - lagrangian
            blocks["energy"] = (("q", "v"), energy)
    return blocks


def _check_start(cls: type[MechatronicSystem]) -> None:
    if fault := cls.fault():
        raise SpecError(f"{cls.name}: {fault}")
    scene = cls()
    state = scene.initial_state()
    for level, values, worst in zip("qv", state, violation(scene, state), strict=False):
        if not worst <= CONSISTENCY_TOLERANCE * max(1.0, np.abs(values).max()):
            raise SpecError(
                f"The initial {level} of {cls.name} violates the constraints by {worst:.3g}; leave "
                f"out as many values as there are constraints, or give a guess of these."
            )
