"""Data for the scripts of the pages: plain values, numbers as columns of short text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

from bench.results.quantities import ASKED, COSTS, ERROR_NAMES, NORM, NORMS, RANKED_COSTS, TRUST
from bench.results.records import NOT_TRIED, Record, SceneRecord
from reports.charts.mechanism import little_picture
from reports.formatting import tie_text
from reports.names import family_name, form_name, scene_name
from reports.pages.columns import LARGEST, LETTERS, NONE, column
from reports.pages.report import Report
from reports.pages.site import method_page, scene_page
from reports.questions.answers import Answer, SceneAnswer, answers
from reports.questions.cheapest import headline
from reports.questions.phrases import Piece, Ref, Sentence
from reports.questions.profile import Profile, profiles
from reports.questions.question import TARGETS, Filter, Question, filters, tag_name
from reports.questions.sentences import scene_sentence, sentences
from reports.questions.wrong import wrong_sentences
from reports.ranking import contestants, same_times
from reports.series import Series, groups_of, ok_runs, step_or_tolerance, trusted_error

#: Stands for an infinite multiple, which JSON cannot hold; its reciprocal for a zero in a column.
_MOST = 10.0**LARGEST
#: Multiples of the best cost at which a performance profile is stated.
_MULTIPLES = [round(10 ** (k / 10), 4) for k in range(31)]


class SiteData:
    """Data of the pages of a report: its methods, scenes and runs, and answers to questions."""

    def __init__(self, report: Report) -> None:
        self.report, self.first = report, report.stored.first
        self.found = answers(report.measured)
        names = list(report.measured)
        self.filters = filters({name: report.words.tags.get(name, ()) for name in names})
        self.series = [s for own in report.measured.values() for s in own]
        self.families = {s.label: s.family for s in self.series}
        self.places = {label: k for k, label in enumerate(self.families)}
        self.groups = groups_of(ok_runs(self.series), ASKED)
        self.wrong = {g: report.stored.wrong(g) for g in self.groups}
        self.resolutions: dict[str, int] = {}
        records = [r for s in self.series for r in s.ok]
        self.starts = max((len(r.later) for r in records), default=0)
        self.runs = [[self._runs(s) for s in own] for own in report.measured.values()]
        self.pages = {
            r.key: f"{scene_page(name)}#{report.run_ids[r.key]}"
            for name, own in report.measured.items()
            for s in own
            for r in s.records
        }

    def everything(self) -> dict[str, Any]:
        """Data of a page that holds all: a question has verdicts, a sentence per scene."""
        own = self._facts() | self._runs_of() | self._rules_of
        return own | self._answers(self.found, verdicts=True) | self._profiles()

    def first_question(self) -> dict[str, Any]:
        """Data of the front page for the first question.

        Columns have the first three characters of a number: log10 to 2e-4, until the others come.
        """
        first = self.first
        columns = [k for k, c in enumerate(self.columns) if c in (first.group, first.cost)]
        found = {first: self.found[first]} if first in self.found else {}

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
        return {
            **self._facts(),
            **self._runs_of(),
            **cut,
            "runs_of": runs,
            **self._answers(found, numbers=True),
            **self._profiles(found, self.filters[:1]),
        }

    def further_questions(self) -> dict[str, Any]:
        """Further data of the front page: runs, answers without verdicts on scenes, profiles."""
        own = self._runs_of() | self._rules_of | self._profiles()
        return own | self._answers(self.found)

    def scene(self, name: str) -> dict[str, Any]:
        """Data of a scene's page."""
        place = list(self.report.measured).index(name)
        runs = [own if k == place else [] for k, own in enumerate(self.runs)]
        return {
            **self._facts(),
            **self._runs_of(),
            "rules": [r if k == place else None for k, r in enumerate(self._rules_of["rules"])],
            "runs_of": runs,
            **self._answers(self.found, verdicts=True, only=name),
            "profiles": {},
        }

    @property
    def columns(self) -> list[str]:
        """Errors and costs of a run: "a", "operations", "a|rms"; "a@1" from a later start."""
        norms = [f"{g}|{norm}" for norm in NORMS if norm != NORM for g in self.groups]
        later = [f"{g}@{k + 1}" for k in range(self.starts) for g in self.groups]
        return [*self.groups, *RANKED_COSTS, *norms, *later]

    def _facts(self) -> dict[str, Any]:
        report, names = self.report, list(self.report.measured)
        return {
            "title": report.title,
            "runs": len(report.run_ids),
            "failed": report.failed,
            "norms": NORMS,
            "trust": TRUST,
            "starts": self.starts,
            "not_tried": sorted(NOT_TRIED),
            "group_names": {g: ERROR_NAMES[g] for g in self.groups},
            "cost_names": {c: COSTS[c].title for c in RANKED_COSTS},
            "cost_words": {c: COSTS[c].words for c in RANKED_COSTS},
            "units": {c: COSTS[c].unit for c in RANKED_COSTS},
            "ties": {cost: tie_text(cost) for cost in RANKED_COSTS},
            "tie": {cost: COSTS[cost].tie for cost in RANKED_COSTS if not COSTS[cost].is_time},
            "targets": [replace(self.first, target=t).accuracy for t in TARGETS],
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

    @cached_property
    def _rules_of(self) -> dict[str, Any]:
        return {"rules": [self._rules(own) for own in self.report.measured.values()]}

    def _rules(self, series: Sequence[Series]) -> dict[str, Any]:
        """Facts of a scene that its columns do not have, by which answers are found.

        ``alike`` are pairs (method, the first that does the same); ``trusted`` has by norm and
        group the least error that can be judged; ``same_times`` lists of every run those later in
        the list of all runs whose time cannot be told from its own.
        """
        ok, alike = ok_runs(series), contestants(series)
        return {
            "alike": [(self.places[k], self.places[one]) for k, one in alike.items() if k != one],
            "trusted": {
                norm: {g: trusted_error(ok, g, norm) for g in groups_of(ok, ASKED)}
                for norm in NORMS
            },
            "same_times": same_times([r for s in series for r in s.records]),
        }

    def _runs(self, series: Series) -> tuple[Any, ...]:
        """The runs of one method on one scene, from coarse to fine.

        They are the method, the place of its resolutions, and text by column; if a run failed, also
        the endings, and the place of each run's ending among them. Most methods have the same steps
        or tolerances: these are kept once, in ``resolutions``.
        """
        control = "h" if series.controls == "step" else "rtol"
        at = f"{control}{column(step_or_tolerance(r) for r in series.records)}"
        texts = [self._column(series, name) for name in self.columns]
        place = self.resolutions.setdefault(at, len(self.resolutions))
        found = self.places[series.label], place, texts
        endings = list(dict.fromkeys(r.status for r in series.records))
        if endings == ["ok"]:
            return found
        return *found, endings, [endings.index(r.status) for r in series.records]

    def _column(self, series: Series, name: str) -> str:
        """The numbers of a column; nothing where no run has one, or a start changes none."""
        text = column(_value(r, name) for r in series.records)
        first, _, start = name.partition("@")
        usual = column(_value(r, first) for r in series.records if start)
        return "" if text == (usual or NONE * len(series.records)) else text

    # ---- answers -------------------------------------------------------------------------
    def _answers(
        self,
        found: Mapping[Question, Answer],
        verdicts: bool = False,
        only: str = "",
        numbers: bool = False,
    ) -> dict[str, Any]:
        """Sentences by question, on all scenes or one of them, and ``refs``.

        What many sentences refer to stands in ``refs`` once; sentences have its place instead.
        There are ``verdicts``, a sentence per scene, and per filter ``sentences``. ``wrong`` has by
        group the sentences on runs that are wrong without warning, per filter and, with verdicts,
        per scene. Numbers, which pages with all runs find by themselves (answers.js), are per scene
        ``first`` (places of the methods that tie), ``second`` (a method and its multiple) and
        ``states``, a list in the order of the methods: the multiple and the place of the run, one
        of `reports.ranking.STATES`, or None of a method that was not tried; and per filter
        ``headline`` and ``standings`` (method, alone, tied, reached, tried).
        """
        places: dict[Ref, int] = {}

        def plain(said: Sentence) -> list[Piece | int]:
            return [p if isinstance(p, str) else places.setdefault(p, len(places)) for p in said]

        def part(answer: Answer) -> dict[str, Any]:
            said = {"sentences": [plain(said) for said in sentences(answer, self.report.words)]}
            return (
                said
                if not numbers
                else said
                | {
                    "headline": plain(headline(answer, self.report.words)),
                    "standings": [
                        [self.places[s.label], s.alone, s.tied, int(s.reached), s.tried]
                        for s in answer.standings
                    ],
                }
            )

        made = {}
        for question, answer in found.items():
            on = {
                k: None if only not in ("", k) else answer.scenes.get(k)
                for k in self.report.measured
            }
            made[question.key] = {
                "scenes": [own and self._states(name, own) for name, own in on.items() if numbers],
                "verdicts": [
                    own and plain(scene_sentence(answer, name, self.report.words))
                    for name, own in (on if verdicts else {}).items()
                ],
                "filters": {} if only else {f.key: part(answer.on(f.scenes)) for f in self.filters},
            }

        def wrong(group: str, scenes: Sequence[str]) -> list[list[Piece | int]]:
            own = {k: self.wrong[group][k] for k in scenes}
            return [plain(said) for said in wrong_sentences(group, own, self.report.words)]

        told = {
            group: {
                "filters": {} if only else {f.key: wrong(group, f.scenes) for f in self.filters},
                "scenes": [
                    wrong(group, [k] if only in ("", k) else [])
                    for k in (self.report.measured if verdicts else ())
                ],
            }
            for group in dict.fromkeys(q.group for q in found)
        }
        return {"answers": made, "wrong": told, "refs": [self._reference(ref) for ref in places]}

    def _states(self, scene: str, answer: SceneAnswer) -> dict[str, Any]:
        own, second = {s.label: s for s in self.report.measured[scene]}, answer.second
        states: list[Any] = [None] * (1 + max((self.places[k] for k in answer.entries), default=-1))
        for label, entry in answer.entries.items():
            state = entry.state
            if isinstance(state, str) or entry.run is None:
                states[self.places[label]] = state
            else:
                # Methods that do the same have the same run at the same place.
                keys = [r.key for r in own[entry.contestant].records]
                multiple = float(f"{min(state, _MOST):.4g}")
                states[self.places[label]] = [multiple, keys.index(entry.run.key)]
        return {
            "first": [self.places[label] for label in answer.winners],
            "second": second and [self.places[second.label], min(second.ratio or 0.0, _MOST)],
            "states": states,
        }

    def _reference(self, ref: Ref) -> dict[str, str]:
        pages = {"method": method_page, "scene": scene_page, "run": self.pages.__getitem__}
        pages["atlas"] = "atlas.html#atlas-{}".format
        page = pages[ref.kind](ref.key) if ref.kind in pages else f"glossary.html#term-{ref.key}"
        return {"kind": ref.kind, "key": ref.key, "text": ref.text, "page": page}

    # ---- profiles ------------------------------------------------------------------------
    def _profiles(
        self, found: Mapping[Question, Answer] | None = None, chosen: Sequence[Filter] = ()
    ) -> dict[str, Any]:
        """Performance profiles by group and cost of these questions (all), and by filter (all)."""
        cases: dict[tuple[str, str], list[Answer]] = {}
        asked = {(q.group, q.cost) for q in (self.found if found is None else found)}
        for question, answer in self.found.items():
            if (question.group, question.cost) in asked:
                cases.setdefault((question.group, question.cost), []).append(answer)
        made = {
            f"{group}|{cost}": {
                f.key: self._profile([a.on(f.scenes) for a in own]) for f in chosen or self.filters
            }
            for (group, cost), own in cases.items()
        }
        return {"profiles": made}

    def _profile(self, found: Sequence[Answer]) -> dict[str, Any]:
        """Thousandths of the pairs (scene, target) within each multiple, by method and family.

        ``tried`` has the number of pairs of those that were not tried on all.
        """
        own = profiles(found)
        methods = {str(self.places[label]): profile for label, profile in own.methods.items()}
        families = {family_name(family): profile for family, profile in own.families.items()}

        def parts(by_name: Mapping[str, Profile]) -> dict[str, list[int]]:
            return {
                name: [round(1000 * profile.part(m)) for m in _MULTIPLES]
                for name, profile in by_name.items()
            }

        both = (*methods.items(), *families.items())
        return {
            "multiples": _MULTIPLES,
            "pairs": own.pairs,
            "tried": {name: p.pairs for name, p in both if p.pairs < own.pairs},
            "methods": parts(methods),
            "families": parts(families),
        }


def _scene(name: str, series: Sequence[Series], scene: SceneRecord | None) -> dict[str, Any]:
    ok = [r for s in series for r in s.ok]
    groups = groups_of(ok, ASKED)
    floors = {g: trusted_error(ok, g, NORM) for g in groups}
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
        rest, _, start = name.partition("@")
        group, _, norm = rest.partition("|")
        found = record.error(group, norm or NORM, int(start or 0))
        value = found if record.status == "ok" else None
    # A zero has no logarithm; it is drawn at the edge of the chart.
    return 1 / _MOST if value == 0 else value
