"""Programs that are traced once and for all: exported to a file for the processes to come.

JAX's compilation cache keeps what XLA made of a program. To find it there, each process would trace
the program again, which takes longer than all else that is left. So a process that runs nothing but
this project's own code (`use_exports`) writes what it has traced to the user's cache, and reads
what others have written. The name of a file is a digest of all that decides the program: the
sources of the project, the versions of the libraries, the flags of the compiler, and the objects of
which the program is made. No file is used in a process that has loaded a plugin, or by tests, which
patch functions of their process.
"""

from __future__ import annotations

import hashlib
import io
import os
import pickle
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache, partial
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar

import msgspec

from problems.runtime import CACHE, FEW_CALLS, jax, jnp, users_settings
from problems.whole_files import keep, kept

T = TypeVar("T")

_PROJECT = Path(__file__).parents[1]
_PACKAGES = ("problems", "integrators", "bench")
#: Libraries whose code is traced.
_LIBRARIES = ("jax", "jaxlib", "numpy", "diffrax", "equinox", "lineax", "optimistix")
_used = False


def use_exports() -> None:
    """Read and write exported programs from now on; for a process that runs our code alone."""
    global _used
    _used = True
    _sources()  # now, as they may change while this process runs


class _Foreign(Exception):
    """An object is made by code that is not ours."""


class _Pickler(pickle.Pickler):
    """Writes objects down for a digest, and refuses what comes from outside of this project."""

    def persistent_id(self, obj: Any) -> None:
        if isinstance(obj, type | FunctionType):
            top = obj.__module__.partition(".")[0]
            if top not in (*_PACKAGES, *_LIBRARIES) and top not in sys.stdlib_module_names:
                raise _Foreign(obj.__module__)


def exported(
    function: Callable,
    about: Sequence[Any] | Callable[[], Sequence[Any]],
    calls: Sequence[str] = (),
    draft: bool = False,
) -> Callable:
    """Return the compiled function ``jax.jit(function)``, read from a file if there is one.

    Parameters
    ----------
    function
        A traceable function; not called if the program is read.
    about
        All that decides the program beside the code of this project, or a function that returns
        this when the program is traced.
    calls
        Names under which the program calls functions of this process.
    draft
        Whether to compile without optimisation, for what is called a few times.
    """

    def compiled(program: Callable) -> Callable:
        return jax.jit(program, compiler_options=FEW_CALLS if draft else {})

    if not _used:
        return compiled(function)

    def program(*arguments: Any) -> Any:
        from jax import export

        leaves, tree = jax.tree.flatten(arguments)
        shapes = [jax.ShapeDtypeStruct(jnp.shape(x), jnp.result_type(x)) for x in leaves]
        # Whatever goes wrong here costs time alone: the function itself is traced instead.
        try:
            decides = about() if callable(about) else about
            file = _file(*decides, str(tree), [(s.shape, str(s.dtype)) for s in shapes])
            trace = partial(_traced, function, tree, shapes, calls)
            form, found = _kept_or_found(file, trace, tuple[Any, bytes])
            results = export.deserialize(bytearray(found)).call(*leaves)
            return jax.tree.unflatten(jax.tree.structure(_formed(form)), results)
        except Exception:
            return function(*arguments)

    return compiled(program)


def found_once(find: Callable[[], T], about: Sequence[Any], kind: type[T]) -> T:
    """Return ``find()``, which are numbers that tracing finds, read from a file if there is one.

    Parameters
    ----------
    about
        All that decides the numbers beside the code of this project.
    kind
        Their type, one of msgspec's.
    """
    if not _used:
        return find()
    try:
        file = _file(kind, *about)
    except Exception:  # it is not ours
        return find()
    return _kept_or_found(file, find, kind)


def _kept_or_found(file: Path, find: Callable[[], T], kind: type[T]) -> T:
    """The content of a sound file; else the result of ``find``, which it keeps from now on."""
    with suppress(msgspec.DecodeError):
        return msgspec.msgpack.decode(kept(file) or b"", type=kind)
    found = find()
    with suppress(OSError):  # a full disk, or a folder that cannot be written
        if _sources.__wrapped__() == _sources():  # else the sources are not those that were traced
            keep(file, msgspec.msgpack.encode(found))
    return found


def _file(*about: Any) -> Path:
    """The file of a program."""
    text = io.BytesIO()
    _Pickler(text).dump(about)
    return CACHE / "exported" / _ours() / hashlib.sha256(text.getvalue()).hexdigest()[:32]


@cache
def _ours() -> str:
    """Digest of all that programs of this process have in common."""
    common = _sources(), os.environ.get("XLA_FLAGS"), users_settings(), jax.default_backend()
    return hashlib.sha256(repr(common).encode()).hexdigest()[:16]


@cache
def _sources() -> str:
    """Digest of this project's sources, and of the versions of Python and the libraries."""
    digest = hashlib.sha256(sys.version.encode())
    for package in _PACKAGES:
        for source in sorted((_PROJECT / package).rglob("*.py")):
            digest.update(f"{source.relative_to(_PROJECT)}\n".encode() + source.read_bytes())
    for library in _LIBRARIES:
        with suppress(PackageNotFoundError):
            digest.update(f"{library} {version(library)}\n".encode())
    return digest.hexdigest()


def _traced(
    function: Callable, tree: Any, shapes: Sequence[Any], calls: Sequence[str]
) -> tuple[Any, bytes]:
    """Trace a function of arguments with this tree of leaves: the form of its results, as data, and
    the program of the leaves.
    """
    from jax import export

    form: Any = None

    def flat(*leaves: Any) -> list[Any]:
        nonlocal form
        results, of_results = jax.tree.flatten(function(*jax.tree.unflatten(tree, leaves)))
        form = jax.tree.unflatten(of_results, range(len(results)))
        return results

    allowed = [export.DisabledSafetyCheck.custom_call(name) for name in calls]
    program = export.export(jax.jit(flat), disabled_checks=allowed)(*shapes)
    plain = _plain(form)
    if jax.tree.structure(_formed(plain)) != jax.tree.structure(form):
        raise TypeError(f"{form} cannot be written down")
    return plain, bytes(program.serialize())


def _plain(form: Any) -> Any:
    """Nested dictionaries and tuples as data; a list begins with the name of its kind."""
    if isinstance(form, dict):
        return {name: _plain(part) for name, part in form.items()}
    if form is None or isinstance(form, int):
        return form
    kind = type(form)
    name = "" if kind is tuple else f"{kind.__module__}:{kind.__qualname__}"
    return [name, *map(_plain, form)]


def _formed(plain: Any) -> Any:
    """Reverse of `_plain`; only named tuples of this project are made."""
    if isinstance(plain, dict):
        return {name: _formed(part) for name, part in plain.items()}
    if not isinstance(plain, list):
        return plain
    name, *parts = plain
    module, _, kind = name.partition(":")
    if module.partition(".")[0] not in ("", *_PACKAGES):
        raise _Foreign(module)
    made = getattr(import_module(module), kind)._make if module else tuple
    return made(map(_formed, parts))
