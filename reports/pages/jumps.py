"""Scenes whose values jump as a chapter of the report: sampled controllers, and events."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import count

from bench.results.quantities import NORM, WRONG, quantity
from bench.results.records import SceneRecord, counted
from reports.formatting import file_name, number
from reports.names import scene_name
from reports.pages.chapter import Chapter, Section, Text
from reports.scenes import StoredRuns
from reports.series import Series, ok_runs
from reports.tables.jump_tables import JUDGED, events_table, policies_table
from reports.wrong import POLICIES, policy


def jumps_chapter(stored: StoredRuns) -> Chapter:
    """The chapter on these runs: a section for each sampled scene, and for each with events."""
    return Chapter(
        "jumps.html",
        "Sampled and switched",
        "How methods go through instants at which values jump: what a run does at the samples of "
        "a controller, and how it finds the times of events.",
        [*_sampled(stored), *_with_events(stored)],
    )


def _sampled(stored: StoredRuns) -> Iterator[Section]:
    """A section for each scene with a sampled controller, over all policies at samples."""
    families: dict[str, dict[str, tuple[str, Sequence[Series]]]] = {}
    for title, own in stored.series.items():
        if own and (named := policy(scene := stored.scenes.get(title))) and scene:
            families.setdefault(_without_policy(scene), {})[named] = title, own
    for k, found in zip(count(1), families.values(), strict=False):
        ordered = {name: found[name] for name in POLICIES if name in found}
        title = scene_name(next(iter(ordered.values()))[0])
        ignored = ok_runs(ordered["ignore"][1]) if "ignore" in ordered else []
        silent = [r for r in ignored if r.wrong(JUDGED) and not r.message]
        sizes = sorted(e for r in ignored if (e := r.error(JUDGED, NORM)) is not None)
        size = " to ".join(dict.fromkeys(map(number, [*sizes[:1], *sizes[-1:]])))
        verdict = (
            f"The samples are ignored by {counted(len(ignored), 'run')}: error in "
            f"{quantity(JUDGED)} of {size}, however fine the steps; they give the motion of the "
            f"continuous controller. Wrong without warning (above {WRONG:g}): {len(silent)}."
        )
        parts = [
            Text("A controller sees the motion at samples and holds its values between them."),
            Text(verdict, "missing") if ignored else None,
            policies_table({name: own for name, (_, own) in ordered.items()}),
        ]
        yield Section(title, parts, f"jumps-sampled-{k}")


def _without_policy(scene: SceneRecord) -> str:
    """A text that is the same for scenes that differ in the policy alone."""
    others = {p["name"]: p["value"] for p in scene.parameters if p["name"] != "sampling"}
    return f"{scene.problem.partition('[')[0]} {others} {scene.t_end}"


def _with_events(stored: StoredRuns) -> Iterator[Section]:
    for title, own in stored.series.items():
        yield Section(scene_name(title), [events_table(own)], f"jumps-events-{file_name(title)}")
