"""The guide "Choosing an integrator": advice for each kind of system, from a store alone."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from bench.results.quantities import NORM, NORMS, quantity
from bench.results.records import Environment, counted
from bench.results.table import Table
from reports.pages.templating import code, escape_markdown, markdown
from reports.questions.advice import on_costs, on_energy, on_scenes
from reports.questions.answers import Answer, answers
from reports.questions.kinds import KINDS, Kind, scenes_of_kind
from reports.questions.phrases import Sentence, plain
from reports.questions.question import TABLE_TARGETS, Question
from reports.questions.words import Words
from reports.questions.wrong import NOTE, never_right, wrong_on
from reports.scenes import StoredRuns, stored_runs
from reports.text.choosing_tables import (
    MULTIPLES_NOTE,
    energy_drifts,
    energy_table,
    multiples_table,
)
from reports.text.measurement import times_sentence

#: The option of a command that says where its results are.
_FOLDER = re.compile(r" --out[ =]\S+")
#: The options at the end of a command that choose scenes and integrators of a suite.
_CHOICE = re.compile(r"(?: (?:-[pi]|--problem|--integrator)[ =]?(?:'[^']*'|\S+))+$")


def heading_anchor(heading: str) -> str:
    """Return the address that Markdown's readers give to a heading."""
    return re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-")


@dataclass(frozen=True)
class Advice:
    """Sentences in paragraphs, and the tables of the numbers that they follow from."""

    kind: Kind
    #: The group in question, or "energy".
    about: str
    paragraphs: list[list[Sentence]]
    tables: list[Table]

    @property
    def key(self) -> str:
        return f"{self.kind.key}-{self.about}"

    @property
    def heading(self) -> str:
        """The heading of the tables."""
        words = quantity(self.about) if self.kind.groups else self.about
        return f"{self.kind.name}: {words}"

    @property
    def texts(self) -> list[str]:
        """The paragraphs in Markdown; each leads to the tables."""
        anchor = heading_anchor(self.heading)
        return [
            f"{escape_markdown(' '.join(map(plain, own)))} [↓](#{anchor})"
            for own in self.paragraphs
            if own
        ]


@dataclass(frozen=True)
class KindAdvice:
    """The advice for one kind of system."""

    kind: Kind
    scenes: str
    advice: list[Advice]


def measured_with(environments: Sequence[Environment]) -> list[str]:
    """Dates, versions, machines and commands; not the folders they wrote to.

    Invocations that chose from a suite are counted with the one that ran all of it.
    """
    commands: dict[str, list[str]] = {}
    for environment in environments:
        version = environment.versions.get("stepbench", "of unknown version")
        machine = f"{environment.cpu}, {counted(environment.cores, 'core')}"
        text = f"{environment.date[:10]}, stepbench {version}, {machine}:"
        commands.setdefault(text, []).append(_FOLDER.sub("", environment.command))
    said = []
    for text, own in commands.items():
        wholes = [whole if (whole := _CHOICE.sub("", c)) in own else c for c in own]
        for whole in dict.fromkeys(wholes):
            parts = sum(w == whole != c for w, c in zip(wholes, own, strict=True))
            also = f", and {counted(parts, 'time')} with a choice of scenes or integrators"
            said.append(f"{escape_markdown(text)} {code(whole)}{also if parts else ''}")
    return said


def _wrapped(text: str) -> str:
    return textwrap.fill(escape_markdown(text), 100, break_long_words=False, break_on_hyphens=False)


def choosing_in_markdown(folder: Path) -> str:
    """Return the guide in Markdown; every sentence follows from the records of the run folder.

    Raises
    ------
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    stored = stored_runs(folder)
    return markdown(
        "choosing.md.j2",
        stored=stored,
        environments=measured_with(list(stored.environments.values())),
        sections=sections(stored),
        norm=NORMS[NORM],
        times=_wrapped(times_sentence(stored.times)),
        wrong=_wrapped(NOTE),
        note=_wrapped(MULTIPLES_NOTE),
        anchor=heading_anchor,
    )


def sections(stored: StoredRuns) -> list[KindAdvice]:
    """Return the advice for every kind of system, from the runs of a store."""
    words = replace(stored.words, brief=True)
    groups = dict.fromkeys(group for kind in KINDS for group in kind.groups)
    found = answers(stored.series, [*groups, "q"], TABLE_TARGETS)
    return [_section(kind, stored, found, words) for kind in KINDS]


def _section(
    kind: Kind, stored: StoredRuns, found: Mapping[Question, Answer], words: Words
) -> KindAdvice:
    scenes = [k for k in scenes_of_kind(kind, stored.scenes) if stored.series.get(k)]
    made = [_on_group(kind, group, scenes, stored, found, words) for group in kind.groups]
    # The accuracy of the runs whose energy is compared.
    coarse = Question("q", 1e-2, stored.first.cost)
    if not kind.groups and coarse in found:
        drifts = energy_drifts(found[coarse].on(scenes))
        said, table = [on_energy(coarse, drifts, words)], energy_table(coarse, drifts, words)
        made = [Advice(kind, "energy", said, [table])] if drifts else []
    return KindAdvice(kind, escape_markdown(plain(on_scenes(scenes))), [own for own in made if own])


def _on_group(
    kind: Kind,
    group: str,
    scenes: Sequence[str],
    stored: StoredRuns,
    found: Mapping[Question, Answer],
    words: Words,
) -> Advice | None:
    asked = [Question(group, target, stored.first.cost) for target in TABLE_TARGETS]
    own = [found[question].on(scenes) for question in asked if question in found]
    having = {name for answer in own for name in (*answer.scenes, *answer.unjudged)}
    runs = {name: stored.series[name] for name in scenes if name in having}
    if not runs:
        return None
    wrong = {k: [wrong_on(s, group, stored.scenes.get(k)) for s in own] for k, own in runs.items()}
    said = [*on_costs(own, words), never_right(group, wrong, words, most=6)]
    by = [own, [answer.beside for answer in own if answer.beside]]
    return Advice(kind, group, said, [multiples_table(one, runs, words) for one in by if one])
