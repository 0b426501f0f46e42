"""Measurements beside the cells as chapters of the report: budgets, precisions, derivatives."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

from bench.results.gradients import gradient_sentence, gradient_table
from bench.results.measurements import Measurement
from bench.results.precision import precision_sentences, precision_tables
from bench.results.realtime import realtime_sentence, realtime_tables
from bench.results.table import Table
from reports.charts import vega_lite as vl
from reports.charts.sweeps import budget_chart, gradient_chart, precision_chart
from reports.names import scene_name, short_names
from reports.pages.captioned_charts import captioned
from reports.pages.chapter import Chapter, Section


class _Shown(NamedTuple):
    """Chart, tables and sentences of a section, and facts beside them."""

    chart: vl.Spec | None
    tables: list[Table]
    sentences: list[str]
    facts: Mapping[str, str] = {}


def measurement_chapters(found: Mapping[str, Measurement]) -> list[Chapter]:
    """Return a chapter for each kind, with a section for each entry of the suite."""
    return [
        Chapter(f"{kind}.html", title, about, learn, list(_sections(kind, found, shown, caption)))
        for kind, (title, about, learn, caption, shown) in _CHAPTERS.items()
    ]


def _sections(
    kind: str,
    found: Mapping[str, Measurement],
    shown: Callable[[Sequence[Measurement]], _Shown],
    caption: str,
) -> Iterator[Section]:
    entries: dict[str, list[Measurement]] = {}
    for measurement in found.values():
        if measurement.kind == kind:
            entries.setdefault(measurement.about, []).append(measurement)
    for k, (about, own) in enumerate(entries.items(), 1):
        names = short_names(one.integrator for one in own)
        good = [one for one in own if one.status == "ok"]
        chart, tables, sentences, facts = shown(good) if good else _Shown(None, [], [])
        figure = captioned(caption, {f"{kind}-{k}-chart": chart})
        sentences += [f"{m.integrator}: {m.status}: {m.message}" for m in own if m not in good]
        settings = about.removeprefix(f"{own[0].problem} | ")
        yield Section(
            f"{kind}-{k}",
            own[0].title or f"{scene_name(own[0].problem)}: {settings}",
            [*([figure] if figure else []), *tables],
            claim=own[0].note,
            sentences=[_named(sentence, names) for sentence in sentences],
            facts={"Measured": f"{scene_name(own[0].problem)}, {settings}", **facts},
        )


def _named(sentence: str, names: Mapping[str, str]) -> str:
    """A sentence with the short names of integrators."""
    longest = sorted(names, key=len, reverse=True)
    label = rf"(?<![\w.])({'|'.join(map(re.escape, longest))})(?![\w\[])"
    return re.sub(label, lambda match: names[match[1]], sentence)


# ---- the kinds ---------------------------------------------------------------------------
def _budget(found: Sequence[Measurement]) -> _Shown:
    runs = [run for one in found for run in one.realtime]
    ended = [f"{r.name}: {r.status}: {r.message}" for r in runs if r.status != "ok"]
    return _Shown(budget_chart(runs), realtime_tables(runs), [realtime_sentence(runs), *ended])


def _precision(found: Sequence[Measurement]) -> _Shown:
    runs = [run for one in found for run in one.precision]
    return _Shown(precision_chart(runs), precision_tables(runs), precision_sentences(runs))


def _gradient(found: Sequence[Measurement]) -> _Shown:
    answers = [one.gradient for one in found if one.gradient]
    exact = answers[0].exact
    runs = [run for answer in answers if answer.exact.by == exact.by for run in answer.runs]
    failed = [f"{r.integrator}, {r.way}, {r.resolution}: {r.message}" for r in runs if r.message]
    numbers = [
        f"{group}[{k}] by {name}: {value:.12g}"
        for (group, k), row in zip(exact.of, exact.derivatives, strict=True)
        for name, value in zip(exact.by, row, strict=True)
    ]
    return _Shown(
        gradient_chart(answers),
        [gradient_table(exact, runs)],
        [gradient_sentence(runs), *failed],
        {"Exact derivatives": "; ".join(numbers)},
    )


#: Title, contents, what to see, caption of the charts, and what a section shows, by kind.
_CHAPTERS: dict[str, tuple[str, str, str, str, Callable[[Sequence[Measurement]], _Shown]]] = {
    "realtime": (
        "Fixed budget per step",
        "Steps of a fixed size, as in real time: their time, and what they leave unsolved.",
        "What to see here: whether each step ends before the next one is due, and what the error "
        "is if Newton's method stops after one iteration. A method holds the rate if its mark of "
        "99.9 % lies left of the deadline; of these the one furthest to the left in the right "
        "chart is the most accurate. Times are those of this machine and bind no other.",
        "Left: time of a step (median, 99.9 % and worst) in µs; the vertical line is the deadline, "
        "the time from one step to the next. Right: largest relative error of q, v, a and lam in "
        "the same run. In brackets: most iterations in each call of Newton's method.",
        _budget,
    ),
    "precision": (
        "Precision",
        "Errors in 32-bit floats, in 64-bit floats, and with linear systems alone in 32.",
        "What to see here: the step below which smaller steps make a run in 32-bit floats worse. "
        "There the line of single precision leaves that of double and climbs to the left, first in "
        "multipliers and accelerations on index 3. The line of mixed precision stays on that of "
        "double: its states and residuals have 64 bits.",
        "Largest relative error over the step, in double, single and mixed precision; a mark for "
        "each method. Lines that lie on each other are equal.",
        _precision,
    ),
    "gradient": (
        "Gradients",
        "Derivatives through runs by parameters of the scene: their errors and their cost.",
        "What to see here: how exact a derivative through a run is for its processor time. Lines "
        "fall to the right with the order of the method, down to rounding; of two at the same "
        "height the left one is cheaper. Forward mode takes one product for each parameter, "
        "reverse mode one for each number at the end.",
        "Relative error of the derivatives against processor time of gradient and run together; a "
        "panel for each parameter, a colour for each method, from large to small steps.",
        _gradient,
    ),
}
