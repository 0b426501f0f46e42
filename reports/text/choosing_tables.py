"""Tables of a guide: what each method costs on the scenes of a kind, and what energy it keeps."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence

from bench.results.quantities import COSTS
from bench.results.records import NOT_TRIED
from bench.results.table import Table
from reports.formatting import NO_VALUE, cost_text, number
from reports.names import form_behind, form_name, scene_name
from reports.questions.answers import Answer
from reports.questions.question import Question
from reports.questions.words import Words
from reports.series import Series

#: Between the numbers of several accuracies in one cell.
_BETWEEN = " · "
#: An accuracy that the reference is not good enough to judge.
_UNJUDGED = "?"


def multiples_table(
    found: Sequence[Answer], runs: Mapping[str, Sequence[Series]], words: Words
) -> Table:
    """The least cost on each scene, and the multiples of it that each method takes.

    Parameters
    ----------
    found
        The answers for one group and cost and several accuracies, on the scenes of the table.
    runs
        The runs on these scenes.
    words
        Names of the report.
    """
    question, scenes = found[0].question, [*runs]
    first: Counter[str] = Counter()
    reached: Counter[str] = Counter()
    for s in (s for answer in found for s in answer.standings):
        first[s.label] += s.alone + s.tied
        reached[s.label] += s.reached
    own: dict[str, dict[str, Series]] = {}
    for scene, series in runs.items():
        for s in (s for s in series if any(r.status not in NOT_TRIED for r in s.records)):
            own.setdefault(s.label, {})[scene] = s
    rows = [["least", *(_short([_least(a, scene) for a in found]) for scene in scenes), ""]]
    held = [_short([_held(a, scene) for a in found]) for scene in scenes]
    rows += [["|Φ| of the cheapest", *held, ""]] if {*held} - {NO_VALUE} else []
    for label in sorted(own, key=lambda label: (-reached[label], -first[label])):
        cells = [_cell(found, scene, own[label].get(scene)) for scene in scenes]
        form = form_name(r for s in own[label].values() for r in s.ok)
        name = words.names[label] + form_behind(words.names[label], form)
        rows.append([name, *cells, _failed([*own[label].values()])])
    targets = _BETWEEN.join(a.question.accuracy for a in found)
    least = COSTS[question.cost].least
    return Table(
        f"{least[0].upper()}{least[1:]} to {targets} in {question.quantity}, and multiples",
        ["integrator", *map(scene_name, scenes), "runs that failed"],
        rows,
        best={(0, j) for j in range(len(scenes) + 1)},
        code=(),
    )


#: What the cells of `multiples_table` mean.
MULTIPLES_NOTE = (
    'The row "least" has the lowest cost for each accuracy; other rows are multiples of it, sorted '
    "by how often an accuracy is reached. far: all runs that reached the end have a larger error. "
    "unknown: reached at a cost that is not known. A status such as newton_failed: no run "
    f"reached the end. {_UNJUDGED}: the reference cannot judge the accuracy. {NO_VALUE}: not tried "
    'or not supported; in the row "least": not reached. |Φ|: largest over time. A word at '
    "the end of a cell holds for all tighter accuracies, too."
)


def _least(answer: Answer, scene: str) -> str:
    if scene not in answer.scenes:
        return _UNJUDGED
    values = [e.value for e in answer.scenes[scene].entries.values() if e.value is not None]
    return cost_text(min(values), answer.question.cost) if values else NO_VALUE


def _held(answer: Answer, scene: str) -> str:
    own = answer.scenes.get(scene)
    return (own.violation(answer.question.target) if own else "") or NO_VALUE


def _cell(found: Sequence[Answer], scene: str, series: Series | None) -> str:
    if series is None:
        return NO_VALUE
    if not series.ok:
        return ", ".join(dict.fromkeys(r.status for r in series.records))
    judged = (answer.scenes.get(scene) for answer in found)
    states = [own.entries[series.label].state if own else _UNJUDGED for own in judged]
    return _short([state if isinstance(state, str) else _multiple(state) for state in states])


def _short(cells: Sequence[str]) -> str:
    """The cells as one; a word at the end stands once."""
    kept = [*cells]
    while len(kept) > 1 and kept[-1] == kept[-2] and not kept[-1][0].isdigit():
        kept.pop()
    return _BETWEEN.join(kept)


def _multiple(ratio: float) -> str:
    if ratio == math.inf:
        return "∞"
    return "1" if ratio == 1 else f"{ratio:.3g}" if ratio < 10 else number(round(ratio))


def _failed(series: Sequence[Series]) -> str:
    """'7 of 36: diverged, newton_failed'; of interrupted and unsupported runs nothing."""
    runs = [r for s in series for r in s.records if r.status not in NOT_TRIED]
    lost = [r.status for r in runs if r.status != "ok"]
    kinds = [status for status, _ in Counter(lost).most_common()]
    return f"{len(lost)} of {len(runs)}: {', '.join(kinds)}" if lost else "0"


def energy_table(
    question: Question, drifts: Mapping[str, Mapping[str, float]], words: Words
) -> Table:
    """The change of the energy, a row for each method; ``drifts`` are by scene and label."""
    labels = dict.fromkeys(label for own in drifts.values() for label in own)
    rows = [
        [words.names[label], *(number(own.get(label)) for own in drifts.values())]
        for label in labels
    ]
    return Table(
        f"Change of the energy in the cheapest run that reaches {question.accuracy} in "
        f"{question.quantity}",
        ["integrator", *map(scene_name, drifts)],
        rows,
        code=(),
        note="The largest change over time, relative to the motion's largest kinetic energy. "
        f"{NO_VALUE}: no run reaches the accuracy, or the integrator was not tried on the scene.",
    )


def energy_drifts(found: Answer) -> dict[str, dict[str, float]]:
    """By scene and label the change of the energy in the cheapest run that reaches the accuracy."""
    drifts = {
        scene: {
            label: entry.run.energy_drift
            for label, entry in answer.entries.items()
            if entry.run and entry.run.energy_drift is not None
        }
        for scene, answer in found.scenes.items()
    }
    return {scene: own for scene, own in drifts.items() if own}
