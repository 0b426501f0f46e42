"""The commands for stored results: pages, flat rows, figures and comparisons."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
import msgspec

from bench.commands import completion, options
from bench.commands.options import PathName
from bench.commands.pages import view, write_reports
from bench.results.compare import compare_folders, read_limits, regressions
from bench.results.csv_text import csv_export
from bench.results.flat_rows import flatten
from bench.results.merge import merge
from bench.results.quantities import ASKED, COST, COSTS, NORM, NORMS
from bench.results.store import Store
from problems.spec import SpecError

#: The page in a folder of results.
_PAGE = "report.html"
#: Forms of flat rows, which are endings of files.
_FORMS = ("csv", "json")
#: Most regressions that are named on the screen.
_NAMED = 10


@click.command()
@options.with_results
@click.option("--single-file", is_flag=True, help="One HTML file that holds all pages, to mail.")
@click.option("--open", "opened", is_flag=True, help="Open the pages in the browser, too.")
@click.option("--csv", "form", flag_value="csv", help="Write all records as comma-separated rows.")
@click.option("--json", "form", flag_value="json", help="Write them as a JSON array of flat rows.")
@click.option(
    "--figure",
    "kind",
    metavar="KIND",
    help="Write one figure for a paper, as wide as a column: work_precision, convergence, "
    "trajectory or errors_over_time.",
    shell_complete=completion.choices(
        "work_precision", "convergence", "trajectory", "errors_over_time"
    ),
)
@click.option(
    "--scene",
    help="Figure: the scene; may be left out if the folder has one.",
    shell_complete=completion.scenes,
)
@click.option(
    "--error", metavar="GROUP:NORM", help=f"Figure: which error, as a:end; q:{NORM} if not given."
)
@click.option(
    "--cost", help=f"Figure: seconds, or a count as residuals or steps; {COST} if not given."
)
@click.option(
    "--component",
    metavar="GROUP:PLACE",
    help="Figure: what a trajectory shows, as a:Y; q:1 if not given.",
)
@options.with_integrators("Figure: only this integrator; repeatable.")
@click.option(
    "--t-end", type=float, help="Figure: end time in s, if FOLDER has the scene with several."
)
@options.with_file(
    "File of rows, whose ending .csv or .json decides (the screen if not given), or of a figure, "
    "which ends in .svg, .png, .pdf or .json (Vega-Lite; KIND.svg if not given)."
)
def report(
    folder: Path,
    single_file: bool,
    opened: bool,
    form: str | None,
    kind: str | None,
    out: Path | None,
    **question: Any,
) -> None:
    """Make the report pages anew from the results in FOLDER, or write rows or a figure of them.

    \b
    Examples:
      stepbench report --open
      stepbench report before --single-file
      stepbench report stepbench-results --csv -o records.csv
      stepbench report --json > records.json
      stepbench report --figure work_precision --scene pendulum --error a:max
      stepbench report --figure convergence --scene pendulum --error lam:settled \\
          -i newmark -i hht -o orders.pdf
      stepbench report --figure trajectory --scene pendulum --component a:Y -o a.png
    """
    # What the question leaves open, the writer decides.
    asked = {name: value for name, value in question.items() if value not in (None, ())}
    pages = "--open" if opened else "--single-file" if single_file else ""
    wanted = [*filter(None, [pages, form and f"--{form}", kind is not None and "--figure"])]
    if len(wanted) > 1:
        raise SpecError(f"{wanted[0]} and {wanted[1]} do not go together; give one of them.")
    if kind is None:
        given = {name.removesuffix("s"): value for name, value in asked.items()}
        options.refuse("belongs to a figure; name its kind by --figure.", **given)
    if out and not wanted and _ending(out) in _FORMS:
        form = _ending(out)
    if kind is not None:
        written = view("figure")(kind, folder, out or Path(f"{kind}.svg"), **asked)
        click.echo(f"Figure: {written}")
    elif form:
        _write_rows(folder, form, out)
    elif out:
        raise SpecError(f"{out} is a file of rows or of a figure; say --csv, --json or --figure.")
    else:
        Store(folder).close()  # says clearly if there is none
        write_reports(folder, single_file)
        if opened:
            _open(folder / _PAGE)


def _write_rows(folder: Path, form: str, out: Path | None) -> None:
    """Write all records as flat rows, for pandas."""
    if out and _ending(out) in {*_FORMS} - {form}:
        raise SpecError(
            f"{out} ends in {out.suffix} and --{form} was given; leave one of them out."
        )
    with Store(folder) as store:
        machines = store.environments()
        rows = [flatten(record, machines) for record in store.records().values()]
    text = json.dumps(rows, indent=1) if form == "json" else csv_export(rows)
    if out:
        out.write_text(text, encoding="utf-8")
    click.echo(f"{len(rows)} records in {out}" if out else text, nl=bool(out))


def _ending(file: Path) -> str:
    return file.suffix.lower().removeprefix(".")


def _open(page: Path) -> None:
    import webbrowser

    if not webbrowser.open(page.resolve().as_uri()):
        raise SpecError(f"No browser could be opened; the page is {page.resolve()}.")
    click.echo(f"Opened: {page}")


def _limits(
    context: click.Context, parameter: click.Parameter, text: str | None
) -> dict[str, float]:
    return read_limits(text) if text is not None else {}


@click.command()
@click.argument("old", type=PathName("folder"))
@click.argument("new", type=PathName("folder"))
@click.option(
    "--fail-on",
    "limits",
    callback=_limits,
    metavar="KIND:RATIO,...",
    help="Exit with 1 if an error, work or time is more than RATIO times the old one, as in "
    "error:1.1,work:1.05,time:1.5, or a run no longer reaches the end; with 'vanished', also if "
    "NEW lacks a run.",
)
@options.with_as_json
def compare(old: Path, new: Path, limits: dict[str, float], as_json: bool) -> None:
    """Compare the results in OLD and NEW, run by run.

    Errors and counts are compared as they are, times where the interval of the quotient of the
    medians lies on one side of 1 and the quotient is beyond the noise. Times from different
    machines or versions, and of runs whose source is the same, are shown, but are no regression.

    \b
    Examples:
      stepbench compare before after
      stepbench compare before after --fail-on error:1.1,work:1.05,time:1.5
      stepbench compare before after --json > changes.json
    """
    from bench.commands.terminal import say

    comparison = compare_folders(old, new)
    worse = regressions(comparison, limits)
    if as_json:
        answer = msgspec.structs.asdict(comparison) | {"regressions": worse}
        click.echo(msgspec.json.format(msgspec.json.encode(answer).decode(), indent=2))
    else:
        for line in [*comparison.state(), *comparison.summary()]:
            say(line)
    if worse:
        more = f"\n... and {len(worse) - _NAMED} more" if len(worse) > _NAMED else ""
        named = "\n".join(worse[:_NAMED])
        raise click.ClickException(f"{len(worse)} beyond the limits:\n{named}{more}")


@click.command("merge")
@click.argument("folders", nargs=-1, type=PathName("folder"), metavar="FOLDER FOLDER...")
@click.option("--out", required=True, type=PathName("folder"), help="A new folder.")
def merge_(folders: tuple[Path, ...], out: Path) -> None:
    """Put results of several folders into one.

    Each record keeps the machine that measured it. Of a run that several folders have, the one
    that was measured last is kept; of those measured at one time, that of the folder named last.

    \b
    Examples:
      stepbench merge laptop-results cluster-results --out all-results
    """
    records, environments = merge(folders, out)
    click.echo(
        f"{records} records of {len(folders)} folders, measured in {environments} environments, "
        f"are in {out}. For the pages: stepbench report {out}"
    )


@click.command("versus")
@click.argument("first", metavar="A")
@click.argument("second", metavar="B")
@options.with_results
@click.option(
    "--group",
    metavar="|".join(ASKED),
    help="Quantity whose error counts; a,lam asks for both at once; a if not given.",
)
@click.option("--norm", metavar="|".join(NORMS), help=f"Norm of the error; {NORM} if not given.")
@click.option(
    "--target",
    "targets",
    type=float,
    multiple=True,
    help="Error at which costs are compared; repeatable; 1e-2, 1e-4 and 1e-6 if not given.",
)
@click.option(
    "--cost", metavar="|".join(COSTS), help="seconds if they scatter little, else operations."
)
@options.with_as_json
def versus_(first: str, second: str, folder: Path, as_json: bool, **question: Any) -> None:
    """Compare integrators A and B at equal error.

    Costs at equal error are interpolated between the runs in FOLDER, scene by scene. An interval
    has the spread over later starts of the motion and that of times; over the scenes, the sign test
    says whether one of the two is cheaper.

    \b
    Examples:
      stepbench versus newmark ida
      stepbench versus my_method "generalized_alpha[rho_inf=0.8]" --group a,lam --target 1e-4
      stepbench versus my_method ida stepbench-results --cost seconds
    """
    from bench.commands.terminal import show

    asked = {name: value for name, value in question.items() if value is not None}
    found = view("versus")(first, second, folder, **asked)
    if as_json:
        click.echo(msgspec.json.format(msgspec.json.encode(found.plain).decode(), indent=2))
    else:
        show(*found.sentences, found.table)
