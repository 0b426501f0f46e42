"""The commands on scenes and integrators themselves: `list`, `show`, `truth`, `new`, `check`."""

from __future__ import annotations

import keyword
import re
import shlex
from collections.abc import Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import click
import msgspec

from bench.commands import options
from bench.commands.options import BUDGET_S, Given
from bench.commands.terminal import RunProgress, say, show
from bench.plugins.registry import KINDS, SUFFIXES, Plugin
from bench.results.flat_rows import csv_text
from bench.results.table import Table
from bench.running.inventory import Inventory
from bench.running.plan import built_in_profiles, read_profile
from bench.running.scene_records import GHOSTS
from bench.running.session import describe_scenes
from bench.running.worker import Worker
from integrators.resolutions import check_end
from problems.base.spec import START, SpecError, snake_case, split_spec, suggest

#: The word for one of each kind, and the kinds by the word for all.
WORDS = {"problems": "scene", "integrators": "integrator", "suites": "suite"}
_ALL_OF = {f"{word}s": kind for kind, word in WORDS.items()}
#: Names are padded to the longest one, but not to more characters.
_LONGEST_NAME = 40
#: Number of pictures in an animation: enough for 12 s of smooth motion.
_FRAMES = 240
_SKELETONS = {"integrator": "NewIntegrator", "problem": "NewProblem"}
_FROM_MODEL = '''\
"""The scene {name}, made of a model."""

from problems import from_mjcf

{cls} = from_mjcf(
    {file!r},
    name={name!r},
    interval=(0.0, 2.0),
    nominal_step=0.01,
{more})
'''


@options.command("list", "listed draw out settings plugins as_json", out="stepbench-catalogue")
def list_(o: Given) -> None:
    """List scenes, integrators and suites.

    Each has a line; one that is not available has a reason. KIND is scenes, integrators or suites.
    The NAME of a scene, an integrator or a suite gives all about it: description and options. JSON
    is always complete. With --draw the scenes come as pages, in HTML and Markdown: each with a
    picture, its equations, sizes, stiffness along the motion, and reference.

    \b
    Examples:
      stepbench list integrators
      stepbench list pendulum --set th0=3.0
      stepbench list pendulum car_axis --draw --out mechanisms
    """
    registry = o.registry if o.draw else Inventory(o.plugins)
    every = {kind: getattr(registry, kind, built_in_profiles()) for kind in WORDS}
    words = [*_ALL_OF, *(name for own in every.values() for name in own)]
    for text in o.listed:
        if text not in words:
            raise SpecError(f"There is no {text!r} to list; {suggest(text, words)}.")
    whole = [kind for word, kind in _ALL_OF.items() if not o.listed or word in o.listed]
    names = {kind: [n for n in dict.fromkeys(o.listed) if n in every[kind]] for kind in WORDS}
    if o.settings:
        if whole or not names["problems"]:
            raise SpecError("--set belongs to scenes: name one.")
        for name in names["problems"]:
            spec = registry.problem(name, **o.settings).spec
            of = replace(every["problems"][name], name=spec, values=split_spec(spec)[1])
            every["problems"] = {**every["problems"], name: of}
    if o.draw:
        from reports.pages.catalogue import write_catalogue

        if o.as_json or not {*o.listed} <= {"scenes", *every["problems"]}:
            raise SpecError(
                "--draw writes pages of scenes alone; name scenes, and leave out --json."
            )
        drawn = names["problems"] or [n for n, p in registry.problems.items() if not p.reason]
        scenes = [registry.problem(name, **o.settings) for name in drawn]
        with RunProgress() as progress:
            records = describe_scenes(scenes, BUDGET_S, progress)
        if not records:
            raise SpecError("No scene could be described.")
        click.echo(f"Catalogue: {write_catalogue(records, o.out)}")
        return
    options.refuse("goes with --draw.", "out")
    if o.as_json:
        shown = {kind: every[kind] if kind in whole else names[kind] for kind in WORDS}
        o.answer(
            {kind: [_row(kind, n, every[kind]) for n in own] for kind, own in shown.items() if own}
        )
        return
    for kind in whole:
        if kind == "suites":
            lines = {name: read_profile(name)[1].title or name for name in every[kind]}
        else:
            lines = {p.name: _reason(p) or p.paragraphs[0] for p in every[kind].values()}
        longest = min(_LONGEST_NAME, max(map(len, lines), default=0))
        say((f"{WORDS[kind]}s", "bold"))
        for name, text in lines.items():
            say((f"{name:{longest}}", "cyan"), f"  {text}", cut=True)
    if whole:
        show("Options and documentation of one: stepbench list NAME")
    for kind, own in names.items():
        for name in own:
            show(*(_suite(name) if kind == "suites" else _plugin(kind, every[kind][name])))


def _row(kind: str, name: str, known: Mapping[str, Plugin]) -> dict[str, Any]:
    if kind == "suites":
        suite = msgspec.to_builtins(read_profile(name)[1])
        return {"name": name, "available": True, "reason": ""} | suite
    plugin = known[name]
    (summary, *more), facts = plugin.paragraphs, ("name", "origin", "reason", "options")
    row = {"available": not plugin.reason, "summary": summary, "description": more}
    return {key: getattr(plugin, key) for key in facts} | row


def _plugin(kind: str, plugin: Plugin) -> list[Table | str]:
    """All about a scene or an integrator: description, and options with limits and meaning."""
    rows = []
    for o in plugin.options:
        ends = (("from", o.get("low")), ("to", o.get("high")))
        reach = " ".join(f"{word} {_text(end)}" for word, end in ends if end is not None)
        allowed = ", ".join(filter(None, [*map(str, o.get("choices", ())), reach]))
        unit = f" in {o['unit']}" if o.get("unit", "-") not in ("", "-") else ""
        rows.append([o["name"], _text(o["default"]), allowed, f"{o['doc']}{unit}"])
    (summary, *more), word = plugin.paragraphs, "parameter" if kind == "problems" else "option"
    head = [word, "value" if "[" in plugin.name else "default", "allowed", "meaning"]
    return [
        f"{WORDS[kind]} {plugin.name} ({plugin.origin})",
        _reason(plugin) or summary,
        *(f"\n{text}" for text in more),
        *(["", Table("", head, rows)] if rows else []),
        "",
    ]


def _reason(plugin: Plugin) -> str:
    return f"unavailable: {plugin.reason}" if plugin.reason else ""


def _text(value: Any) -> str:
    return "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _suite(name: str) -> list[Table | str]:
    """The studies of a suite: scenes and integrators."""
    suite = read_profile(name)[1]
    rows = [[s.title, "\n".join(s.problems), "\n".join(s.integrators)] for s in suite.study]
    limits = f"{suite.samples} timings per run, at most {suite.budget_s:g} s of processor time each"
    table = Table("", ["study", "scenes", "integrators"], rows)
    return [f"suite {name}", suite.title, limits, "", table]


@options.command(
    "show", "problem file animate t_end settings budget plugins",
    file={"help": "File; NAME.svg or NAME.html if not given."},
)  # fmt: skip
def show_(o: Given) -> None:
    """Draw or animate a scene.

    A picture (SVG or PNG) shows it at several times, an animation is a page (HTML).

    \b
    Examples:
      stepbench show slider_crank
      stepbench show pendulum --set th0=3.0 -o pendulum.png
      stepbench show slider_crank --animate
    """
    from reports.pages.catalogue import write_animation, write_picture

    scene = o.asked_scene
    start, end = scene.interval
    end = check_end(start, end if o.t_end is None else o.t_end)
    ending, count = ("html", _FRAMES) if o.animate else ("svg", GHOSTS)
    about, task = f"{scene.spec} cannot be shown", (scene.spec, end, count)
    drawings = o.guarded(about, Worker.pictures, scene.sources, *task)
    write = write_animation if o.animate else write_picture
    click.echo(f"Picture: {write(scene.spec, drawings, o.file or Path(f'{scene.name}.{ending}'))}")


@options.command(
    "truth", "problem every at settings budget plugins as_json as_csv",
    at={"help": "These instants in s.", "metavar": "T1,..."},
    as_csv={"help": "Print comma-separated rows, as `judge` reads them."},
)  # fmt: skip
def truth(o: Given) -> None:
    """Print the certain digits of a scene.

    A number is printed as far as independent ways agree: a closed form or Gauss collocation, and
    Radau IIA, also with changed data. It is off by at most one unit of its last digit.

    \b
    Examples:
      stepbench truth slider_crank --at 0,0.5,1 --json
      stepbench truth duffing --every 0.5 --csv > duffing.csv
    """
    from bench.running.truth import truth_job

    if o.every is not None:
        options.refuse("does not go with --every; give one of them.", "at")
    if o.as_json:
        options.refuse("does not go with --json; give one of them.", "as_csv")
    scene = o.asked_scene
    found = o.guarded(o.problem, truth_job, scene.sources, scene.spec, o.every, o.at)
    rows, named = found["rows"], found["components"]
    places = [(g, i, name) for g, names in named.items() for i, name in enumerate(names)]
    if o.as_csv:
        table = [{"t": r["t"], **{f"{g}{i + 1}": r[g][i] for g, i, _ in places}} for r in rows]
        click.echo(csv_text(table), nl=False)
        return
    values = [[f"{g} {n}", f"{r['t']:g}", r[g][i]] for g, i, n in places for r in rows]
    digits = [[f"{r['t']:g}", *(str(r["digits"][g]) for g in named)] for r in rows]
    o.answer(
        found,
        Table(f"{found['scene']}: certain digits", ["component", "t [s]", "value"], values),
        Table("Number of certain digits", ["t [s]", *named], digits),
        *(f"How: {found['how']}.", *found["remarks"]),
    )


@options.command(
    "new", "kind name file model meshes settings", file={"help": "File; NAME.py if not given."}
)
def new(o: Given) -> None:
    """Write a small scene or integrator, which runs at once.

    \b
    Examples:
      stepbench new integrator my_method
      stepbench new problem my_scene --out scenes/my_scene.py
      stepbench new problem my_robot --from robot.xml --keyframe home --set start.hip=0.3
    """
    if o.model is not None and (o.kind != "problem" or o.model.suffix not in SUFFIXES):
        raise SpecError(f"--from takes a model ({', '.join(SUFFIXES)}) for a new problem.")
    if o.model is None:
        options.refuse("belongs to a model: name it by --from.", "settings", "meshes")
    if not re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", o.name) or keyword.iskeyword(o.name):
        raise SpecError(
            f"{o.name!r} is not a name in small letters, digits and '_', such as my_method."
        )
    registry = Inventory()
    for plugin in (getattr(registry, kind).get(o.name) for kind in KINDS):
        if plugin:
            raise SpecError(f"The name {o.name!r} is taken by {plugin.origin}; try 'my_{o.name}'.")
    path = o.file or Path(f"{o.name}.py")
    if path.suffix != ".py":
        raise SpecError(f"{path} is not the name of a Python file; give one that ends with .py.")
    # The name of a class that the registry lists under the name given.
    parts = [part.capitalize() for part in o.name.split("_")]
    cls = "".join(parts) if snake_case("".join(parts)) == o.name else "_".join(parts)
    if o.model is None:
        skeleton = resources.files("bench.plugins.skeletons") / f"{o.kind}.py"
        text = skeleton.read_text(encoding="utf-8").replace(_SKELETONS[o.kind], cls)
    else:
        starts = {key: value for key, value in o.settings.items() if key.startswith(START)}
        given: dict[str, Any] = {
            "keyframe": o.settings.pop("keyframe", None),
            "meshes": o.meshes and str(o.meshes.resolve()),
            "start": {key.removeprefix(START): _number(key, text) for key, text in starts.items()},
            "defaults": {key: value for key, value in o.settings.items() if key not in starts},
        }
        more = "".join(f"    {key}={value!r},\n" for key, value in given.items() if value)
        file = str(o.model.resolve())
        text = _FROM_MODEL.format(cls=cls, name=o.name, file=file, more=more)
    try:
        with path.open("x", encoding="utf-8") as written:
            written.write(text)
    except FileExistsError:
        raise SpecError(f"{path} is there already; give another name or --out.") from None
    mine, file = o.kind == "integrator", shlex.quote(str(path))
    then = (
        f"solve {f'pendulum {o.name}' if mine else f'{o.name} newmark'} --plugins {file}",
        f"check {file}",
        f"run --mine {o.name} --plugins {file}" if mine else f"recommend {file} --error a:1e-3",
    )
    click.echo("\n  stepbench ".join((f"{path} is written. Next:", *then)))


def _number(key: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise SpecError(f"{key}={text} is not a number.") from None


@options.command("check", "checked everything budget plugins as_json")
def check(o: Given) -> None:
    """Check scenes and integrators against the rules for plugins.

    Give names, also with options, or Python files with plugins. Each check prints one line: its
    result, and how to correct a fault. The exit code is 1 if a check fails.

    \b
    Examples:
      stepbench check pendulum "generalized_alpha[rho_inf=0.5]"
      stepbench check my_method.py my_scene.py
      stepbench check --all --json
    """
    from bench.check.checker import chosen, is_file, run_checks
    from bench.check.verdicts import FAILED, NOT_APPLICABLE, PASSED

    signs = {PASSED: ("\u2713", "green"), FAILED: ("\u2717", "red"), NOT_APPLICABLE: ("-", "dim")}
    registry = Inventory([*o.plugins, *filter(is_file, o.checked)])
    answers, verdicts = [], []
    for kind, text in chosen(registry, o.checked, o.everything):
        if not o.as_json:
            say(f"{WORDS[kind]} {text}")
        results = []
        for result in run_checks(registry, kind, text, o.budget):
            results.append(result)
            if not o.as_json:
                (sign, style), why = signs[result.verdict], result.verdict == NOT_APPLICABLE
                said = "does not apply: " * why + result.text
                say((f"  {sign} {result.check}: ", style), said)
        own = [result.verdict for result in results]
        verdicts += own
        about = {"name": text, "kind": WORDS[kind], "passed": FAILED not in own}
        answers.append(about | {"checks": [vars(result) for result in results]})
    failed = verdicts.count(FAILED)
    o.answer(answers, *[f"All {len(verdicts)} checks passed or do not apply."] * (not failed))
    if failed:
        o.faults.append(f"{failed} of {len(verdicts)} checks failed.")
