"""Answers to the questions of the front page, as plain data for scripts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from reports.names import family_name
from reports.pages.addresses import method_page, scene_page
from reports.pages.report import Report
from reports.questions.answers import Answer, SceneAnswer, answers
from reports.questions.phrases import Part
from reports.questions.profile import Profile, profiles
from reports.questions.question import Filter
from reports.questions.sentences import scene_sentence, sentences
from reports.series import Series

#: Multiples of the best cost at which a performance profile is stated.
MULTIPLES = [round(10 ** (k / 10), 4) for k in range(31)]


def answers_of(report: Report, filters: Sequence[Filter]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The answers by question, and the performance profiles by group and cost.

    An answer has per scene ``first`` (places of the methods that tie), ``second`` (a method and
    its multiple) and ``states`` of the methods that were tried: the multiple and the place of the
    run, or one of `reports.ranking.STATES`. There are ``verdicts``, a sentence per
    scene, and per filter ``sentences`` and ``standings`` (method, alone, tied, reached, tried).
    """
    scenes = report.series
    labels = dict.fromkeys(s.label for series in scenes.values() for s in series)
    place = {label: k for k, label in enumerate(labels)}
    runs = {
        r.key: f"{scene_page(name)}#{report.run_ids[r.key]}"
        for name, series in scenes.items()
        for s in series
        for r in s.records
    }

    def part(item: Part) -> str | dict[str, str]:
        if isinstance(item, str):
            return item
        pages = {"method": method_page, "scene": scene_page, "run": runs.__getitem__}
        page = (
            pages[item.kind](item.key) if item.kind in pages else f"glossary.html#term-{item.key}"
        )
        return {"kind": item.kind, "key": item.key, "text": item.text, "page": page}

    found, by_cost = {}, {}
    for question, answer in answers(scenes).items():
        by_cost.setdefault((question.group, question.cost), []).append(answer)
        found[question.key] = {
            "scenes": [
                _of_scene(answer.scenes[name], series, place) if name in answer.scenes else None
                for name, series in scenes.items()
            ],
            "verdicts": [
                [part(p) for p in scene_sentence(question, name, answer.scenes[name], report.words)]
                if name in answer.scenes
                else None
                for name in scenes
            ],
            "filters": {},
        }
        for chosen in filters:
            part_of = answer.on(chosen.scenes)
            found[question.key]["filters"][chosen.key] = {
                "sentences": [[part(p) for p in said] for said in sentences(part_of, report.words)],
                "standings": [
                    [place[s.label], s.alone, s.tied, int(s.reached), s.tried]
                    for s in part_of.standings
                ],
            }
    by_group = {
        f"{group}|{cost}": {
            chosen.key: _profile([a.on(chosen.scenes) for a in own], place) for chosen in filters
        }
        for (group, cost), own in by_cost.items()
    }
    return found, by_group


def _of_scene(
    answer: SceneAnswer, series: Sequence[Series], place: Mapping[str, int]
) -> dict[str, Any]:
    own, second = {s.label: s for s in series}, answer.verdict.second
    states: dict[int, Any] = {}
    for label, entry in answer.entries.items():
        state = entry.state
        if isinstance(state, str) or entry.run is None:
            states[place[label]] = state
        else:
            # Methods that do the same have the same run at the same place.
            keys = [r.key for r in own[entry.contestant].records]
            states[place[label]] = [float(f"{state:.4g}"), keys.index(entry.run.key)]
    return {
        "first": [place[label] for label in answer.first],
        "second": [place[second.label], second.ratio] if second else None,
        "states": states,
    }


def _profile(found: Sequence[Answer], place: Mapping[str, int]) -> dict[str, Any]:
    """Thousandths of the pairs (scene, target) within each of `MULTIPLES`, by method and family.

    ``tried`` has the number of pairs of those that were not tried on all.
    """
    own = profiles(found)

    def parts(profile: Profile) -> list[int]:
        return [round(1000 * profile.part(m)) for m in MULTIPLES]

    return {
        "multiples": MULTIPLES,
        "pairs": own.pairs,
        "tried": {
            name: profile.pairs
            for name, profile in (
                *((str(place[label]), own.methods[label]) for label in own.methods),
                *((family_name(family), own.families[family]) for family in own.families),
            )
            if profile.pairs < own.pairs
        },
        "methods": {place[label]: parts(profile) for label, profile in own.methods.items()},
        "families": {
            family_name(family): parts(profile) for family, profile in own.families.items()
        },
    }
