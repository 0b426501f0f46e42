"""Fingerprints: digests of everything that decides the numbers of a scene or an integrator.

These are the source of the modules that take part, the versions of the libraries that compute,
and the flags of the compiler; for those that compile C, the C compiler. A cell whose fingerprint
changes is measured anew.

The modules are those of the class and its base classes, the modules that judge runs, and the
modules of this project, or of the plugin's own folder or package, that these import, directly or
not. Imports are read from the source, inside functions, too; nothing is loaded for that. Of a class
that was written from a model (`problems.from_sympy`) its text counts, too.
"""

from __future__ import annotations

import ast
import hashlib
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

import msgspec

from bench.plugins.registry import FILE_PREFIX, Registry
from bench.results.environment import library_versions
from integrators.lowering.native import compiler_version
from problems.runtime import CACHE, SOONER
from problems.system import MechatronicSystem
from problems.whole_files import cached

#: Variables of the environment that change what JAX computes.
FLAGS = ("XLA_FLAGS", "JAX_ENABLE_X64")
#: The modules whose functions turn the answers of a method into errors and a status.
JUDGES = ("bench.running.measure", "integrators.checks")
#: The module that calls the C compiler.
_COMPILES = "integrators.lowering.native"
_PROJECT = frozenset({"problems", "integrators", "bench"})
_PROJECT_FOLDER = Path(__file__).parents[2]
_THIS = Path(__file__).read_bytes()


class _Place(NamedTuple):
    """A folder with modules, and the packages in it that count; None: all modules."""

    folder: Path
    packages: frozenset[str] | None


@cache
def fingerprint(made: type | Callable) -> str:
    """Return the digest of a class of scenes or integrators, or of a function of the bench: 12
    hexadecimal digits."""
    digest, modules = hashlib.sha256(), modules_of(made)
    for name, file in sorted(modules.items()):
        digest.update(f"{name} {_source(file).digest}\n".encode())
    for base in getattr(made, "__mro__", ()):  # a class that its module has not written itself
        digest.update(str(vars(base).get("source_text", "")).encode())
    flags = [os.environ.get(flag, "").replace(SOONER, "") for flag in FLAGS]
    compiler = _compiler() if _COMPILES in modules else ""
    digest.update(repr((sorted(library_versions().items()), flags, compiler)).encode())
    return digest.hexdigest()[:12]


def reference_file(registry: Registry, scene: MechatronicSystem, t_end: float) -> Path | None:
    """Return the file that keeps the reference of a scene up to t_end in s; its name is a digest of
    all that decides it. None for a scene that is not in the registry."""
    plugin = registry.problems.get(scene.name)
    if plugin is None or plugin.cls is not type(scene):
        return None
    about = fingerprint(type(scene)), scene.spec, sorted(scene.parameters().items()), t_end
    digest = hashlib.sha256(repr(about).encode()).hexdigest()[:32]
    return CACHE / "references" / f"{scene.name}-{digest}"


def _compiler() -> str:
    """The first line of what the C compiler says of itself; empty if there is none, or it hangs."""
    with suppress(OSError):
        return f"cc: {compiler_version()}"
    return ""


def modules_of(made: type | Callable) -> dict[str, Path]:
    """Return the source files that decide the numbers of a class, or of a function, by the names of
    the modules."""
    places = (_Place(_PROJECT_FOLDER, _PROJECT),)
    due = [*JUDGES]
    found: dict[str, Path] = {}
    for base in getattr(made, "__mro__", (made,)):
        name, top = base.__module__, base.__module__.partition(".")[0]
        file = Path(getattr(sys.modules.get(name), "__file__", None) or "")
        if file.suffix != ".py" or top in sys.stdlib_module_names:
            continue
        if name.startswith(FILE_PREFIX):
            # Its name has a digest of its path, which differs between machines.
            name = file.stem
            places += (_Place(file.parent, None),)
        elif base is made and top not in _PROJECT:
            depth = name.count(".") + (file.stem == "__init__")
            places += (_Place(file.parents[depth], frozenset({top})),)
        found[name] = file
        due += _imports(name, file)
    seen: set[str] = set()
    while due:
        name = due.pop()
        if name in seen:
            continue
        seen.add(name)
        file = _file_of(name, places)
        if not file:
            due += _passed_on(name, places)
        elif name not in found:
            found[name] = file
            # A package passes on what it imports; only what is taken from it counts.
            due += _imports(name, file) if file.stem != "__init__" else ()
    return found


def _passed_on(name: str, places: tuple[_Place, ...]) -> list[str]:
    """The imports by which a package has a name, or all of them for ``package.*``."""
    package, _, taken = name.rpartition(".")
    file = _file_of(package, places) if package else None
    if not file or file.stem != "__init__":
        return []
    named = (n for n in _imports(package, file) if taken in ("*", n.rpartition(".")[2]))
    return [prefix for n in named for prefix in _prefixes(n)]


@cache
def _file_of(name: str, places: tuple[_Place, ...]) -> Path | None:
    """The source of a module, if it is in one of the places."""
    *parents, last = name.split(".")
    for folder, packages in places:
        if packages is None or name.partition(".")[0] in packages:
            beside = folder.joinpath(*parents)
            for file in (beside / last / "__init__.py", beside / f"{last}.py"):
                if file.is_file():
                    return file
    return None


class _Source(NamedTuple):
    """Digest of a file and its imports, (level of a relative import, dotted name)."""

    digest: str
    imports: frozenset[tuple[int, str]]


@cache
def _source(file: Path) -> _Source:
    code = file.read_bytes()
    # To parse all sources takes longer than all else before the first run, so it is done once.
    file = CACHE / "imports" / hashlib.sha256(_THIS + code).hexdigest()[:32]
    known = cached(file, lambda: msgspec.json.encode(list(_import_names(ast.parse(code)))))
    imports = msgspec.json.decode(known, type=frozenset[tuple[int, str]])
    return _Source(hashlib.sha256(code).hexdigest(), imports)


def _import_names(tree: ast.AST) -> Iterator[tuple[int, str]]:
    due = [tree]
    while due:
        node = due.pop()
        if isinstance(node, ast.Import):
            yield from ((0, f"{alias.name}.*") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):  # of a module, or of a name in one
            start = f"{node.module}." if node.module else ""
            yield from ((node.level, start + alias.name) for alias in node.names)
        elif isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
            due += node.orelse  # imports for types alone do not run
        else:
            for part in ("body", "orelse", "handlers", "finalbody", "cases"):
                due += getattr(node, part, ())


@cache
def _imports(name: str, file: Path) -> frozenset[str]:
    """The modules that a module imports, with their packages; some are names in a module."""
    found = set(_prefixes(name))
    package = name.split(".") if file.stem == "__init__" else name.split(".")[:-1]
    for level, imported in _source(file).imports:
        start = package[: len(package) - level + 1] if level else []
        found.update(_prefixes(".".join([*start, imported])))
    return frozenset(found)


def _prefixes(name: str) -> Iterator[str]:
    """A dotted name and the packages that it is in: importing it runs these first."""
    return accumulate(name.split("."), "{}.{}".format)
