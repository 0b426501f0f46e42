"""The registry: one loader for scenes and integrators, built-in or somebody else's.

Plugins come as entry points (``stepbench.problems``, ``stepbench.integrators``) or as Python files
named on the command line. One that cannot be loaded is kept with its reason and never stops the
others.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.util
import inspect
import re
import sys
import sysconfig
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from integrators.contract import Integrator
from problems.base import spec
from problems.base.checks import tidy
from problems.base.spec import SpecError
from problems.base.text import described, said, shortened
from problems.system import MechatronicSystem

#: Folders of code that is not to blame for an exception.
_LIBRARIES = tuple({sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")})
#: A frame in what JAX says of an exception in a function of Python that a program calls.
_FRAME = re.compile(r'^ *File "(.+)", line (\d+), in .+$', re.MULTILINE)
#: XLA and NumPy say how much memory they did not get.
_LACKING = re.compile(r"RESOURCE_EXHAUSTED\D*(\d+ bytes)|Unable to allocate ([\d.]+ \w+)")
#: Endings of files that MuJoCo reads.
SUFFIXES = (".xml", ".urdf", ".mjcf")
#: The kinds of plugins, with their base classes.
KINDS = {"problems": MechatronicSystem, "integrators": Integrator}
#: Files of plugins, by their absolute paths, that a process has to load.
Sources = frozenset[str]


class PluginError(SpecError):
    """A plugin that cannot be read or used; the message says why."""


class Unavailable(PluginError):
    """A plugin of this project that needs a library that is not installed, or is broken."""


def explain(error: BaseException) -> str:
    """Return one sentence on an exception, with the innermost line of code that is no library's."""
    text = str(error).strip()
    if lacking := _LACKING.search(text):
        return (
            f"It asks for {lacking[1] or lacking[2]} of memory at once, which the machine does not "
            "have. Full matrices grow with the square of the number of unknowns: take a smaller "
            "scene, or a method with sparse tangents (linear_solver=sparse or auto)."
        )
    if "CpuCallback" in text and (told := _FRAME.findall(text)):
        file, line = ([f for f in told if not f[0].startswith(_LIBRARIES)] or told)[-1]
        reason = shortened(text.splitlines()[-1]).rstrip(".")
        return f"{reason} ({shortened(Path(file).name)}, line {line})."
    # A syntax error says its own line; it came from the importer's.
    frames = () if isinstance(error, SyntaxError) else traceback.extract_tb(error.__traceback__)
    frames = [f for f in frames if not f.filename.startswith(_LIBRARIES)] or frames
    where = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return f"{described(error)}{where}."


def why(error: BaseException) -> str:
    """Return the reason of a failure; that of a false answer needs no line of code."""
    return f"{said(error)}." if isinstance(error, SpecError) else explain(error)


@dataclass
class Plugin:
    """A name with the function that finds its class; without one the ``fault`` is the reason.

    ``sources`` has the file that was named, if any; ``values`` are shown in place of defaults.
    """

    kind: str
    name: str
    origin: str
    load: Callable[[], Any] | None
    sources: Sources = frozenset()
    fault: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def _found(self) -> tuple[type | None, str]:
        if self.load is None:
            return None, self.fault
        try:
            with redirect_stdout(sys.stderr):  # an entry point is imported here
                cls = self.load()
            reason = _fault(self.kind, self.name.partition("[")[0], cls)
        except BaseException as error:
            return None, why(error)
        return (None if reason else cls), reason

    @property
    def cls(self) -> type | None:
        """The class, if it can be used."""
        return self._found[0]

    @property
    def reason(self) -> str:
        """The reason why there is no class, or nothing."""
        return self._found[1]

    @property
    def paragraphs(self) -> list[str]:
        """The paragraphs of the class's docstring, a line each; the first is the summary."""
        doc = (inspect.getdoc(self.cls) if self.cls else None) or ""
        return [tidy(paragraph) for paragraph in doc.split("\n\n")]

    @property
    def options(self) -> list[dict[str, Any]]:
        """Options or parameters: name, default, meaning, unit, choices and limits."""
        fields = dataclasses.fields(self.cls) if self.cls else ()
        shown = ("doc", "unit", "choices", "low", "high")
        return [
            {"name": f.name, "default": self.values.get(f.name, f.default)}
            | {key: f.metadata[key] for key in shown if f.metadata.get(key) is not None}
            for f in sorted(fields, key=lambda f: not f.metadata.get("always"))
            if "doc" in f.metadata
        ]


class Registry:
    """All scenes and integrators by name.

    Parameters
    ----------
    paths
        Python files, or folders of them, that define scenes or integrators; PluginError if one is
        empty or not there.
    loading
        Told the file that is loaded next.
    """

    def __init__(
        self, paths: Sequence[str | Path] = (), loading: Callable[[str], None] = lambda file: None
    ) -> None:
        self.problems: dict[str, Plugin] = {}
        self.integrators: dict[str, Plugin] = {}
        for kind in KINDS:
            entries = [
                (_origin(e.dist), e.name, e) for e in entry_points(group=f"stepbench.{kind}")
            ]
            entries.sort(key=lambda e: (e[0].split()[0] != "stepbench", *e[:2]))
            for origin, name, entry in entries:
                self._add(Plugin(kind, name, origin, entry.load))
        for file in plugin_files(paths):
            loading(file)
            self._add_file(Path(file))

    def problem(self, text: str, **parameters: Any) -> MechatronicSystem:
        """Make the scene ``name[parameter=value,...]``; raise SpecError if the name, a parameter or
        a value is not known or not allowed."""
        return self._make("problems", "scene", text, parameters)

    def integrator(self, text: str) -> Integrator:
        """Make the integrator ``name[option=value,...]``; raise SpecError as `problem` does."""
        return self._make("integrators", "integrator", text, {})

    def _make(self, kind: str, word: str, text: str, more: dict[str, Any]) -> Any:
        name, options = spec.split_spec(text)
        plugins = getattr(self, kind)
        if name not in plugins:
            usable = [n for n, plugin in plugins.items() if plugin.cls]
            raise PluginError(f"There is no {word} {name!r}; {spec.suggest(name, usable)}.")
        plugin = plugins[name]
        if plugin.cls is None:
            raise Unavailable(f"The {word} {name!r} is unavailable: {plugin.reason}")
        if twice := more.keys() & options:
            raise SpecError(
                f"{min(twice)!r} is given in {text!r} and again by itself; once is enough."
            )
        return spec.build(plugin.cls, options | more, name)

    def _add(self, plugin: Plugin) -> None:
        plugins = getattr(self, plugin.kind)
        if taken := plugins.get(plugin.name):
            fault = f"the name {plugin.name!r} is taken by {taken.origin}; give it another name."
            name = f"{plugin.name} ({plugin.origin})"
            plugin = replace(plugin, name=name, load=None, fault=fault)
        plugins[plugin.name] = plugin

    def _add_file(self, file: Path) -> None:
        sources, classes = Sources({str(file)}), list[Any]()
        fault = "it defines no MechatronicSystem and no Integrator."
        try:
            classes = [_model(file)] if file.suffix in SUFFIXES else _classes(file)
        except BaseException as error:  # a plugin may even call sys.exit
            fault = explain(error)
        for kind, base in KINDS.items():
            for cls in (cls for cls in classes if issubclass(cls, base)):
                # A class whose name is of no use is listed, with the reason, under its own.
                name = cls.name if spec.is_name(cls.name) else cls.__name__
                self._add(Plugin(kind, name, str(file), lambda cls=cls: cls, sources))
            if not classes:  # its kind is not known: it is listed under both
                self._add(Plugin(kind, file.stem, str(file), None, sources, fault))


def plugin_files(paths: Sequence[str | Path]) -> list[str]:
    """List the Python files and models that are named, and the files in folders that are named;
    raise PluginError if a path is empty or not there."""
    files: list[str] = []
    for name in paths:
        # An empty path, as from an unset shell variable, would mean the current folder.
        if not str(name).strip():
            raise PluginError("The path of a plugin is empty; name a Python file or a folder.")
        try:
            path = Path(name).resolve()
        except (OSError, RuntimeError, ValueError) as error:  # a circle of links, a null byte
            raise PluginError(
                f"{str(name)!r} is not the path of a plugin: {said(error)}."
            ) from None
        inside = sorted(f for f in path.glob("*.py") if not f.name.startswith("_"))
        for file in inside or [path]:
            if not file.is_file() or file.suffix not in (".py", *SUFFIXES):
                raise PluginError(
                    f"{file} is not a Python file, nor a folder with one, nor a model "
                    f"({', '.join(SUFFIXES)})."
                )
            files.append(str(file))
    return list(dict.fromkeys(files))


@cache
def _model(file: Path) -> type[MechatronicSystem]:
    from problems.models.mjcf import from_mjcf

    return from_mjcf(file)


def _classes(file: Path) -> list[Any]:
    """The scenes and integrators of a Python file, which is imported once."""
    digest = hashlib.sha256(str(file).encode()).hexdigest()[:8]
    name = f"stepbench_plugin_{file.stem}_{digest}"
    if name not in sys.modules:
        loader = importlib.util.spec_from_file_location(name, file)
        assert loader is not None and loader.loader is not None  # noqa: PT018 - it ends with .py
        sys.modules[name] = importlib.util.module_from_spec(loader)  # dataclasses look it up
        try:
            # Prints of a plugin must not get into the JSON on the standard output.
            with redirect_stdout(sys.stderr):
                loader.loader.exec_module(sys.modules[name])
        except BaseException:
            del sys.modules[name]
            raise
    defined = [c for c in vars(sys.modules[name]).values() if inspect.isclass(c)]
    own = [c for c in defined if c.__module__ == name and issubclass(c, (*KINDS.values(),))]
    return [cls for cls in own if not inspect.isabstract(cls)]


@cache  # a package reads its metadata anew each time, and has many entry points
def _origin(package: Any) -> str:
    return f"{package.name} {package.version}"


def _fault(kind: str, name: str, cls: Any) -> str:
    """The sentence on a class that cannot be used, or nothing."""
    if not (isinstance(cls, type) and KINDS[kind] in cls.__mro__):
        return f"{cls!r} is not a subclass of {KINDS[kind].__name__}."
    if inspect.isabstract(cls):
        return f"it lacks {', '.join(sorted(cls.__abstractmethods__))}."
    if not spec.is_name(cls.name):
        return (
            f"its name {cls.name!r} is not a word of letters, digits, '_', '.' and '-' that "
            f"starts with a letter or '_'."
        )
    if cls.name != name:
        return f"it is registered as {name!r} but calls itself {cls.name!r}."
    if kind == "problems":
        needed = "mass", "force", *(() if cls.has("exact") else ("initial_state",))
        missing = [b for b in needed if not cls.has(b)]
        if missing:
            return f"it lacks {', '.join(missing)}."
        if fault := cls.fault():
            return fault
    # A forgotten decorator leaves bare Field objects behind.
    bare = [n for n, value in vars(cls).items() if isinstance(value, dataclasses.Field)]
    if bare:
        return f"{', '.join(bare)} is not an option yet: decorate {cls.__name__} with @dataclass."
    return ""
