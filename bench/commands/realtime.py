"""The command that runs methods at a fixed rate: `stepbench realtime`."""

from __future__ import annotations

import math
import re
from contextlib import suppress

import click

from bench.commands import completion, options
from bench.commands.studies import of_each, once_each, print_json, with_names
from bench.plugins.facts import MethodFacts, SceneFacts
from bench.results.realtime import MOST_STEPS, RealTimeRun
from problems.spec import SpecError

#: Largest limit of iterations that can be asked for.
_MOST_ITERATIONS = 1000
#: A number of Hz or kHz, with or without the unit.
_RATE = re.compile(r"([+\d.e-]+) ?(?:(k?)hz)?", re.IGNORECASE)


@click.command("realtime")
@click.argument("problem", metavar="SCENE", shell_complete=completion.scenes)
@with_names
@options.with_set
@click.option(
    "--rate", required=True, metavar="RATE", help="Steps per second: 1kHz, 500Hz or 1000."
)
@click.option(
    "--iterations",
    type=click.IntRange(1, _MOST_ITERATIONS),
    help="Most iterations in each call of Newton's method; 1 and unlimited side by side if not "
    "given.",
)
@click.option(
    "--duration", type=float, help="Length of the run in s; the scene's interval if not given."
)
@options.with_budget
@options.with_plugins
@options.with_as_json
def realtime_(
    problem: str,
    names: tuple[str, ...],
    settings: dict[str, str],
    rate: str,
    iterations: int | None,
    duration: float | None,
    budget: float,
    plugins: tuple[str, ...],
    as_json: bool,
) -> None:
    """Run methods with a fixed budget per step, as in real time.

    Each step of 1/RATE takes at most so many iterations of Newton's method and goes on, converged
    or not; explicit and linearly implicit methods have none. The host calls one compiled step for
    each tick. The tables have the time per step, the steps that took longer than 1/RATE, and errors
    and residuals of the same run.

    \b
    Examples:
      stepbench realtime slider_crank linearly_implicit_euler generalized_alpha --rate 1kHz
      stepbench realtime quarter_car "bdf2[newton=modified]" --rate 500Hz --iterations 2
      stepbench realtime pendulum half_explicit_euler stormer_verlet --rate 1000 --duration 1 --json
    """
    registry = options.usable_registry(plugins)
    scene, methods = registry.problem(problem, **settings), once_each(registry, names)
    hertz = rate_of(rate)
    steps = _whole_steps(scene, hertz, duration)
    from bench.commands.terminal import show
    from bench.results.realtime import realtime_sentence, realtime_tables
    from bench.running.realtime import realtime_job

    def measured(method: MethodFacts) -> list[RealTimeRun]:
        sources, task = scene.sources | method.sources, (scene.spec, method.spec, hertz, steps)
        return options.guarded(method.spec, realtime_job, sources, budget, *task, iterations)

    answers, faults = of_each(methods, measured)
    runs = [run for answer in answers for run in answer]
    if runs and as_json:
        print_json({"runs": runs, "summary": realtime_sentence(runs)})
    elif runs:
        show(*realtime_tables(runs), realtime_sentence(runs))
    faults += [f"{run.name}: {run.status}: {run.message}" for run in runs if run.status != "ok"]
    if faults:
        raise click.ClickException(" ".join(dict.fromkeys(faults)))


def rate_of(text: str) -> float:
    """Read "1kHz", "500Hz" or "1000" as a number of Hz.

    Raises
    ------
    SpecError
        If it is no positive rate.
    """
    found = _RATE.fullmatch(text)
    with suppress(ValueError):
        rate = float(found[1]) * (1000.0 if found[2] else 1.0) if found else 0.0
        if 0 < rate < math.inf:
            return rate
    raise SpecError(f"{text!r} is no rate; give a positive one such as 1kHz, 500Hz or 1000.")


def _whole_steps(scene: SceneFacts, rate: float, duration: float | None) -> int:
    """The number of whole steps in the duration, which is part of the scene's interval."""
    length = scene.interval[1] - scene.interval[0]
    duration = length if duration is None else duration
    if not 0 < duration <= length * (1 + 1e-9):
        raise SpecError(
            f"The duration {duration:g} s is not allowed; give a positive one of at most "
            f"{length:g} s, the interval of {scene.spec}, where the reference is known."
        )
    steps = math.floor(min(duration * rate * (1 + 1e-9), 2.0 * MOST_STEPS))
    if not 2 <= steps <= MOST_STEPS:
        raise SpecError(
            f"{rate:g} Hz over {duration:g} s is not allowed; give a rate and a duration that make "
            f"from 2 to {MOST_STEPS} steps."
        )
    return steps
