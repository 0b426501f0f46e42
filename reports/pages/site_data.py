"""Data for the scripts of the pages: plain values, numbers as columns of short text."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

from bench.results.quantities import ASKED, COSTS, ERROR_NAMES, NORM, NORMS, RANKED_COSTS, TRUST
from bench.results.records import NOT_TRIED, Record, SceneRecord
from reports.charts.mechanism import little_picture
from reports.formatting import tie_text
from reports.names import family_name, form_name, scene_name
from reports.pages.columns import LARGEST, LETTERS, NONE, column
from reports.pages.report import Report
from reports.pages.site import method_page, scene_page
from reports.questions.phrases import Piece
from reports.questions.question import BOTH, GRID, Question, filters, tag_name
from reports.questions.verdict import HEADLINES
from reports.questions.wrong import wrong_sentences
from reports.ranking import SceneAnswer, answers
from reports.series import Series, groups_of, ok_runs, step_or_tolerance, trusted_error

#: Its reciprocal stands for a zero in a column.
_MOST = 10.0**LARGEST
#: Signs of an integrator that has no cost, before all letters.
_SIGNS = {"unknown": "?", "far": "-", "failed": "!"}
#: A question without its accuracy: group, norm and cost.
_Asked = tuple[str, str, str]


class SiteData:
    """Data of the pages of a report: its methods, scenes and runs, and answers to questions."""

    def __init__(self, report: Report) -> None:
        self.report, self.first = report, report.stored.first
        names = list(report.measured)
        self.filters = filters({name: report.words.tags.get(name, ()) for name in names})
        self.series = [s for own in report.measured.values() for s in own]
        self.families = {s.label: s.family for s in self.series}
        self.places = {label: k for k, label in enumerate(self.families)}
        self.groups = groups_of(ok_runs(self.series), ASKED)
        self.found = answers(report.measured, self.groups, GRID, tuple(NORMS))
        self.wrong = {g: report.stored.wrong(g) for g in self.groups}
        self.resolutions: dict[str, int] = {}
        self.runs = [[self._runs(s) for s in own] for own in report.measured.values()]
        self.pages = {
            r.key: f"{scene_page(name)}#{report.run_ids[r.key]}"
            for name, own in report.measured.items()
            for s in own
            for r in s.records
        }

    def everything(self) -> dict[str, Any]:
        """Data of a page that holds all."""
        scenes = [*self.report.measured]
        return {
            **self._facts(),
            **self._runs_of(),
            **self._answers(product(self.groups, NORMS, RANKED_COSTS), scenes),
            "wrong": {g: self._wrong(g, scenes) for g in self.groups},
        }

    def first_question(self) -> dict[str, Any]:
        """Data of the front page for the first question, by both costs.

        Columns have the first three characters of a number: log10 to 2e-4, until the others come.
        """
        group, costs = self.first.group, dict.fromkeys([self.first.cost, *BOTH])
        columns = [k for k, c in enumerate(self.columns) if c in (group, "constraint", *costs)]

        def shortened(text: str) -> str:
            return "".join(text[k : k + LETTERS - 1] for k in range(0, len(text), LETTERS))

        runs = [
            [
                (method, at, [shortened(texts[k]) for k in columns], *endings)
                for method, at, texts, *endings in own
            ]
            for own in self.runs
        ]
        cut = {"letters": LETTERS - 1, "columns": [self.columns[k] for k in columns]}
        asked = [(group, NORM, cost) for cost in costs if group in self.groups]
        wrong = {group: self._wrong(group, [])} if group in self.groups else {}
        found = self._answers(asked, [*self.report.measured])
        return {**self._facts(), **self._runs_of(), **cut, "runs_of": runs, **found, "wrong": wrong}

    def further_questions(self) -> dict[str, Any]:
        """Further data of the front page: all runs and answers."""
        return {
            **self._runs_of(),
            **self._answers(product(self.groups, NORMS, RANKED_COSTS), [*self.report.measured]),
            "wrong": {g: self._wrong(g, []) for g in self.groups},
        }

    def scene(self, name: str) -> dict[str, Any]:
        """Data of a scene's page."""
        place = list(self.report.measured).index(name)
        return {
            **self._facts(),
            **self._runs_of(),
            "runs_of": [own if k == place else [] for k, own in enumerate(self.runs)],
            **self._answers(product(self.groups, NORMS, RANKED_COSTS), [name]),
            "wrong": {g: self._wrong(g, [name]) | {"filters": {}} for g in self.groups},
        }

    @property
    def columns(self) -> list[str]:
        """Errors and costs of a run: "a", "operations", "a|rms"."""
        norms = [f"{g}|{norm}" for norm in NORMS if norm != NORM for g in self.groups]
        return [*self.groups, *RANKED_COSTS, *norms]

    def _facts(self) -> dict[str, Any]:
        report, names = self.report, list(self.report.measured)
        return {
            "title": report.title,
            "runs": len(report.run_ids),
            "failed": report.failed,
            "norms": NORMS,
            "trust": TRUST,
            "not_tried": sorted(NOT_TRIED),
            "group_names": {g: ERROR_NAMES[g] for g in self.groups},
            "cost_names": {c: COSTS[c].title for c in RANKED_COSTS},
            "cost_words": {c: COSTS[c].words for c in RANKED_COSTS},
            "least": {c: COSTS[c].least.capitalize() for c in RANKED_COSTS},
            "both": BOTH,
            "headlines": HEADLINES,
            "units": {c: COSTS[c].unit for c in RANKED_COSTS},
            "ties": {cost: tie_text(cost) for cost in RANKED_COSTS},
            "targets": [replace(self.first, target=t).accuracy for t in GRID],
            "first": {
                "group": self.first.group,
                "target": self.first.accuracy,
                "norm": NORM,
                "cost": self.first.cost,
                "highlight": report.mine,
            },
            "filters": [
                {"id": f.key, "name": f.name, "scenes": [names.index(k) for k in f.scenes]}
                for f in self.filters
            ],
            "methods": [self._method(label, family) for label, family in self.families.items()],
            "scenes": [
                _scene(name, series, report.stored.scenes.get(name))
                for name, series in report.measured.items()
            ],
        }

    def _method(self, label: str, family: str) -> dict[str, Any]:
        style = self.report.styles[label]
        return {
            "label": label,
            "short": self.report.words.names[label],
            "family": family_name(family),
            "form": form_name(r for s in self.series if s.label == label for r in s.ok),
            "light": style.color,
            "dark": style.dark,
            "shape": style.shape,
            "dash": list(style.dash),
            "page": method_page(label),
        }

    # ---- runs ----------------------------------------------------------------------------
    def _runs_of(self) -> dict[str, Any]:
        return {
            "letters": LETTERS,
            "columns": self.columns,
            "resolutions": list(self.resolutions),
            "runs_of": self.runs,
        }

    def _runs(self, series: Series) -> tuple[Any, ...]:
        """The runs of one method on one scene, from coarse to fine.

        They are the method, the place of its resolutions, and text by column; if a run failed, also
        the endings, and the place of each run's ending among them. Most methods have the same steps
        or tolerances: these are kept once, in ``resolutions``.
        """
        control = "h" if series.controls == "step" else "rtol"
        at = f"{control}{column(step_or_tolerance(r) for r in series.records)}"
        texts = [_column(series, name) for name in self.columns]
        place = self.resolutions.setdefault(at, len(self.resolutions))
        found = self.places[series.label], place, texts
        endings = list(dict.fromkeys(r.status for r in series.records))
        if endings == ["ok"]:
            return found
        return *found, endings, [endings.index(r.status) for r in series.records]

    # ---- answers -------------------------------------------------------------------------
    def _answers(self, asked: Iterable[_Asked], scenes: Sequence[str]) -> dict[str, Any]:
        """The answers by "group|norm|cost": of each scene its place in ``verdicts``, or -1.

        A verdict has places in ``details``: of a text per method in the order of the scene's runs,
        then of the ties for each accuracy that can be judged. A text has a letter per accuracy:
        that of the run (A is the coarsest), or one of `_SIGNS`; it is empty if the method was not
        tried, and the place of another method if both do the same. Ties are how they count (0:
        nothing to compare, 1: alone, 2: tied), and the places of the winners.
        """
        details: dict[str, int] = {}
        verdicts: dict[str, int] = {}

        def kept(known: dict[str, int], value: object) -> int:
            return known.setdefault(json.dumps(value, separators=(",", ":")), len(known))

        found: dict[str, list[int]] = {}
        for group, norm, cost in asked:
            over = [self.found[Question(group, t, cost, norm)] for t in GRID]
            key = f"{group}|{norm}|{cost}"
            found[key] = [-1] * len(self.report.measured)
            for k, name in enumerate(self.report.measured):
                own = [answer.scenes[name] for answer in over if name in answer.scenes]
                if own and name in scenes:
                    labels = [s.label for s in self.report.measured[name]]
                    parts = [_letters(label, own, labels) for label in labels]
                    parts += [self._tie(answer) for answer in own]
                    found[key][k] = kept(verdicts, [kept(details, part) for part in parts])
        listed = {"details": details, "verdicts": verdicts}
        return {"answers": found, **{k: [*map(json.loads, own)] for k, own in listed.items()}}

    def _tie(self, answer: SceneAnswer) -> list[int]:
        counts = (1 + (len(answer.tied) > 1)) * answer.votes
        return [counts, *(self.places[label] for label in answer.winners)]

    def _wrong(self, group: str, scenes: Sequence[str]) -> dict[str, Any]:
        """Sentences on runs that are wrong without warning, per filter, and per scene of these."""

        def said(names: Iterable[str]) -> list[list[Any]]:
            own = {k: self.wrong[group][k] for k in names}
            sentences = wrong_sentences(group, own, self.report.words)
            return [[*map(self._piece, parts)] for parts in sentences]

        return {
            "filters": {f.key: said(f.scenes) for f in self.filters},
            "scenes": [said([k] if k in scenes else []) for k in self.report.measured],
        }

    def _piece(self, piece: Piece) -> str | dict[str, str]:
        """A part of a sentence: text, or a reference with its page."""
        if isinstance(piece, str):
            return piece
        pages = {"method": method_page, "scene": scene_page, "run": self.pages.__getitem__}
        pages["atlas"] = "atlas.html#atlas-{}".format
        page = pages[piece.kind](piece.key)
        return {"kind": piece.kind, "key": piece.key, "text": piece.text, "page": page}


def _letters(label: str, answers: Sequence[SceneAnswer], places: Sequence[str]) -> str | int:
    """The cheapest run of an integrator for each accuracy, as letters; or the place of its twin."""
    if label not in answers[0].series:
        return ""
    first = answers[0].contestants[label]
    if first != label:
        return places.index(first)
    runs = answers[0].series[label].records
    letters = {r.key: chr(ord("A") + k) for k, r in enumerate(runs)}
    best = [answer.cheapest.get(label) for answer in answers]
    return "".join(
        letters[own[1].key] if own else _SIGNS[str(answer.entries[label].state)]
        for own, answer in zip(best, answers, strict=True)
    )


def _column(series: Series, name: str) -> str:
    """The numbers of a column; nothing where no run has one."""
    text = column(_value(r, name) for r in series.records)
    return "" if text == NONE * len(series.records) else text


def _scene(name: str, series: Sequence[Series], scene: SceneRecord | None) -> dict[str, Any]:
    ok = [r for s in series for r in s.ok]
    groups = groups_of(ok, ASKED)
    norms = [(g if norm == NORM else f"{g}|{norm}", g, norm) for g in groups for norm in NORMS]
    floors = {name: trusted_error(ok, g, norm) for name, g, norm in norms}
    options = name.partition("[")[2].rstrip("]")  # for which a heading has no room
    tags = [tag_name(tag) for tag in scene.tags[:3]] if scene else []
    return {
        "id": name,
        "name": scene_name(name),
        "about": " · ".join([*filter(None, [options]), *tags]),
        "page": scene_page(name),
        "groups": groups,
        "picture": little_picture(scene.drawings) if scene else [],
        "floor": {g: float(f"{floor:.3g}") for g, floor in floors.items() if floor > 0},
    }


def _value(record: Record, name: str) -> float | None:
    if name in RANKED_COSTS:
        value = record.cost(name)
    else:
        group, _, norm = name.partition("|")
        found = record.error(group, norm or NORM)
        value = found if record.status == "ok" else None
    # A zero has no logarithm; it is drawn at the edge of the chart.
    return 1 / _MOST if value == 0 else value
