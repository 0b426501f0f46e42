"""Data for the scripts of the pages: plain values, numbers as columns of short text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from bench.results.quantities import COSTS, GROUP_NAMES, GROUPS, NORM, NORMS, RANKED_COSTS, TRUST
from bench.results.records import Record, SceneRecord
from reports.charts.line_styles import LineStyle
from reports.names import family_name, scene_name
from reports.pages.addresses import method_page, scene_page
from reports.pages.report import Report
from reports.pages.site_answers import answers_of
from reports.questions.question import ALL, FIRST, TARGETS, Question, filters, tag_name
from reports.series import Series, cost_of, error_of, groups_of, step_or_tolerance, trusted_error
from reports.text.winners import tie_text

#: Columns hold log10 of a value in this range, in 24 bits.
_LARGEST = 40.0
_STEPS = (1 << 24) - 1
_ALPHABET = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_"
_LETTERS = 4
_NONE = "-" * _LETTERS
#: Most lines and points per line of a scene's little picture.
_LINES, _POINTS = 40, 60


def column(values: Iterable[float | None]) -> str:
    """Positive numbers as text: four characters each, log10 to 3e-6; ``----`` for none."""
    return "".join(map(_four_characters, values))


def _four_characters(value: float | None) -> str:
    if value is None or not 0 < value < math.inf:
        return _NONE
    place = (math.log10(value) + _LARGEST) / (2 * _LARGEST)
    bits = round(min(max(place, 0.0), 1.0) * _STEPS)
    text = "".join(_ALPHABET[bits >> shift & 63] for shift in (18, 12, 6, 0))
    return text if text != _NONE else "---_"


def site_data(report: Report) -> dict[str, Any]:
    """Data for the scripts: methods, scenes, runs, and the answers to all questions."""
    families = {s.label: s.family for series in report.series.values() for s in series}
    labels = list(families)
    names, places = report.words.names, list(report.series)
    groups = [g for g in GROUPS if any(g in _groups(s) for s in report.series.values())]
    chosen = filters({k: report.words.tags.get(k, ()) for k in places})
    answers, profiles = answers_of(report, chosen)
    columns, resolutions = [*groups, *RANKED_COSTS], {}
    runs_of = [
        [_runs(s, labels.index(s.label), columns, resolutions) for s in series]
        for series in report.series.values()
    ]
    return {
        "title": report.title,
        "runs": len(report.run_ids),
        "failed": report.failed,
        "norm": NORMS[NORM],
        "trust": TRUST,
        "group_names": {g: GROUP_NAMES[g] for g in groups},
        "cost_names": {c: COSTS[c].title for c in RANKED_COSTS},
        "cost_words": {c: COSTS[c].words for c in RANKED_COSTS},
        "units": {c: COSTS[c].unit for c in RANKED_COSTS},
        "ties": {cost: tie_text(cost) for cost in RANKED_COSTS},
        "targets": [Question(FIRST.group, t, FIRST.cost).accuracy for t in TARGETS],
        "first": {
            "group": FIRST.group,
            "target": FIRST.accuracy,
            "cost": FIRST.cost,
            "highlight": report.mine if report.mine in families else "",
        },
        "filters": [
            {"id": f.key, "name": f.name, "scenes": [places.index(k) for k in f.scenes]}
            for f in chosen
        ],
        "methods": [
            _method(label, names[label], family, report.styles[label])
            for label, family in families.items()
        ],
        "scenes": [
            _scene(name, series, report.scene_records.get(name))
            for name, series in report.series.items()
        ],
        "letters": _LETTERS,
        "columns": columns,
        "resolutions": list(resolutions),
        "runs_of": runs_of,
        "answers": answers,
        "profiles": profiles,
    }


def for_first_question(data: Mapping[str, Any]) -> dict[str, Any]:
    """The part of the data that the first question needs.

    Its columns have the first three characters of a number: log10 to 2e-4, until the others come.
    """
    kept = [k for k, name in enumerate(data["columns"]) if name in (FIRST.group, FIRST.cost)]
    profiles = data["profiles"].get(f"{FIRST.group}|{FIRST.cost}", {})

    def shortened(text: str) -> str:
        return "".join(text[k : k + _LETTERS - 1] for k in range(0, len(text), _LETTERS))

    return {
        **data,
        "letters": _LETTERS - 1,
        "columns": [data["columns"][k] for k in kept],
        "runs_of": [
            [
                (method, at, [shortened(columns[k]) for k in kept], *endings)
                for method, at, columns, *endings in own
            ]
            for own in data["runs_of"]
        ],
        "answers": {
            key: {name: part for name, part in answer.items() if name != "verdicts"}
            for key, answer in data["answers"].items()
            if key == FIRST.key
        },
        "profiles": {f"{FIRST.group}|{FIRST.cost}": {ALL: profiles[ALL]}} if profiles else {},
    }


def for_scene(data: Mapping[str, Any], place: int) -> dict[str, Any]:
    """The part of the data that is about one scene."""
    return {
        **data,
        "runs_of": [own if k == place else [] for k, own in enumerate(data["runs_of"])],
        "answers": {
            key: {
                "scenes": [own if k == place else None for k, own in enumerate(answer["scenes"])],
                "verdicts": [
                    own if k == place else None for k, own in enumerate(answer["verdicts"])
                ],
                "filters": {},
            }
            for key, answer in data["answers"].items()
        },
        "profiles": {},
    }


def for_front(data: Mapping[str, Any]) -> dict[str, Any]:
    """Further data of the front page: runs, answers without verdicts on scenes, profiles."""
    return {
        **{name: data[name] for name in ("letters", "columns", "resolutions", "runs_of")},
        "profiles": data["profiles"],
        "answers": {k: answer | {"verdicts": []} for k, answer in data["answers"].items()},
    }


def _method(label: str, short: str, family: str, style: LineStyle) -> dict[str, Any]:
    return {
        "label": label,
        "short": short,
        "family": family_name(family),
        "light": style.color,
        "dark": style.dark,
        "shape": style.shape,
        "dash": list(style.dash),
        "page": method_page(label),
    }


def _groups(series: Sequence[Series]) -> list[str]:
    return groups_of(r for s in series for r in s.ok)


def _scene(name: str, series: Sequence[Series], scene: SceneRecord | None) -> dict[str, Any]:
    groups, ok = _groups(series), [r for s in series for r in s.ok]
    floors = {g: trusted_error(ok, g, NORM) for g in groups}
    return {
        "id": name,
        "name": scene_name(name),
        "about": " · ".join(tag_name(tag) for tag in scene.tags[:3]) if scene else "",
        "page": scene_page(name),
        "groups": groups,
        "picture": little_picture(scene) if scene else [],
        "floor": {g: float(f"{floor:.3g}") for g, floor in floors.items() if floor > 0},
    }


def little_picture(scene: SceneRecord) -> list[list[list[int]]]:
    """The last drawing of a scene as lines of whole numbers between 0 and 100, y downwards."""
    drawn = scene.drawings[-1]["lines"][:_LINES] if scene.drawings else []
    lines = [
        [
            (x, y)
            for x, y in line[:: max(1, len(line) // _POINTS)]
            if x is not None and y is not None
        ]
        for line in drawn
    ]
    points = [point for line in lines for point in line]
    if not points:
        return []
    (x0, x1), (y0, y1) = ((min(p[i] for p in points), max(p[i] for p in points)) for i in (0, 1))
    if not all(map(math.isfinite, (extent := max(x1 - x0, y1 - y0, 1e-9), x0, x1, y0, y1))):
        return []
    scale, x, y = 100 / extent, (x0 + x1) / 2, (y0 + y1) / 2
    return [
        [[round(50 + scale * (p - x)), round(50 - scale * (q - y))] for p, q in ln] for ln in lines
    ]


def _runs(
    series: Series, place: int, columns: Sequence[str], resolutions: dict[str, int]
) -> tuple[Any, ...]:
    """The runs of one method on one scene, from coarse to fine.

    They are the method, the place of its resolutions, and text by column; if a run failed, also
    the endings, and the place of each run's ending among them. Most methods have the same steps
    or tolerances: these are kept once, in ``resolutions``.
    """
    control = "h" if series.controls == "step" else "rtol"
    at = f"{control}{column(step_or_tolerance(r) for r in series.records)}"
    texts = [column(_value(r, name) for r in series.records) for name in columns]
    found = place, resolutions.setdefault(at, len(resolutions)), texts
    endings = list(dict.fromkeys(r.status for r in series.records))
    if endings == ["ok"]:
        return found
    return *found, endings, [endings.index(r.status) for r in series.records]


def _value(record: Record, name: str) -> float | None:
    if name in RANKED_COSTS:
        return cost_of(record, name)
    # An error of zero is drawn at the bottom of the chart.
    error = error_of(record, name, NORM) if record.status == "ok" else None
    return 1e-40 if error == 0 else error
