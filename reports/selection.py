"""The runs of one scene in a store, selected by names that a person writes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from bench.results.records import Record, Rows, SceneRecord
from bench.results.store import Store
from problems.base.spec import SpecError, suggest
from reports.names import named_labels
from reports.series import Series, label_of, series_of


class Selection:
    """The runs of one scene that reached the end, as series.

    Parameters
    ----------
    folder
        The run folder.
    scene
        The scene; may be None if the folder has one.
    integrators
        Names, full specs or labels of the integrators; all if empty.
    t_end
        The end of the interval in s, if the folder has the scene over several.

    Raises
    ------
    SpecError
        If a name is not known or not unique, or no run is left.
    bench.results.store.StoreError
        If the folder holds no readable store.
    """

    def __init__(
        self,
        folder: str | Path,
        scene: str | None = None,
        integrators: Sequence[str] = (),
        t_end: float | None = None,
    ) -> None:
        self.folder = Path(folder)
        with Store(self.folder) as store:
            records, scenes = list(store.records().values()), store.scenes()
        key = _one_scene(dict.fromkeys((r.problem, r.t_end) for r in records), scene, t_end)
        self.name = key[0]
        self.scene: SceneRecord | None = scenes.get(key)
        chosen = _chosen([r for r in records if (r.problem, r.t_end) == key], integrators)
        self.series: list[Series] = [s for s in series_of(chosen) if s.ok]
        if not self.series:
            raise SpecError(f"None of these runs on {self.name} reached the end.")

    def rows(self, record: Record) -> Rows:
        """The sampled values of a run."""
        with Store(self.folder) as store:
            return store.rows(record.key)


def group_and_place(
    text: str,
    values: Mapping[str, Sequence[Sequence[float]]],
    components: Mapping[str, Sequence[str]],
) -> tuple[str, int]:
    """Read "a:Y" or "lam:1": a group with values and a place in it, counted from 0.

    Raises
    ------
    SpecError
        If there is no such group or component.
    """
    group, _, place = (part.strip() for part in text.partition(":"))
    known = [name for name, rows in values.items() if rows]
    if group not in known:
        raise SpecError(f"There is no component {group!r}; {suggest(group, known)}.")
    names = {str(i + 1): i for i in range(len(values[group][0]))}
    names |= {text.partition(" [")[0]: i for i, text in enumerate(components.get(group, ()))}
    place = place or "1"
    if place not in names:
        raise SpecError(f"{group} has no component {place!r}; {suggest(place, names)}.")
    return group, names[place]


def _one_scene(
    keys: Iterable[tuple[str, float]], scene: str | None, t_end: float | None
) -> tuple[str, float]:
    keys = list(keys)
    known = list(dict.fromkeys(problem for problem, _ in keys))
    if not known:
        raise SpecError("The store holds no finished run.")
    if scene is None and len(known) > 1:
        raise SpecError(f"Several scenes are stored; choose one with --scene: {', '.join(known)}.")
    name = known[0] if scene is None else scene.strip()
    if name not in known:
        # The bare name is enough if it means one scene.
        meant = [problem for problem in known if problem.partition("[")[0] == name]
        if len(meant) != 1:
            raise SpecError(f"There is no scene {name!r}; {suggest(name, known)}.")
        (name,) = meant
    ends = [end for problem, end in keys if problem == name]
    if t_end is None and len(ends) == 1:
        return name, ends[0]
    if t_end not in ends:
        listed = ", ".join(f"{end:g}" for end in ends)
        raise SpecError(f"{name} is stored to t={listed} s; choose one with --t-end.")
    return name, t_end


def _chosen(records: Sequence[Record], integrators: Sequence[str]) -> list[Record]:
    known = list(dict.fromkeys(label_of(r) for r in records))
    wanted = dict.fromkeys(label for text in integrators for label in named_labels(text, known))
    order = list(wanted) or known
    return [r for label in order for r in records if label_of(r) == label]
