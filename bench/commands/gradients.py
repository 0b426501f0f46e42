"""The command `gradient`: derivatives through runs, their errors and their cost."""

from __future__ import annotations

import click
import msgspec

from bench.commands import completion, options
from bench.commands.studies import of_each, once_each, print_json, with_names
from bench.plugins.facts import MethodFacts
from problems.spec import SpecError, one_of

_WAYS = "forward", "reverse"


@click.command()
@click.argument("problem", shell_complete=completion.scenes)
@with_names
@click.option(
    "--of", default="q:end", show_default=True, metavar="GROUP[:end]",
    help="Numbers at the end of the run: q, v, a, lam, x or y, or a component such as q[1].",
)  # fmt: skip
@click.option("--by", required=True, metavar="NAME,...", help="Float parameters of the scene.")
@click.option(
    "--ways", metavar="WAY,...",
    help="Ways to differentiate, of forward and reverse; all that a method has if not given.",
)  # fmt: skip
@click.option(
    "--steps", callback=options.numbers, metavar="H1,H2,...",
    help="Steps in s; the scene's nominal one and three halvings if not given.",
)  # fmt: skip
@options.with_t_end
@options.with_set
@options.with_budget
@options.with_plugins
@options.with_as_json
def gradient(
    problem: str,
    names: tuple[str, ...],
    of: str,
    by: str,
    ways: str | None,
    steps: tuple[float, ...] | None,
    t_end: float | None,
    settings: dict[str, str],
    budget: float,
    plugins: tuple[str, ...],
    as_json: bool,
) -> None:
    """Measure derivatives of a run's end by parameters of the scene.

    Runs are differentiated through their steps, forward (a Jacobian-vector product for each
    parameter) or in reverse (a vector-Jacobian product for each number, with checkpoints). Newton's
    solutions are differentiated by the implicit function theorem. The start counts, where it
    depends on a parameter. Exact derivatives solve the variational equations. Costs are processor
    seconds, in plain runs that were measured beside.

    \b
    Examples:
      stepbench gradient iftomm_pendulum generalized_alpha --by g,length
      stepbench gradient iftomm_pendulum newmark bdf2 --of q[0]:end --by g --ways forward
      stepbench gradient pendulum "dopri8[steps=constant]" --of lam --by m --json
    """
    asked = [one_of(way.strip(), _WAYS, "way") for way in ways.split(",")] if ways else []
    registry = options.usable_registry(plugins)
    scene, methods = registry.problem(problem, **settings), once_each(registry, names)
    end, parameters = options.end_time(scene, t_end), [name.strip() for name in by.split(",")]
    from bench.commands.terminal import show
    from bench.results.gradients import GradientRun, gradient_sentence, gradient_table
    from bench.running.gradients import exact_job, gradient_job

    task = scene.spec, of, parameters, end
    exact = options.guarded(scene.spec, exact_job, scene.sources, budget, *task)

    def measured(method: MethodFacts) -> list[GradientRun]:
        task = method.spec, exact, asked, steps or ()
        sources = scene.sources | method.sources
        return options.guarded(method.spec, gradient_job, sources, budget, *task)

    results, faults = of_each(methods, measured)
    runs = [run for result in results for run in result]
    if runs and as_json:
        print_json({"exact": msgspec.to_builtins(exact), "runs": msgspec.to_builtins(runs)})
    elif runs:
        show(f"{scene.spec}, {of}, t={end:g} s", gradient_table(exact, runs))
        show(gradient_sentence(runs))
    faults += [f"{r.integrator}, {r.way}, {r.resolution}: {r.message}" for r in runs if r.message]
    if faults:
        raise SpecError(" ".join(faults))
