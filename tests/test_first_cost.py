"""The cost by which a report ranks first: seconds where samples repeat, else operations."""

from pathlib import Path

import pytest
from planted import STEPS, page_data, plant, planted
from small_stores import a_record

from bench.results.records import Environment
from bench.results.store import Store
from bench.results.timings import REPEATABLE, Repeatability, interval_width, repeatability
from reports.pages.html_report import write_html_report
from reports.pages.markdown_report import write_markdown_report
from reports.pages.report import read_report
from reports.questions import Question, plain
from reports.tables.measurement import times_sentence
from reports.verdicts import headlines, method_card

#: The samples of a run, relative to the first.
QUIET, NOISY = (1.0, 1.01, 1.02, 1.03, 1.04, 1.05), (1.0, 1.05, 1.1, 1.2, 1.25, 1.3)
COSTS = {"quiet": "seconds", "noisy": "operations"}


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> dict[str, Path]:
    """Results of two integrators: one takes the fewest operations, the other the least time."""
    found = {}
    for name, samples in (("quiet", QUIET), ("noisy", NOISY)):
        records = [
            planted("pendulum", who, {"a": (1.0, 2)}, h=h, operations={"residuals": operations / h})
            for h in STEPS
            for who, operations in (("lean", 1.0), ("swift", 5.0))
        ]
        folder = found[name] = plant(tmp_path_factory.mktemp(name) / name, records, samples=0)
        with Store(folder, create=True) as store:
            for r in records:
                for n, part in enumerate(samples):
                    slow = 3.0 if r.integrator == "lean" else 1.0
                    store.add_sample(r.key, n, 1e-4 * slow * part / r.h)
        write_html_report(folder)
        write_markdown_report(folder)
    return found


def machine(cpu: str = "one", clock: str = "processor time") -> Environment:
    return Environment(
        date="", command="", cpu=cpu, cores=1, memory_gib=1.0, platform="", versions={}, clock=clock
    )


def timed(*samples: float, **changes: object):
    return a_record(run_s=list(samples), rounds=[(1, n) for n in range(len(samples))], **changes)


def test_seconds_rank_first_where_the_intervals_of_most_runs_are_narrow():
    quiet, noisy = 0.05 / 1.025, 0.3 / 1.15
    for records, width, runs, cost in (
        ([timed(*QUIET)], quiet, 1, "seconds"),
        ([timed(*NOISY)], noisy, 1, "operations"),
        # The interval of nine samples leaves out an outlier on each side.
        ([timed(0.1, *[1.0] * 7, 9.0)], 0.0, 1, "seconds"),
        # The middle of the runs counts, however wide one is.
        ([timed(*QUIET), timed(*QUIET), timed(*[1.0] * 5, 90.0)], quiet, 3, "seconds"),
        ([timed(*QUIET), timed(*NOISY), timed(*NOISY)], noisy, 3, "operations"),
        # Five samples have no interval; a long run has one sample, which tells nothing of others.
        ([timed(*[1.0] * 5), timed(2.0)], None, 0, "operations"),
        ([timed(*QUIET), timed(2.0), timed(0.1, 9.0)], quiet, 1, "seconds"),
        ([timed(*QUIET), *[timed(*NOISY, status="diverged")] * 3], quiet, 1, "seconds"),
        ([], None, 0, "operations"),
    ):
        found = repeatability(records, {})
        assert (found.runs, found.cost) == (runs, cost)
        assert found.width == (None if width is None else pytest.approx(width, abs=1e-15))
    # The limit itself is narrow enough.
    for width, cost in (REPEATABLE, "seconds"), (1.01 * REPEATABLE, "operations"):
        record = timed(1.0 - width / 2, *[1.0] * 4, 1.0 + width / 2)
        assert interval_width(record.run_s) == pytest.approx(width)
        assert repeatability([record], {})._replace(width=width).cost == cost
    # Times of two machines or clocks rank nothing.
    both = [timed(*QUIET, environment=1), timed(*QUIET, environment=2)]
    for other, cost in (
        (machine(), "seconds"),
        (machine(cpu="two"), "operations"),
        (machine(clock="wall clock"), "operations"),
        (None, "seconds"),
    ):
        assert repeatability(both, {1: machine()} | ({2: other} if other else {})).cost == cost


@pytest.mark.parametrize("name", COSTS)
def test_page_markdown_and_terminal_take_the_same_cost_first(folders, name):
    folder, cost = folders[name], COSTS[name]
    winner, other = ("swift", "lean") if cost == "seconds" else ("lean", "swift")
    least = {"seconds": "Least time", "operations": "Fewest operations"}
    report = read_report(folder)
    found = report.answer
    assert found.question == report.stored.first == Question("a", 1e-4, cost)
    beside = "operations" if cost == "seconds" else "seconds"
    data = page_data(folder)
    assert data["first"]["cost"] == cost
    assert {f"a|max|{cost}", f"a|max|{beside}"} <= {*data["answers"]}
    one, two = (plain(s) for s in headlines(report.answered, report.names))
    assert one == f"{least[cost]}: {winner} is cheapest on the scene."
    assert two == f"{least[beside]}: {other} is cheapest on the scene; {winner} on none."
    assert report.winners.head[1] == least[cost].lower()
    markdown = (folder / "report.md").read_text(encoding="utf-8")
    bullets = markdown.partition("## Answer")[2].strip().splitlines()
    assert bullets[:2] == [f"- {one}", f"- {two}"]
    # The integrator's own sentences: alone on the one scene by this cost.
    words = "time" if cost == "seconds" else cost
    mine = method_card(folder, winner)
    assert any(line.startswith(f"Cheapest alone by {words}: pendulum") for line in mine)


def test_the_front_page_says_how_well_times_repeat(folders):
    many = "(median of 12 runs)"
    for name, sentence in (
        ("quiet", f"4.9 % {many}, less than 20 %, so this report asks for seconds first."),
        ("noisy", f"26 % {many}, more than 20 %, so this report asks for operations first."),
    ):
        for file, place in (("report.html", 'id="panels-head"'), ("report.md", "## Answer")):
            text = (folders[name] / file).read_text(encoding="utf-8")
            assert f"Repeated times scatter by {sentence}" in text.partition(place)[0]
    said = times_sentence(Repeatability(0.05, 3, 2))  # of two machines
    assert said.endswith("cannot be compared, so this report asks for operations first.")
    none = times_sentence(Repeatability(None, 0, 1))
    assert none.startswith("No run has the 6 timing samples")
    assert none.endswith("so this report asks for operations first.")
