"""The commands for stored results: pages, flat rows, figures and comparisons."""

from __future__ import annotations

import json
from pathlib import Path

import click

from bench.commands import options
from bench.commands.options import Given, PathName
from bench.commands.suite import write_reports
from bench.results.flat_rows import csv_text, flatten
from bench.results.folders import compare_folders, merge, read_limits, regressions
from bench.results.quantities import ASKED, COST, COSTS, NORM, NORMS
from bench.results.store import Store
from problems.base.spec import SpecError

#: The page in a folder of results.
_PAGE = "report.html"
#: Forms of flat rows, which are endings of files.
_FORMS = ("csv", "json")
#: Most regressions that are named on the screen.
_NAMED = 10
_KINDS = ("work_precision", "convergence", "trajectory", "errors_over_time")
#: Options of a figure.
_QUESTION = ("scene", "error", "cost", "component", "integrators", "t_end")


@options.command(
    "report",
    options.FOLDER,
    options.flag("--single-file", "One HTML file that holds all pages, to mail."),
    options.flag("--open opened", "Open the pages in the browser, too."),
    options.option("--csv form", "Write all records as comma-separated rows.", flag_value="csv"),
    options.option("--json form", "Write them as a JSON array of flat rows.", flag_value="json"),
    options.option(
        "--figure kind", "Write one figure for a paper, as wide as a column.",
        type=click.Choice(_KINDS),
    ),
    options.option(
        "--scene", "Figure: the scene; may be left out if the folder has one."
    ),
    options.option(
        "--error",
        f"Figure: which error, as a:end; q:{NORM} if not given.",
        metavar="GROUP:NORM",
    ),
    options.option(
        "--cost",
        f"Figure: seconds, or a count as residuals or steps; {COST} if not given.",
    ),
    options.option(
        "--component", "Figure: what a trajectory shows, as a:Y; q:1 if not given.",
        metavar="GROUP:PLACE",
    ),
    options.integrators("Figure: only this integrator; repeatable."),
    options.option(
        "--t-end", "Figure: end time in s, if FOLDER has the scene with several.", type=float,
    ),
    options.file(
        "File of rows, which ends in .csv or .json (the screen if not given), or of a figure, "
        "which ends in .svg, .png, .pdf or .json (Vega-Lite; KIND.svg if not given)."
    ),
)  # fmt: skip
def report(o: Given) -> None:
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
    pages = "--open" if o.opened else "--single-file" if o.single_file else ""
    wanted = [*filter(None, [pages, o.form and f"--{o.form}", o.kind is not None and "--figure"])]
    if len(wanted) > 1:
        raise SpecError(f"{wanted[0]} and {wanted[1]} do not go together; give one of them.")
    if o.kind is None:
        options.refuse("belongs to a figure; name its kind by --figure.", *_QUESTION)
    ending = o.out.suffix.lower().removeprefix(".") if o.out else ""
    form = o.form or (ending if ending in _FORMS and not wanted else "")
    if o.kind is not None:
        from reports.figures import write_figure

        # What the question leaves open, the writer decides.
        asked = {name: getattr(o, name) for name in _QUESTION if getattr(o, name) not in (None, ())}
        file = write_figure(o.kind, o.folder, o.out or Path(f"{o.kind}.svg"), **asked)
        click.echo(f"Figure: {file}")
    elif form:
        if ending in {*_FORMS} - {form}:
            raise SpecError(
                f"{o.out} ends in .{ending} and --{form} was given; leave one of them out."
            )
        _write_rows(o.folder, form, o.out)
    elif o.out:
        raise SpecError(f"{o.out} is a file of rows or of a figure; say --csv, --json or --figure.")
    else:
        Store(o.folder).close()  # says clearly if there is none
        write_reports(o.folder, o.single_file)
        if o.opened:
            _open(o.folder / _PAGE)


def _write_rows(folder: Path, form: str, out: Path | None) -> None:
    """Write all records as flat rows, for pandas."""
    with Store(folder) as store:
        machines = store.environments()
        rows = [flatten(record, machines) for record in store.records().values()]
    text = json.dumps(rows, indent=1) if form == "json" else csv_text(rows)
    if out:
        out.write_text(text, encoding="utf-8")
    click.echo(f"{len(rows)} records in {out}" if out else text, nl=bool(out))


def _open(page: Path) -> None:
    import webbrowser

    if not webbrowser.open(page.resolve().as_uri()):
        raise SpecError(f"No browser could be opened; the page is {page.resolve()}.")
    click.echo(f"Opened: {page}")


@options.command(
    "compare",
    options.argument("old", type=PathName("folder")),
    options.argument("new", type=PathName("folder")),
    options.option(
        "--fail-on limits", "Exit with 1 if an error, work or time is more than RATIO times the "
        "old one, as in error:1.1,work:1.05,time:1.5, or a run no longer reaches the end; with "
        "'vanished', also if NEW lacks a run.", metavar="KIND:RATIO,...",
        callback=lambda _, __, text: {} if text is None else read_limits(text),
    ),
    options.JSON,
)  # fmt: skip
def compare(o: Given) -> None:
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
    import msgspec

    from bench.commands.terminal import say

    comparison = compare_folders(o.old, o.new)
    worse = regressions(comparison, o.limits)
    if o.as_json:
        options.print_json(msgspec.structs.asdict(comparison) | {"regressions": worse})
    else:
        for line in [*comparison.state, *comparison.summary()]:
            say(line)
    if worse:
        more = f"\n... and {len(worse) - _NAMED} more" if len(worse) > _NAMED else ""
        named = "\n".join(worse[:_NAMED])
        raise click.ClickException(f"{len(worse)} beyond the limits:\n{named}{more}")


@options.command(
    "merge",
    options.argument("folders", "FOLDER FOLDER...", nargs=-1, type=PathName("folder")),
    options.option("--out", "A new folder.", required=True, type=PathName("folder")),
)
def merge_(o: Given) -> None:
    """Put results of several folders into one.

    Each record keeps the machine that measured it. Of a run that several folders have, that of
    the folder named last is kept.

    \b
    Examples:
      stepbench merge laptop-results cluster-results --out all-results
    """
    records, environments = merge(o.folders, o.out)
    click.echo(
        f"{records} records of {len(o.folders)} folders, measured in {environments} environments, "
        f"are in {o.out}. For the pages: stepbench report {o.out}"
    )


@options.command(
    "versus",
    options.argument("first", "A"),
    options.argument("second", "B"),
    options.FOLDER,
    options.option(
        "--group", "Quantity whose error counts; a,lam asks for both at once.",
        metavar="|".join(ASKED), default="a",
    ),
    options.option("--norm", "Norm of the error.", metavar="|".join(NORMS), default=NORM),
    options.option(
        "--target targets", "Error at which costs are compared; repeatable; 1e-2, 1e-4 and 1e-6 "
        "if not given.", type=float, multiple=True,
    ),
    options.option(
        "--cost", "seconds if they scatter little, else operations.", metavar="|".join(COSTS),
    ),
    options.JSON,
)  # fmt: skip
def versus_(o: Given) -> None:
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
    from reports.versus import side_by_side

    asked = {"group": o.group, "targets": o.targets, "cost": o.cost, "norm": o.norm}
    found = side_by_side(o.first, o.second, o.folder, **asked)
    if o.as_json:
        options.print_json(found.plain)
    else:
        show(*found.sentences, found.table)
