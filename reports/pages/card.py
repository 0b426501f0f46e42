"""A summary card for a slide or a README: the answer to a question in sentences and one chart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from bench.results.quantities import COSTS, RANKED_COSTS, checked_group
from problems.spec import SpecError, one_of, suggest
from reports.charts.card_charts import card_chart
from reports.charts.rendering import png_of
from reports.charts.svg_text import (
    Box,
    StyledWord,
    fitted,
    svg,
    tag,
    text_line,
    text_width,
    wrapped,
    xml,
)
from reports.formatting import words as listed
from reports.questions.answers import Answer, answer
from reports.questions.method_card import card_sentences
from reports.questions.phrases import Sentence, plain
from reports.questions.question import ALL, FIRST, TARGETS, Question, filters
from reports.questions.sentences import sentences
from reports.questions.wrong import wrong_sentences
from reports.scenes import StoredRuns, stored_runs

WIDTH, HEIGHT = 1200, 630
_MARGIN = 48
_SENTENCES = Box(_MARGIN, 172, 540, 376)
_CHART = Box(640, 172, WIDTH - _MARGIN - 640, 376)
#: Sentences of the answer; one counts the runs that are wrong without warning.
_MOST_SENTENCES = 3
_GREY = "#5a6675"


def write_card(
    folder: Path,
    path: Path,
    *,
    group: str = FIRST.group,
    target: float = FIRST.target,
    cost: str | None = None,
    scenes: str = ALL,
) -> Path:
    """Write the card of a run folder; the suffix of ``path`` says SVG or PNG.

    Parameters
    ----------
    folder
        The run folder.
    path
        The file.
    group, target, cost
        The question; its cost is that by which the results are ranked first if not given.
    scenes
        A tag, for the scenes that have it; or "all".

    Raises
    ------
    SpecError
        If the suffix or a part of the question is another, or there is nothing to show.
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    if path.suffix not in _FORMATS:
        raise SpecError(f"{path.name} is no card; give a name that ends in {listed(_FORMATS)}.")
    stored = stored_runs(folder)
    question = _question(group, target, stored.first.cost if cost is None else cost)
    chosen = {f.key: f for f in filters({k: stored.tags.get(k, ()) for k in stored.series})}
    if scenes not in chosen:
        raise SpecError(f"There is no set of scenes {scenes!r}; {suggest(scenes, chosen)}.")
    found = answer(stored.series, question).on(chosen[scenes].scenes)
    content = card_svg(stored, found, chosen[scenes].name.removesuffix(" scenes"))
    path.write_bytes(_FORMATS[path.suffix](content))
    return path


def card_svg(stored: StoredRuns, found: Answer, scenes: str) -> str:
    """The card as SVG.

    Parameters
    ----------
    stored
        The runs.
    found
        The answer on the scenes that are asked for.
    scenes
        These scenes in a word: all, stiff.
    """
    words, group = stored.words, found.question.group
    wrong = {
        k: own for k, own in stored.wrong(group).items() if k in (found.scenes | found.unjudged)
    }
    mine = card_sentences(stored.mine, found, stored.series, words)[:2] if stored.mine else []
    said = sentences(found, words)[: _MOST_SENTENCES - len(mine)]
    said += [*mine, *wrong_sentences(group, wrong, words)[:1]]
    told = [plain(sentence) for sentence in said]
    if not found.scenes:
        raise SpecError(f"There is nothing to show on a card: {' '.join(told)}")
    wide = WIDTH - 2 * _MARGIN
    accuracy, least = plain(words.accuracy(found.question)), COSTS[found.question.cost].least
    asked = f"{accuracy} · {least} · {scenes} scenes"
    sizes = (s for s in range(40, 26, -2) if text_width(stored.title, s, bold=True) <= wide)
    size = next(sizes, 26)
    rule = {"height": 1, "fill": "#c9d0d9"}
    foot = HEIGHT - 30
    made_by = [e.versions.get("stepbench", "") for e in stored.environments.values()]
    mark = " ".join(["measured by stepbench", *made_by[-1:]]).strip()
    parts = [
        tag("rect", width=WIDTH, height=8, fill="#2456c4"),
        text_line(fitted(stored.title, size, wide, True), _MARGIN, 76, size, font_weight="bold"),
        text_line(fitted(f"Error at most {asked}", 20, wide), _MARGIN, 116, 20, fill=_GREY),
        tag("rect", x=_MARGIN, y=140, width=wide, **rule),
        *_paragraphs(said, _SENTENCES),
        *card_chart(found, stored.series, words, _CHART, stored.mine),
        tag("rect", x=_MARGIN, y=foot - 28, width=wide, **rule),
        text_line(fitted(_measured(stored), 16, wide - 340), _MARGIN, foot, 16, fill=_GREY),
        text_line(mark, WIDTH - _MARGIN, foot, 16, font_weight="bold", text_anchor="end"),
    ]
    return svg(WIDTH, HEIGHT, stored.title, " ".join([f"Error at most {asked}.", *told]), parts)


def _question(group: str, target: float, cost: str) -> Question:
    if target not in TARGETS:
        raise SpecError(f"{target:g} is no target; give one of 1e-1, 1e-2 ... 1e-9.")
    return Question(checked_group(group), target, one_of(cost, RANKED_COSTS, "cost"))


def _measured(stored: StoredRuns) -> str:
    """Date and machine of the last measurement; how many others there are."""
    if not stored.environments:
        return ""
    last = max(stored.environments.values(), key=lambda e: e.date)
    machines = {(e.cpu, e.cores) for e in stored.environments.values()}
    more = f" and {len(machines) - 1} more" if len(machines) > 1 else ""
    return f"{last.date[:10]} · {last.cpu}, {last.cores} cores{more}"


def _paragraphs(said: Sequence[Sentence], box: Box) -> list[str]:
    """The sentences as large as they fit; the last line that fits ends in "…" if they do not."""
    split = [_words(sentence) for sentence in said]
    size, lines = 24, []
    for size in range(24, 14, -1):
        lines = [wrapped(words, size, box.width) for words in split]
        if size * (1.35 * sum(map(len, lines)) + 0.5 * (len(lines) - 1)) <= box.height:
            break
    parts, y = [], box.y + size
    for paragraph in lines:
        for line in paragraph:
            if y > box.y + box.height:
                return parts
            last = y + 1.35 * size > box.y + box.height and line is not lines[-1][-1]
            parts.append(_line([*line, [("…", False)]] if last else line, box.x, y, size))
            y += 1.35 * size
        y += 0.5 * size
    return parts


def _words(sentence: Sentence) -> list[StyledWord]:
    """The words of a sentence; names of methods are bold."""
    found: list[StyledWord] = [[]]
    for part in sentence:
        content, bold = (
            (part, False) if isinstance(part, str) else (part.text, part.kind == "method")
        )
        first, *others = content.split(" ")
        found[-1].append((first, bold))
        found += [[(other, bold)] for other in others]
    return [word for word in ([piece for piece in w if piece[0]] for w in found) if word]


def _line(line: Sequence[StyledWord], x: float, y: float, size: float) -> str:
    pieces = [piece for word in line for piece in (*word, (" ", False))][:-1]
    spans = "".join(
        tag("tspan", xml(t), font_weight="bold") if bold else xml(t) for t, bold in pieces
    )
    return tag("text", spans, x=x, y=y, font_size=size)


def _png(content: str) -> bytes:
    drawn = png_of(content)
    if drawn.reason:
        raise SpecError(drawn.sentence)
    return drawn.content


_FORMATS: dict[str, Callable[[str], bytes]] = {".svg": str.encode, ".png": _png}
