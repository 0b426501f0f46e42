"""The command that finds the cheapest method and its resolution: `stepbench recommend`."""

from __future__ import annotations

from pathlib import Path

import click

from bench.commands import options
from bench.commands.options import Given
from bench.commands.suite import write_reports
from bench.plugins.registry import SUFFIXES
from bench.running.inventory import Inventory
from bench.running.recommend import PARTS, RULES, Recommendation
from problems.base.cache import put
from problems.base.spec import SpecError

#: File of a recommendation in its folder.
FILE = "recommendation.json"


@options.command(
    "recommend",
    options.argument("name", "SCENE|FILE|SUITE"),
    options.argument("methods", "[INTEGRATOR]...", nargs=-1),
    options.option(
        "--error errors", "Largest error that is allowed, such as a:1e-3 (if not given), "
        "q:end:1e-6, energy:1e-4 or points:1e-3; repeatable where integrators are named.",
        multiple=True, metavar="QUANTITY:LIMIT",
    ),
    options.option(
        "--rule", "Errors that are asked for if none is given; iftomm: of the named points, 0.1 "
        "and 0.001.", type=click.Choice([*RULES]), default="work-precision",
    ),
    options.option(
        "--cost", "Cost by which integrators are ranked.", type=click.Choice([*PARTS]),
        default="seconds",
    ),
    options.budget(
        "Time in s for all runs together; where integrators are named, processor time after which "
        "a run is stopped.",
        60.0,
    ),
    options.T_END,
    *options.SET,
    options.folder("Folder of the results.", "stepbench-recommendation"),
    options.FRESH,
    options.jobs("Worker processes; timing is done by one at a time."),
    options.PLUGINS,
    options.JSON,
)  # fmt: skip
def recommend_(o: Given) -> None:
    """Find the integrator, and its step or tolerance, that reaches an accuracy at the least cost.

    Without names all that take the scene are tried, and dropped as soon as they cannot win. The
    best are tried with constant steps and another Newton's method, too. FILE is a file with one
    scene of your own, or a model of MuJoCo or URDF. The same command goes on with the runs that are
    stored; a larger --budget tries more.

    Of each INTEGRATOR that is named, or that a SUITE has for its scenes, the largest step or
    tolerance is found that meets every error: each search is a bisection that follows the
    convergence of its own errors. The rule iftomm is that of the IFToMM benchmark library; on a
    scene without named points it limits the change of energy.

    \b
    Examples:
      stepbench recommend slider_crank --error a:1e-3
      stepbench recommend my_scene.py --error q:1e-4 --cost operations
      stepbench recommend robot.xml --set contacts=left_out
      stepbench recommend quarter_car --error a:settled:1e-3 --budget 20
      stepbench recommend pendulum generalized_alpha ida --error a:1e-3
      stepbench recommend quick --error q:1e-4 --error energy:1e-5
      stepbench recommend iftomm --rule iftomm
    """
    from bench.commands.terminal import RunProgress, show

    own = [o.name] if o.name.endswith((".py", *SUFFIXES)) else []
    registry = options.usable_registry([*o.plugins, *own])
    name = _scene_in(registry, o.name) if own else o.name
    asked = {name: getattr(o, name) for name in ("errors", "rule", "cost", "budget")}
    found = Recommendation(registry, name, o.methods, **asked, t_end=o.t_end, settings=o.settings)
    for sentence in found.remarks:
        click.echo(sentence, err=True)
    with RunProgress(lines=False) as progress:
        try:
            found.search(o.out, progress, o.jobs, o.fresh)
        finally:  # what was found before an error is not lost by it
            if found.runs:
                put(o.out / FILE, options.json_text(found.plain))
                if o.as_json:
                    options.print_json(found.plain)
                else:
                    for verdict in found.verdicts:
                        program = [verdict.program] if verdict.order else []
                        show(verdict.table(), *verdict.sentences(), *program)
                    show(*found.tables)
    if not o.as_json:
        write_reports(o.out)
    if not any(verdict.order for verdict in found.verdicts):
        raise click.ClickException(f"No integrator reaches {found.about} on {found.name}.")


def _scene_in(registry: Inventory, file: str) -> str:
    """Return the name of the one scene of a file."""
    path = str(Path(file).absolute())
    names = [name for name, facts in registry.problems.items() if path in facts.sources]
    if len(names) != 1:
        told = f"the scenes {', '.join(names)}" if names else "no scene"
        raise SpecError(f"{file} has {told}; name one scene, and give the file with --plugins.")
    return names[0]
