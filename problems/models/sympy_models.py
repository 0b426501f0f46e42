"""Scenes from equations of motion that SymPy's mechanics package has derived.

The class is written as text, the same that an author would write by hand: it computes by
``jax.numpy`` and needs no SymPy any more. Gede, Peterson, Nanjangud, Moore & Hubbard (2013),
doi:10.1115/DETC2013-13470, describe the package.
"""

from __future__ import annotations

import hashlib
import keyword
import linecache
import math
import sys
from collections.abc import Mapping
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
import sympy as sm
from sympy.core.function import AppliedUndef
from sympy.physics.mechanics import KanesMethod, LagrangesMethod, System, dynamicsymbols
from sympy.printing.numpy import JaxPrinter

from problems.base import spec
from problems.base.spec import SpecError
from problems.base.text import said
from problems.starts import CONSISTENCY_TOLERANCE, completed, constraints_at, violation
from problems.system import MechatronicSystem

#: Time in the text of a class, and in models.
_TIME, _MODELS_TIME = sm.Symbol("t"), vars(dynamicsymbols)["_t"]
#: Tags of scenes, and the blocks that they go with.
_TAGS = (
    ("multibody", "mass"), ("constrained", "constraint"), ("constrained", "velocity_constraint"),
    ("index 3", "constraint"), ("nonholonomic", "velocity_constraint"), ("conservative", "energy"),
)  # fmt: skip


def from_sympy(
    method: LagrangesMethod | KanesMethod | System,
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
        Lagrange's method, perhaps with ``hol_coneqs`` and ``nonhol_coneqs``; Kane's method, perhaps
        with ``configuration_constraints`` and ``velocity_constraints``, once ``kanes_equations``
        was called; or a `System`, once ``form_eoms`` was called.
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
        If equations do not have the form of a scene, a symbol has no value or a value no symbol, or
        the initial values violate the constraints.
    """
    own: Any = getattr(method, "eom_method", method)
    if own is None:
        raise SpecError("Call form_eoms() of the System first.")
    if not isinstance(own, LagrangesMethod | KanesMethod):
        kind = type(own).__name__
        raise SpecError(f"from_sympy takes a LagrangesMethod, KanesMethod or System, not {kind}.")
    model = _lagrange(own) if isinstance(own, LagrangesMethod) else _kane(own)
    symbols, units = _Symbols(model, constants), dict(units or {})
    blocks = _blocks(model, symbols)
    start = symbols.start("guess", guess or {}) | (given := symbols.start("initial", initial))
    if unused := constants.keys() - symbols.used:
        raise SpecError(f"The equations do not contain {_listed(unused)} of constants.")
    if unknown := units.keys() - symbols.numbers.keys() - {*model.q, *model.v}:
        raise SpecError(f"units names {_listed(unknown)}: neither a constant nor a coordinate.")
    sizes = {"q": len(model.q), "v": len(model.v)}
    named = {"coordinates": model.q} | ({"velocities": model.v} if model.kinematics else {})
    shown = {key: f" [{unit}]" for key, unit in units.items()}
    facts: dict[str, Any] = {
        "name": name,
        "cls": "".join(part[:1].upper() + part[1:] for part in name.split("_")),
        "doc": f"A SymPy model ({type(own).__name__}); coordinates: "
        + ", ".join(f"q{k} = {q.name}" for k, q in enumerate(model.q)),
        "interval": tuple(_number("interval", t) for t in np.ravel(interval)),
        "nominal_step": _number("nominal_step", nominal_step),
        "names": "".join(
            f"    {group} = {tuple(x.name + shown.get(x, '') for x in of)}\n"
            for group, of in named.items()
        ),
        "fields": "".join(
            f"    {key.name}: float = "
            f"parameter({value!r}, {units.get(key, 'SI')!r}, {f'{key} of the model'!r})\n"
            for key, value in symbols.numbers.items()
        ),
    }
    for group, size in sizes.items():
        values = (start.get((group, k), sm.Float(0)) for k in range(size))
        facts[group] = ", ".join(_code_of(value, "initial") for value in values)
        facts[f"open_{group}"] = [k for k in range(size) if (group, k) not in given]
    if not (spec.is_name(name) and facts["cls"].isidentifier()):
        raise SpecError(f"name={name!r} is no name of a scene, such as 'four_bar'.")
    module = sys._getframe(1).f_globals.get("__name__", __name__)  # as `collections.namedtuple`

    def written() -> type[MechatronicSystem]:
        tags = tuple(dict.fromkeys(tag for tag, block in _TAGS if block in blocks))
        texts = [_function_text(block, *parts, sizes) for block, parts in blocks.items()]
        text = _CLASS.format(**facts, tags=tags, blocks="\n".join(texts))
        return _class_of(text, facts["cls"], module)

    cls = written()
    _check_start(cls)
    if {"constraint", "velocity_constraint"} <= blocks.keys():
        arguments, rows = blocks.pop("velocity_constraint")
        if found := _independent(cls):
            blocks["velocity_constraint"] = arguments, rows.extract(found, [0])
        cls = written()
    return cls


# ---- what SymPy's methods have -----------------------------------------------------------
class _Model(NamedTuple):
    """Equations in SymPy's symbols.

    ``q``, ``v``
        coordinates q(t), and their derivatives or the speeds of ``kinematics``
    ``rates``
        further expressions that stand for v
    ``mass``, ``force``, ``constraint``, ``velocity_constraint``
        M ``(nv, nv)``, g ``(nv, 1)``, Phi ``(nh, 1)`` and A v - b ``(nl - nh, 1)``
    ``kinematics``
        T v ``(nq, 1)`` if v is not dq/dt, else empty
    ``lagrangian``
        L where no other force acts, else None
    """

    q: list[Any]
    v: list[Any]
    rates: list[Any]
    mass: Any
    force: Any
    constraint: Any
    velocity_constraint: Any
    kinematics: Any = ()
    lagrangian: Any = None


def _lagrange(method: Any) -> _Model:
    if method.eom is None:
        method.form_lagranges_equations()
    q, n, holonomic = list(method.q), len(method.q), method._hol_coneqs
    no_multipliers = dict.fromkeys(method.lam_vec, 0)
    mass, force = method.mass_matrix[:, :n], method.forcing[:n, :].xreplace(no_multipliers)
    further, lagrangian = method.coneqs[len(holonomic) :, :], method._L[0]
    v = [x.diff(_MODELS_TIME) for x in q]
    conserved = None if method.forcelist else lagrangian
    return _Model(q, v, [], mass, force, holonomic, further, lagrangian=conserved)


def _kane(method: Any) -> _Model:
    if not method.bodies:
        raise SpecError("Call kanes_equations(bodies, loads) of the KanesMethod first.")
    q, u, rates = list(method.q), list(method.u), method.kindiffdict()
    holonomic, further = method._f_h, method._f_nh
    if further:  # equations of dependent speeds lack the forces of constraints
        further, given = further + method._k_nh * method.u, method
        ways = [rate - value for rate, value in rates.items()]
        method = KanesMethod(method._inertial, q, u, kd_eqs=ways, u_auxiliary=method._uaux)
        method.kanes_equations(given.bodies, given.loads)
    mass, force = method.mass_matrix, method.forcing.xreplace(rates)
    own = [x.diff(_MODELS_TIME) for x in q]
    if {*rates.values()} != {*u}:
        ways = sm.Matrix([rates[rate] for rate in own])
        if ways.xreplace(dict.fromkeys(u, 0)).expand() != sm.zeros(len(q), 1):
            raise SpecError("The kd_eqs have terms without speeds; a scene has dq/dt = T(q) u.")
        return _Model(q, u, [], mass, force, holonomic, further, ways)
    order = [u.index(rates[rate]) for rate in own]
    mass, force = mass.extract(order, order), force.extract(order, [0])
    return _Model(q, [u[k] for k in order], own, mass, force, holonomic, further)


# ---- values of symbols -------------------------------------------------------------------
class _Symbols:
    """Puts the symbols of generated text in the place of the model's.

    ``numbers``
        the constants that are numbers, by the user's symbols
    ``used``
        all symbols that the model and the start contain
    """

    def __init__(self, model: _Model, constants: Mapping[Any, Any]) -> None:
        self.numbers: dict[Any, float] = {}
        self.used: set[Any] = set()
        groups = (("v", model.v), ("v", model.rates), ("q", model.q))
        self._places = {x: (group, k) for group, of in groups for k, x in enumerate(of)}
        self._text = {key: sm.Symbol(f"{group}{k}") for key, (group, k) in self._places.items()}
        self._text[_MODELS_TIME] = _TIME
        self._specified: dict[Any, Any] = {}
        for key, value in constants.items():
            if not isinstance(key, sm.Symbol | AppliedUndef) or key in self._text:
                raise SpecError(f"constants names {key}, which is no symbol of a constant.")
            value = _read(f"constants: {key}", value)
            if not value.is_number:
                self._specified[key] = value
                continue
            own, taken = key.name, {other.name for other in self.numbers} | {"source_text"}
            usable = spec.is_name(own) and own.isidentifier() and not keyword.iskeyword(own)
            if not usable or own in taken or hasattr(MechatronicSystem, own):
                raise SpecError(f"A parameter cannot be called {own!r}; rename the symbol.")
            self.numbers[key] = _number(f"constants: {key}", value)
            symbol = sm.Symbol(f"self.{own}")
            self._text[symbol] = symbol
            # In the place of a function of time it has no derivatives.
            (self._text if isinstance(key, sm.Symbol) else self._specified)[key] = symbol

    def written(self, where: str, value: Any) -> Any:
        """Return an expression of the model in symbols of generated text."""

        def unknowns() -> set[Any]:
            return value.free_symbols | value.atoms(AppliedUndef, sm.Derivative)

        self.used |= unknowns()
        for _ in self._specified:  # they may be expressions of each other
            value = value.xreplace(self._specified)
            self.used |= unknowns()
        if self._specified:
            value = value.doit()
        if left := unknowns() - self._text.keys():
            raise SpecError(
                f"{where} contains {_listed(left)}: neither a coordinate nor in constants; give a "
                f"number, or an expression of t."
            )
        return value.xreplace(self._text)

    def start(self, where: str, values: Mapping[Any, Any]) -> dict[tuple[str, int], Any]:
        """Return initial values by group and index, in symbols of generated text."""
        found = {}
        for key, value in values.items():
            if key not in self._places:
                known = _listed(self._places)
                raise SpecError(f"{where} names {key}: no coordinate or velocity; known: {known}.")
            value = self.written(where, _read(f"{where}: {key}", value))
            if not all(symbol.name.startswith("self.") for symbol in value.free_symbols):
                raise SpecError(f"{where}: {key} depends on a coordinate or on time; give a value.")
            if value.is_number:
                value = sm.Float(_number(f"{where}: {key}", value), 17)
            found[self._places[key]] = value
        return found


def _listed(symbols: Any) -> str:
    return ", ".join(sorted(map(str, symbols)))


def _read(where: str, value: Any) -> Any:
    try:
        return sm.sympify(value) + 0
    except (sm.SympifyError, TypeError, AttributeError) as error:
        raise SpecError(f"{where}={value!r} is no expression: {said(error)}.") from None


def _number(where: str, value: Any) -> float:
    number = spec.as_number(value)
    if not math.isfinite(number):
        raise SpecError(f"{where}={value} is not a finite number.")
    return number


def _blocks(model: _Model, symbols: _Symbols) -> dict[str, tuple[tuple[str, ...], Any]]:
    """Arguments and values of the blocks of a scene."""
    v = [sm.Symbol(f"v{k}") for k in range(len(model.v))]
    still = dict.fromkeys(v, 0)
    mass = symbols.written("The mass matrix", model.mass)
    if mass.free_symbols & {_TIME, *v}:
        raise SpecError("The mass matrix depends on time or velocities; a scene's is M(q).")
    blocks = {
        "mass": (("q",), mass),
        "force": (("q", "v", "t"), symbols.written("The force", model.force)),
    }
    working = False  # whether constraints move bodies
    if model.constraint:
        phi = symbols.written("The constraint", model.constraint)
        if phi.free_symbols & {*v}:
            raise SpecError(
                "The holonomic constraints contain velocities; give these as nonhol_coneqs of "
                "Lagrange's method, or as velocity_constraints of Kane's."
            )
        blocks["constraint"] = (("q", "t"), phi)
        working = _TIME in phi.free_symbols
    if model.velocity_constraint:
        rows = symbols.written("The velocity constraint", model.velocity_constraint)
        if rows.jacobian(v).expand().free_symbols & {*v}:
            raise SpecError("The velocity constraints are not linear in velocities: A v = b.")
        blocks["velocity_constraint"] = (("q", "v", "t"), rows)
        working |= any(row != 0 for row in rows.xreplace(still).expand())
    if model.kinematics:
        blocks["kinematics"] = (("q", "v"), symbols.written("The kd_eqs", model.kinematics))
    if model.lagrangian is not None:
        lagrangian = symbols.written("The Lagrangian", model.lagrangian)
        momenta = [lagrangian.diff(rate) for rate in v]
        # Without terms that are linear in v, T is v M v / 2, and the rest the potential energy.
        linear = any(sm.expand(p.xreplace(still)) != 0 for p in momenta)
        if not (working or linear or _TIME in lagrangian.free_symbols):
            energy = sum(p * rate for p, rate in zip(momenta, v, strict=True)) - lagrangian
            blocks["energy"] = (("q", "v"), energy)
    return blocks


# ---- its constraints at the start ----------------------------------------------------------
def _check_start(cls: type[MechatronicSystem]) -> None:
    if fault := cls.fault():
        raise SpecError(f"{cls.name}: {fault}")
    scene = cls()
    for level, worst in zip("qv", violation(scene, scene.initial_state()), strict=True):
        if not worst <= CONSISTENCY_TOLERANCE:
            raise SpecError(
                f"The initial {level} of {cls.name} violates the constraints by {worst:.3g}; leave "
                f"out as many values as there are constraints, or give a guess of these."
            )


def _independent(cls: type[MechatronicSystem]) -> list[int]:
    """The velocity constraints that do not follow from Phi = 0 and those before them.

    Kane's method wants the rates of Phi among them. The rank shows it, at a random position near
    the start, as the start may be a special one.
    """
    scene = cls()
    q, v, _ = scene.initial_state()
    near = q + np.random.default_rng(0).uniform(-0.01, 0.01, len(q))
    near = completed(scene, near, v, range(len(q)), []).q
    phi, _, _, rows = constraints_at(scene, near, v, scene.interval[0])
    rows = rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-300)
    kept = [*range(len(phi))]  # perhaps redundant themselves
    for k in range(len(phi), len(rows)):
        before, after = (np.linalg.matrix_rank(rows[e], tol=1e-7) for e in (kept, [*kept, k]))
        kept += [k] * int(after > before)
    return [k - len(phi) for k in kept[len(phi) :]]


# ---- text: plain jax.numpy, which needs no SymPy ---------------------------------------
#: Coordinates are q0, q1 ..., velocities v0, v1 ..., constants self.NAME, time is t.
_CLASS = '''\
"""The scene {name}, written by `problems.from_sympy`."""

from dataclasses import dataclass

from problems import MechatronicSystem, completed, jnp, parameter


@dataclass(frozen=True)
class {cls}(MechatronicSystem):
    {doc!r}

    name = {name!r}
    interval = {interval!r}
    nominal_step = {nominal_step!r}
{names}    tags = {tags!r}

{fields}
{blocks}
    def initial_state(self):
        q = [{q}]
        v = [{v}]
        return completed(self, q, v, open_q={open_q}, open_v={open_v})
'''


class _Printer(JaxPrinter):
    """SymPy's text for jax.numpy, with short numbers, whole powers, and extremes in pairs."""

    def _print_Pow(self, expr: Any, rational: bool = False) -> str:  # noqa: N802
        return self._hprint_Pow(expr, rational=rational, sqrt="jax.numpy.sqrt")

    def _print_Float(self, expr: Any) -> str:  # noqa: N802
        return repr(float(expr))

    def _print_Min(self, expr: Any) -> str:  # noqa: N802
        return reduce("jax.numpy.minimum({}, {})".format, map(self._print, expr.args))

    def _print_Max(self, expr: Any) -> str:  # noqa: N802
        return reduce("jax.numpy.maximum({}, {})".format, map(self._print, expr.args))


def _code_of(value: Any, where: str) -> str:
    """The text of an expression; ``where`` begins the sentence on what cannot be written."""
    printer = _Printer()
    try:
        text = str(printer.doprint(value))
    except NotImplementedError as error:
        raise SpecError(f"{where} cannot be written in jax.numpy: {said(error)}.") from None
    imports = printer.module_imports.items()
    if others := {n for module, names in imports for n in names if module[:3] != "jax"}:
        raise SpecError(
            f"{where} contains {', '.join(sorted(others))}, which jax.numpy does not have."
        )
    return text.replace("jax.numpy.", "jnp.")


def _function_text(
    block: str, arguments: tuple[str, ...], value: Any, sizes: dict[str, int]
) -> str:
    """The text of a block: names of the coordinates, common subexpressions, the value."""
    shared, (value,) = sm.cse([value], symbols=sm.numbered_symbols("c"))
    lines = [
        f"[{', '.join(f'{group}{k}' for k in range(sizes[group]))}] = {group}"
        for group in arguments
        if group != "t"
    ]
    lines += [f"{name} = {_code_of(part, block)}" for name, part in shared]
    if isinstance(value, sm.MatrixBase):
        rows = [[_code_of(entry, block) for entry in row] for row in value.tolist()]
        entries = [f"[{', '.join(row)}]" if block == "mass" else row[0] for row in rows]
        lines += ["return jnp.array(", "    [", *(f"        {entry}," for entry in entries)]
        lines += ["    ],", "    dtype=float,", ")"]
    else:
        lines.append(f"return {_code_of(value, block)}")
    head = f"    def {block}(self, {', '.join(arguments)}):\n"
    return head + "".join(f"        {line}\n" for line in lines)


def _class_of(text: str, name: str, module: str) -> type[MechatronicSystem]:
    """Run the text of a class, and let `inspect.getsource` find it."""
    file = f"<from_sympy {name} {hashlib.sha256(text.encode()).hexdigest()[:12]}>"
    linecache.cache[file] = len(text), None, text.splitlines(keepends=True), file
    namespace: dict[str, Any] = {"__name__": module}
    exec(compile(text, file, "exec", dont_inherit=True), namespace)
    cls = namespace[name]
    cls.source_text = text
    return cls
