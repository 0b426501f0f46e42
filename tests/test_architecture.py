"""Imports go down the layers of folders and make no circle; those inside functions count, too."""

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

#: From the bottom to the top: a module imports from its own folder and from layers below it.
#: The longest name counts, and a folder's name without a longer one holds its loose modules.
LAYERS = [
    {"problems.base"},
    {"problems.variables"},
    {"problems.starts"},
    {"problems.system"},
    {"problems.equations", "problems.mechanics"},
    {"problems.hybrid"},
    {"problems.truth"},
    {"problems.models"},
    {"problems"},  # its front door, which names what scenes need
    {"problems.formulations"},  # and what integrators need
    {"problems.scenes"},
    {"integrators.multistep", "integrators.output_rows", "integrators.advice"},
    {"integrators.runs", "integrators.resolutions"},
    {"integrators.hybrid_runs"},
    {"integrators.contract"},
    {"integrators.lowering"},
    {"integrators.program_costs"},
    {"integrators.native.algebra"},
    {"integrators.native.step"},
    {"integrators.native.loops"},
    {"integrators.native"},
    {"integrators.methods", "integrators.adapters"},
    {"integrators"},  # its front door, which names what plugins need
    {"bench"},
    {"bench.results"},
    {"bench.plugins"},
    {"bench.running"},
    {"bench.check", "bench.stability"},
    {"bench.atlas"},
    {"reports"},  # records as series, the ranking, and its words
    {"reports.charts", "reports.tables"},
    {"reports.pages"},
    {"bench.commands"},
    {"bench.notebook"},
    {"bench.__main__"},
]
LEVEL = {folder: level for level, folders in enumerate(LAYERS) for folder in folders}

Imports = dict[str, set[str]]


def folder_of(module: str) -> str:
    while module not in LEVEL:
        module = module.rpartition(".")[0]
    return module


def imports_of(sources: dict[str, str]) -> Imports:
    """The modules among the sources that each of them names in an import."""

    def named(tree: ast.AST) -> Iterator[str]:
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                assert node.module, f"line {node.lineno}: imports are written from the top"
                names = (f"{node.module}.{alias.name}" for alias in node.names)
                yield from (name if name in sources else node.module for name in names)

    return {m: {n for n in named(ast.parse(text)) if n in sources} for m, text in sources.items()}


def circle(imports: Imports) -> list[str]:
    """Modules of which each imports the one before, and the first the last."""
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def upward(imports: Imports) -> list[str]:
    """Imports of a higher layer, or of another folder of the same one."""
    return [
        f"{module} imports {other}"
        for module in sorted(imports)
        for other in sorted(imports[module])
        if folder_of(module) != folder_of(other)
        and LEVEL[folder_of(module)] <= LEVEL[folder_of(other)]
    ]


@pytest.fixture(scope="module")
def imports() -> Imports:
    sources = {}
    for top in ("problems", "integrators", "bench", "reports"):
        for path in (ROOT / top).rglob("*.py"):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            sources[name.removesuffix(".__init__")] = path.read_text(encoding="utf-8")
    return imports_of(sources)


def test_no_module_imports_itself_round_a_circle(imports):
    assert not circle(imports)


def test_imports_go_down_the_layers(imports):
    assert not upward(imports)


def test_the_rules_find_what_breaks_them():
    lower = "if TYPE_CHECKING:\n    from integrators.native import loop\n"
    planted = imports_of(
        {
            "problems.system": "def late():\n    import integrators.contract\n",
            "integrators.contract": lower,
            "integrators.native": "",
            "integrators.native.loop": "from integrators.contract import Steps\n",
            "bench.stability.spectra": "from bench.check.trials import cases, integrators\n",
            "bench.check.trials": "from integrators.contract import Steps\n",
        }
    )
    assert {*circle(planted)} == {"integrators.contract", "integrators.native.loop"}
    assert upward(planted) == [
        "bench.stability.spectra imports bench.check.trials",
        "integrators.contract imports integrators.native.loop",
        "problems.system imports integrators.contract",
    ]
