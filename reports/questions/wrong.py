"""Runs that reach the end and are wrong: how many, which methods are never right, and why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bench.results.quantities import NORM, NORMS, WRONG, quantity
from bench.results.records import Record, SceneRecord, counted
from reports.explanations import wrong_runs
from reports.formatting import number
from reports.questions.phrases import Sentence, listed
from reports.questions.words import Words, scene_ref
from reports.series import Series, with_values

#: The meaning of the verdict.
NOTE = (
    "Wrong without warning is a run that reaches the end with an error above "
    f"{WRONG:g} ({NORMS[NORM]}) and without a note of its own. Where every run of an integrator on "
    "a scene is, its smallest error stands in brackets."
)


@dataclass(frozen=True)
class Wrong:
    """The wrong runs of an integrator on a scene in one group.

    Attributes
    ----------
    judged
        Number of runs that reached the end and have the error.
    silent, warned
        Numbers of those that are wrong without a note of their own, and with one.
    least
        The smallest error, if every run is wrong, its run, and the experiment of the failure atlas
        that explains it.
    """

    label: str
    judged: int
    silent: int
    warned: int
    least: tuple[float, Record, str] | None = None


def wrong_on(s: Series, group: str, scene: SceneRecord | None = None) -> Wrong:
    """The wrong runs of an integrator on a scene."""
    known = with_values(s.ok, lambda r: r.error(group, NORM))
    wrong = [r for _, r in known if r.wrong(group)]
    warned, least = sum(r.message != "" for r in wrong), None
    if s.never_right(group) and (near := s.nearest(group)):
        error, best = near
        least = error, best, wrong_runs(s, group, best, scene)
    return Wrong(s.label, len(known), len(wrong) - warned, warned, least)


def wrong_sentences(
    group: str, found: Mapping[str, Sequence[Wrong]], words: Words
) -> list[Sentence]:
    """How many runs are wrong without warning; who is so in every run on a scene, and why."""
    judged, silent, warned = (
        sum(getattr(w, name) for own in found.values() for w in own)
        for name in ("judged", "silent", "warned")
    )
    if not silent + warned:
        return []
    count = f"{silent or 'none'} of {counted(judged, 'run')} that reached the end"
    about = f"error in {quantity(group)} above {WRONG:g}, {NORMS[NORM]}"
    more = f"; with a warning: {warned}" if warned else ""
    said = f"Wrong without warning: {count} ({about}){more}."
    return [[said], *never_right(group, found, words)]


def never_right(
    group: str, found: Mapping[str, Sequence[Wrong]], words: Words, most: int = 3
) -> list[Sentence]:
    """The integrators whose every run on a scene is wrong, up to ``most`` of them, and why.

    Those with a warning in each stand apart.
    """
    where: dict[str, dict[str, list[Sentence]]] = {"without": {}, "with a": {}}
    causes: dict[str, dict[str, Sentence]] = {}
    for scene, own in found.items():
        for w in own:
            if w.least:
                error, run, cause = w.least
                near: Sentence = [scene_ref(scene), ": "] if len(found) > 1 else []
                near.append(words.run(run, number(error)))
                kind = where["without" if w.silent else "with a"]
                kind.setdefault(w.label, []).append(near)
                if cause:
                    causes.setdefault(cause, {})[scene] = [scene_ref(scene)]
    said: list[Sentence] = []
    for warning, labels in where.items():
        lead = f"Every run wrong in {quantity(group)} {warning} warning: "
        who = ([words.method(k), " (", *listed(own), ")"] for k, own in labels.items())
        said += [[lead, *listed(who, most), "."]] if labels else []
    why = (
        [words.experiment(k), *([" (", *listed(own.values()), ")"] if len(found) > 1 else [])]
        for k, own in causes.items()
    )
    return [*said, ["Why: ", *listed(why, len(causes)), "."]] if causes else said
