"""Two integrators side by side: a table of costs at equal error, with sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bench.results.quantities import COSTS, NORM, NORMS, checked_group
from bench.results.table import Table
from problems.spec import SpecError, one_of
from reports.names import named_labels, short_names
from reports.questions.question import FIRST, TABLE_TARGETS, Question
from reports.questions.versus import versus
from reports.scenes import stored_runs

_MEANING = (
    "Costs at equal error are interpolated between runs. In brackets: the ends over the run and "
    "its later starts, of times with the interval of their samples; of a median over scenes the 95 "
    "% interval of the sign test, of fewer than six scenes the ends. 'At least' and 'at most': the "
    "coarsest run of one is better than asked, or only one gets there from some starts; 'coarsest "
    "runs': those of both are better. Not judged: below a hundred times the reference's own error."
)


@dataclass(frozen=True)
class SideBySide:
    """Sentences and plain data of two integrators, one per accuracy, and their table.

    The table has a row per scene and a column per accuracy; bold is a ratio beyond doubt.
    """

    sentences: list[str]
    table: Table
    plain: list[dict[str, Any]]


def side_by_side(
    one: str,
    two: str,
    folder: Path,
    *,
    group: str = FIRST.group,
    targets: Sequence[float] = (),
    cost: str | None = None,
    norm: str = NORM,
) -> SideBySide:
    """Compare two integrators of a run folder at several accuracies.

    Parameters
    ----------
    one, two
        Their names: short, as printed, or without options where that is unique.
    folder
        The run folder.
    group, targets, cost, norm
        The question: a group, or several as "a,lam" for both at once; errors between 0 and 1; the
        cost is that by which the results are ranked first if not given.

    Raises
    ------
    SpecError
        If a part of the question is another, or no scene has runs of both.
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    stored = stored_runs(folder)
    names = short_names(s.label for own in stored.series.values() for s in own)
    first, second = labels = _one_label(one, names), _one_label(two, names)
    group, norm = checked_group(group), one_of(norm, NORMS, "norm")
    cost = one_of(stored.first.cost if cost is None else cost, COSTS, "cost")
    if wrong := [t for t in targets if not 0 < t < 1]:
        raise SpecError(f"{wrong[0]:g} is no accuracy; give one between 0 and 1.")
    asked = [Question(group, target, cost) for target in targets or TABLE_TARGETS]
    columns = [versus(stored.series, labels, names, question, norm) for question in asked]
    scenes = list(columns[0].duels)
    if not scenes:
        raise SpecError(
            f"{names[first]} and {names[second]} have no scene in common with an error in "
            f"{asked[0].quantity}."
        )
    rows = [[scene, *(c.shown(scene) for c in columns)] for scene in scenes]
    if len(scenes) > 1:
        rows.append(["median", *(c.median.text() if c.median else "" for c in columns)])
    table = Table(
        f"Cost of {names[second]} as a multiple of that of {names[first]} "
        f"({asked[0].quantity}, {NORMS[norm]}; {COSTS[cost].words})",
        ["scene", *(question.accuracy for question in asked)],
        rows,
        best={
            (i, j)
            for i, scene in enumerate(scenes)
            for j, c in enumerate(columns, 1)
            if c.duels[scene].told_apart
        },
        note=f"Above 1 {names[first]} is cheaper; bold: beyond doubt. {_MEANING}",
    )
    plain = [
        {"first": first, "second": second, **asdict(c.question), "norm": norm}
        | {"sentence": c.sentence, "median": c.median, "p_value": c.p_value, "scenes": c.duels}
        for c in columns
    ]
    return SideBySide([c.sentence for c in columns], table, plain)


def _one_label(text: str, names: dict[str, str]) -> str:
    found = [text] if text in names else named_labels(text, names)
    if len(found) > 1:
        raise SpecError(f"{text!r} are several; name one of {', '.join(found)}.")
    return found[0]
