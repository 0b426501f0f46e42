"""Text of scenes whose blocks are SymPy expressions: plain ``jax.numpy``, which needs no SymPy."""

from __future__ import annotations

import hashlib
import linecache
from functools import reduce
from typing import Any

import sympy as sm
from sympy.printing.numpy import JaxPrinter

from problems.base.spec import SpecError
from problems.base.text import said
from problems.system import MechatronicSystem

#: Coordinates are q0, q1 ..., velocities v0, v1 ..., constants self.NAME, time is t.
CLASS = '''\
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


def code_of(value: Any, where: str) -> str:
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


def function_text(block: str, arguments: tuple[str, ...], value: Any, sizes: dict[str, int]) -> str:
    """The text of a block: names of the coordinates, common subexpressions, the value."""
    shared, (value,) = sm.cse([value], symbols=sm.numbered_symbols("c"))
    lines = [
        f"[{', '.join(f'{group}{k}' for k in range(sizes[group]))}] = {group}"
        for group in arguments
        if group != "t"
    ]
    lines += [f"{name} = {code_of(part, block)}" for name, part in shared]
    if isinstance(value, sm.MatrixBase):
        rows = [[code_of(entry, block) for entry in row] for row in value.tolist()]
        entries = [f"[{', '.join(row)}]" if block == "mass" else row[0] for row in rows]
        lines += ["return jnp.array(", "    [", *(f"        {entry}," for entry in entries)]
        lines += ["    ],", "    dtype=float,", ")"]
    else:
        lines.append(f"return {code_of(value, block)}")
    head = f"    def {block}(self, {', '.join(arguments)}):\n"
    return head + "".join(f"        {line}\n" for line in lines)


def class_of(text: str, name: str, module: str) -> type[MechatronicSystem]:
    """Run the text of a class, and let `inspect.getsource` find it."""
    file = f"<from_sympy {name} {hashlib.sha256(text.encode()).hexdigest()[:12]}>"
    linecache.cache[file] = len(text), None, text.splitlines(keepends=True), file
    namespace: dict[str, Any] = {"__name__": module}
    exec(compile(text, file, "exec", dont_inherit=True), namespace)
    cls = namespace[name]
    cls.source_text = text
    return cls
