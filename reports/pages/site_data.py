"""Data for the scripts of the pages, as plain values."""

from __future__ import annotations

import json
import math
import shlex
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

from bench.results.quantities import ASKED, COSTS, ERROR_NAMES, NORM, NORMS, TRUST
from bench.results.records import (
    NOT_TRIED,
    TIMING_SECONDS,
    UNSUPPORTED,
    Record,
    SceneRecord,
    counted,
)
from bench.results.table import short_exponent
from bench.results.timings import FEWEST, LEAST_OF_FEW, by_round, median_interval
from reports.charts.mechanism import little_picture
from reports.formatting import symbols, tie_text
from reports.names import FAMILIES, form_name, scene_name
from reports.pages.method_page import plugin_option
from reports.pages.page import page_file
from reports.pages.report import Report
from reports.questions import (
    BOTH,
    GRID,
    KINDS,
    Filters,
    Piece,
    Question,
    Ref,
    Sentence,
    filters,
    kind_of,
    method_ref,
    tag_name,
)
from reports.ranking import Answer, SceneAnswer, answers
from reports.scenes import NO_FACTS, NO_SCENE
from reports.series import Series, groups_of, label_of, ok_runs, reference_error
from reports.verdicts import HEADLINES, LATER, WRONG_A, failings, violation_size
from reports.wrong import wrong_runs, wrong_sentences

#: Stands for a zero in a column.
_LEAST = 1e-40
#: Signs of an integrator that has no cost, before all letters.
_SIGNS = {"unknown": "?", "far": "-", "failed": "!"}


def site_data(report: Report) -> dict[str, Any] | None:
    """All that the scripts know: methods, scenes, runs, and answers to all questions.

    None without errors: there is nothing to ask.
    """
    first, measured = report.stored.first, report.measured
    series = [s for own in measured.values() for s in own]
    families = {s.label: s.family for s in series}
    samples = max((len(r.run_s) for s in series for r in s.records), default=0)
    places = {label: k for k, label in enumerate(families)}
    methods = [method_ref(label, report.names) for label in families]
    scenes = report.stored.scenes
    chosen = filters({k: scenes.get(k, NO_SCENE).tags for k in measured})
    if not (groups := groups_of(ok_runs(series), ASKED)):
        return None
    norms = [f"{g}|{norm}" for norm in NORMS if norm != NORM for g in groups]
    columns = [*groups, *COSTS, *norms]  # errors and costs of a run: "a", "a|rms"
    return {
        "norms": NORMS,
        "trust": TRUST,
        "not_tried": sorted(NOT_TRIED),
        "group_names": {g: ERROR_NAMES[g] for g in groups},
        "cost_names": {c: cost.title for c, cost in COSTS.items()},
        "cost_words": {c: cost.words for c, cost in COSTS.items()},
        "least": {c: cost.least.capitalize() for c, cost in COSTS.items()},
        "both": BOTH,
        "headlines": HEADLINES,
        "later": LATER,
        "wrong_a": WRONG_A,
        "units": {c: cost.unit for c, cost in COSTS.items()},
        "apart": {c: cost.tie for c, cost in COSTS.items()},
        # Numbers of `bench.results.timings.quotient`; ``cuts``: samples left out at each end.
        "cuts": [0, *(round(median_interval(range(n))[0]) for n in range(1, samples + 1))],
        "fewest": FEWEST,
        "few": LEAST_OF_FEW,
        "long": TIMING_SECONDS,
        "ties": {cost: tie_text(cost) for cost in COSTS},
        "targets": [replace(first, target=t).accuracy for t in GRID],
        "first": {
            "group": first.group,
            "target": first.accuracy,
            "norm": NORM,
            "cost": first.cost,
            "highlight": report.mine,
        },
        "kinds": [*map(tag_name, KINDS), "others"],
        "filters": [
            {"id": key, "name": name, "scenes": [[*measured].index(k) for k in own]}
            for key, (name, own) in chosen.items()
        ],
        "methods": [_method(report, series, *pair) for pair in families.items()],
        "scenes": [_scene(k, own, scenes.get(k, NO_SCENE), places) for k, own in measured.items()],
        "columns": columns,
        "runs_of": [[_runs(s, places, columns) for s in own] for own in measured.values()],
        **_answers(answers(measured, groups, GRID, tuple(NORMS)), groups, measured, places),
        "wrong": {g: _wrong(report, g, chosen, methods) for g in groups},
    }


def _method(report: Report, series: Sequence[Series], label: str, family: str) -> dict[str, Any]:
    style, (name, pattern, _) = report.styles[label], label.partition(" x ")
    return {
        "label": label,
        "short": report.names[label],
        "family": FAMILIES.get(family, family),
        "form": form_name(r for s in series if s.label == label for r in s.ok),
        "light": style.color,
        "dark": style.dark,
        "shape": style.shape,
        "dash": list(style.dash),
        "page": page_file("method", label),
        "command": "" if pattern else shlex.quote(name),
        "plugins": plugin_option(report.stored.plan.integrators.get(name, NO_FACTS)),
    }


def _scene(
    name: str, series: Sequence[Series], scene: SceneRecord, places: Mapping[str, int]
) -> dict[str, Any]:
    ok = [r for s in series for r in s.ok]
    groups = groups_of(ok, ASKED)
    norms = [(g if norm == NORM else f"{g}|{norm}", g, norm) for g in groups for norm in NORMS]
    floors = {name: TRUST * reference_error(ok, g, norm) for name, g, norm in norms}
    options = name.partition("[")[2].rstrip("]")  # for which a heading has no room
    return {
        "id": name,
        "name": scene_name(name),
        "command": shlex.quote(name),
        "kind": kind_of(scene.tags),
        "about": " · ".join([*filter(None, [options]), *map(tag_name, scene.tags[:2])]),
        "page": page_file("scene", name),
        "groups": groups,
        "wrong_a": [places[s.label] for s in series if s.never_right("a")],
        "picture": little_picture(scene.drawings),
        "floor": {g: float(f"{floor:.3g}") for g, floor in floors.items() if floor > 0},
    }


# ---- runs --------------------------------------------------------------------------------
def _runs(series: Series, places: Mapping[str, int], columns: Sequence[str]) -> dict[str, Any]:
    """The runs of one method on one scene, from coarse to fine; a column is null if empty.

    ``options`` are those of `stepbench solve` that repeat them, ``samples`` times in s by round.
    """
    found = [[_value(r, name) for r in series.records] for name in columns]
    endings = [r.status for r in series.records]
    refused = {*endings} == {UNSUPPORTED}
    return {
        "method": places[series.label],
        "resolutions": [r.resolution.split(",")[0].split(" ")[0] for r in series.records],
        "options": [
            f"--{'step' if r.controls == 'step' else 'rtol'} {short_exponent(repr(r.size))}"
            for r in series.records
        ],
        "columns": [own if any(own) else None for own in found],
        "samples": [
            {f"{i}-{k}": _short(x, 6) for (i, k), x in by_round(r).items()} for r in series.records
        ],
        "phi": [violation_size(r) for r in series.records],
        **({"endings": endings} if {*endings} != {"ok"} else {}),
        **({"refused": series.records[0].message} if refused else {}),
    }


def _value(record: Record, name: str) -> float | None:
    """A cost, or an error of a run that reached the end; None for none that an axis can show."""
    digits = 5
    if name in COSTS:
        value, digits = record.cost(name), 7  # of which a script shows quotients
    else:
        group, _, norm = name.partition("|")
        value = record.error(group, norm or NORM) if record.status == "ok" else None
    # A zero has no logarithm; it is drawn at the edge of the chart.
    return None if value is None else _short(min(max(value, _LEAST), 1 / _LEAST), digits)


def _short(value: float, digits: int = 5) -> float:
    """A number as short as a chart needs it; it stays on its side of the nearest power of ten, and
    a script shows the three digits of it that Python does."""
    short, power = float(f"{value:.{digits}g}"), 10.0 ** round(math.log10(value))
    if (short > power) != (value > power) or f"{short:.3g}" != f"{value:.3g}":
        short = value
    # Halves between three digits are rounded up by a script, by Python to an even digit.
    half = short == float(f"{short:.4g}") and f"{short:.3e}"[4] == "5"
    return math.nextafter(short, 0.0) if half and float(f"{short:.3g}") < short else short


# ---- answers -----------------------------------------------------------------------------
def _answers(
    found: Mapping[Question, Answer],
    groups: Sequence[str],
    measured: Mapping[str, Sequence[Series]],
    places: Mapping[str, int],
) -> dict[str, Any]:
    """The answers by "group|norm|cost": of each scene its place in ``verdicts``, or -1.

    A verdict has places in ``details``: of a text per method in the order of the scene's runs, then
    of the ties for each accuracy that can be judged. A text has a letter per accuracy: that of the
    run (A is the coarsest), or one of `_SIGNS`; it is empty if the method was not tried. Ties are
    how they count (0: nothing to compare, 1: alone, 2: tied), and the places of the winners; one
    that ties from a later start alone has -1 minus its place.
    """
    details: dict[str, int] = {}
    verdicts: dict[str, int] = {}

    def kept(known: dict[str, int], value: object) -> int:
        return known.setdefault(json.dumps(value, separators=(",", ":")), len(known))

    def verdict(name: str, over: Sequence[Answer]) -> int:
        own = [answer.scenes[name] for answer in over if name in answer.scenes]
        if not own:
            return -1
        parts: list[object] = [_letters(s.label, own) for s in measured[name]]
        for answer in own:
            ties = (-1 - places[k] if k in answer.later else places[k] for k in answer.tied)
            parts.append([(1 + (len(answer.tied) > 1)) * answer.votes, *ties])
        return kept(verdicts, [kept(details, part) for part in parts])

    listed = {}
    for group, norm, cost in product(groups, NORMS, COSTS):
        over = [found[Question(group, t, cost, norm)] for t in GRID]
        listed[f"{group}|{norm}|{cost}"] = [verdict(name, over) for name in measured]
    return {
        "answers": listed,
        "details": [*map(json.loads, details)],
        "verdicts": [*map(json.loads, verdicts)],
    }


def _letters(label: str, answers: Sequence[SceneAnswer]) -> str:
    """The cheapest run of an integrator for each accuracy, as letters."""
    if label not in answers[0].entries:
        return ""
    own = [answer.entries[label] for answer in answers]
    letters = {r.key: chr(ord("A") + k) for k, r in enumerate(own[0].series.records)}
    return "".join(letters[e.run.key] if e.run else _SIGNS[str(e.state)] for e in own)


def _failed(scene: str, report: Report) -> list[Sentence]:
    """A sentence on the runs on a scene that failed, if any did: whose, how, what is hard there."""
    runs = [r for s in report.measured[scene] for r in s.records if r.status not in NOT_TRIED]
    failed = [r for r in runs if r.status != "ok"]
    if not failed:
        return []
    ends: dict[str, Counter[str]] = {}
    for r in failed:
        ends.setdefault(r.status, Counter())[label_of(r)] += 1
    how: Sentence = []
    for end, whose in sorted(ends.items(), key=lambda item: -item[1].total()):
        for label, _ in whose.most_common():
            how += [", " if how else "", method_ref(label, report.names)]
        how.append(f" ({end.replace('_', ' ')})")
    known = report.stored.scenes.get(scene, NO_SCENE).difficulties[:1]
    hard = [symbols(f" Difficulty: {text}.") for text in known]
    count = f"Reasons of {len(failed)} of {counted(len(runs), 'run')}"
    return [["Failed: ", *how, ".", *hard, " ", Ref("failed", scene, count), "."]]


def _wrong(report: Report, group: str, chosen: Filters, methods: Sequence[Ref]) -> dict[str, Any]:
    """Sentences on runs that are silently wrong: per filter, scene and method."""
    stored, ids = report.stored, report.run_ids
    wrong = wrong_runs(stored, group)
    scenes = {r.key: k for k, own in report.measured.items() for s in own for r in s.records}
    anchors = {page.values["key"]: page.values["anchor"] for page in report.scenes}

    def linked(piece: Piece) -> str | dict[str, str]:
        """A part of a sentence: text, or a reference with its page."""
        if isinstance(piece, str):
            return piece
        if piece.kind == "run":
            page = f"{page_file('scene', scenes[piece.key])}#{ids[piece.key]}"
        elif piece.kind == "failed":
            page = f"{page_file('scene', piece.key)}#{anchors[piece.key]}-failed"
        else:
            page = page_file(piece.kind, piece.key)
        return {"kind": piece.kind, "key": piece.key, "text": piece.text, "page": page}

    def said(names: Collection[str], here: str = "") -> list[list[Any]]:
        own = [w for w in wrong if w.scene in names]
        failed = _failed(here, report) if here else []
        sentences = failed + wrong_sentences(own, group, report.names, here)
        return [[*map(linked, parts)] for parts in sentences]

    return {
        "filters": {key: said(names) for key, (_, names) in chosen.items()},
        "scenes": [said([name], name) for name in report.measured],
        "methods": [
            [[*map(linked, own)] for own in failings(m.key, group, stored, wrong)] for m in methods
        ],
    }
