"""The answers of a report counted again from the stored records, with rules written anew.

Nothing of `reports` is used: what a page shows must follow from the records alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from chromium import chromium, waited

from bench.results.records import Record, median
from bench.results.store import Store
from bench.results.timings import quotient

COSTS = ("operations", "seconds", "residuals")
FACTS = """
const { failed, methods, scenes, filters, targets, profiles, group_names } = stepbench.data;
return { failed, methods, scenes, filters, targets, profiles, groups: Object.keys(group_names) };
"""
ANSWERS = """
const [group] = arguments, { targets, cost_names } = stepbench.data, answers = {};
for (const target of targets) for (const cost in cost_names) {
  stepbench.ask({ group, target, cost });
  answers[`${group}|${target}|${cost}`] = stepbench.answer();
}
return answers;
"""
Run = tuple[float | None, float | None, Record]


def page_data(folder: Path) -> dict[str, Any]:
    """What the front page finds for all questions of its menus, and its profiles."""
    address = (folder / "report.html").as_uri()
    with chromium() as driver:

        def run(script: str, *values: str) -> Any:
            # A new page each time: Chromium refuses the 201st address of one page within 30 s.
            driver.get("about:blank")
            driver.get(address)
            waited(lambda: driver.execute_script("return stepbench.data.complete"))
            return driver.execute_script(script, *values)

        data = run(FACTS)
        answers = [run(ANSWERS, group) for group in data["groups"]]
    return data | {"answers": {key: own for part in answers for key, own in part.items()}}


def faults(folder: Path, data: dict[str, Any]) -> list[str]:
    """What the data of the pages say otherwise than the records of the store."""
    with Store(folder) as store:
        records = list(store.records().values())
    found: list[str] = []

    def check(where: str, shown: Any, counted: Any) -> None:
        if shown != counted:
            found.append(f"{where}: shown {shown}, counted {counted}")

    names = [m["label"] for m in data["methods"]]
    for key, answer in data["answers"].items():
        group, target, cost = key.split("|")
        counted = [
            _scene([r for r in records if r.problem == scene["id"]], group, float(target), cost)
            for scene in data["scenes"]
        ]
        for scene, shown, own in zip(data["scenes"], answer["scenes"], counted, strict=True):
            at = f"{key} on {scene['id']}"
            check(f"{at}: judged", shown is not None, own is not None)
            if not shown or not own:
                continue
            states = {
                names[k]: s if isinstance(s, str) else s[0]
                for k, s in enumerate(shown["states"])
                if s is not None
            }
            check(f"{at}: tried", states.keys(), own["states"].keys())
            for k, state in own["states"].items():
                check(f"{at}: state of {k}", _rounded(states[k], state), _rounded(state))
            check(f"{at}: first", sorted(names[k] for k in shown["first"]), sorted(own["first"]))
            second = shown["second"] and shown["second"][1]
            check(f"{at}: second", _rounded(second, own["second"]), _rounded(own["second"]))
        for chosen in data["filters"]:
            said = answer["filters"][chosen["id"]]["headline"]
            text = "".join(p if isinstance(p, str) else p["text"] for p in said)
            end = _headline([own for k in chosen["scenes"] if (own := counted[k])])
            check(f"{key} on {chosen['id']}: headline", text[-len(end) :], end)
            rows = {
                names[k]: tuple(row) for k, *row in answer["filters"][chosen["id"]]["standings"]
            }
            check(
                f"{key} on {chosen['id']}: standings",
                rows,
                _standings([own for k in chosen["scenes"] if (own := counted[k])]),
            )
    found += _profile_faults(data, records, names)
    return found


def _scene(runs: list[Record], group: str, target: float, cost: str) -> dict[str, Any] | None:
    own: dict[str, list[Record]] = {}
    for r in runs:
        name = r.integrator
        if len(r.pattern) > 1:
            name += " x " + "/".join(f"{f:g}" for f in r.pattern)
        own.setdefault(name, []).append(r)
    own = {
        k: rs for k, rs in own.items() if {r.status for r in rs} - {"unsupported", "interrupted"}
    }
    ok = [r for rs in own.values() for r in rs if r.status == "ok"]
    floor = max((r.reference_error.get(group, {}).get("max", 0) for r in ok), default=0)
    if not any(group in r.errors for r in ok) or 100 * floor > target:
        return None
    twin = _twins(own)
    best: dict[str, tuple[float, Record]] = {}
    states: dict[str, Any] = {}
    able = set()
    for name, rs in own.items():
        reaching = [r for r in rs if r.status == "ok" and _error(r, group) <= target]
        costs = [(c, -_error(r, group), r.key, r) for r in reaching if (c := _cost(r, cost))]
        if reaching:
            able.add(name)
        if costs:
            least = min(costs)
            best[name] = least[0], least[3]
    lone = {name: b for name, b in best.items() if twin[name] == name}
    least, cheapest = min(lone.values(), key=lambda b: b[0], default=(0, None))
    for name, rs in own.items():
        if twin[name] in best:
            states[name] = best[twin[name]][0] / least
        elif twin[name] in able:
            states[name] = "unknown"
        else:
            states[name] = "far" if any(r.status == "ok" for r in rs) else "failed"
    tied = {k for k, (_, r) in lone.items() if cheapest and not _apart(cheapest, r, cost)}
    tied |= {k for k in _first_later(own, twin, group, target, cost) if k in lone}
    rest = sorted(c for k, (c, _) in lone.items() if k not in tied)
    distinct = {twin[k] for k in own}
    return {
        "states": states,
        "first": [k for k in own if twin[k] in tied],
        "second": rest[0] / least if rest else None,
        "alone": len(tied) == 1,
        "votes": len(distinct - {k for k in distinct if states[k] == "unknown"}) > 1,
        "several": len(distinct) > 1,
        "families": {k: rs[0].family for k, rs in own.items()},
    }


def _first_later(
    own: dict[str, list[Record]], twin: dict[str, str], group: str, target: float, cost: str
) -> set[str]:
    """The integrators that are the cheapest, or tie, from a later start of the motion."""
    firsts = set()
    for k in range(max((len(r.later) for rs in own.values() for r in rs), default=0)):
        best: dict[str, tuple[float, float, str, Record]] = {}
        for name, rs in own.items():
            found = []
            for r in (r for r in rs if r.status == "ok" and twin[name] == name):
                error = r.later[k].get(group) if r.later else _error(r, group)
                value = _cost(r, cost)
                if error is not None and error <= target and value:
                    found.append((value, -error, r.key, r))
            if found:
                best[name] = min(found)
        if best:
            cheapest = min(best.values())[3]
            firsts |= {name for name, b in best.items() if not _apart(cheapest, b[3], cost)}
    return firsts


def _rounded(state: Any, near: Any = None) -> Any:
    """A multiple to four digits; that of a page is taken as the one that it is near."""
    if isinstance(state, float | int):
        both = isinstance(near, float) and abs(state - near) <= 5e-5 * near
        return float(f"{near if both else state:.4g}")
    return state


def _error(r: Record, group: str) -> float:
    error = r.errors.get(group, {}).get("max")
    return float("inf") if error is None else error


def _cost(r: Record, cost: str) -> float | None:
    if cost == "operations":
        return sum(r.operations.values()) or None
    return median(r.run_s) if cost == "seconds" else r.work.get(cost)


def _apart(one: Record, two: Record, cost: str) -> bool:
    if cost == "seconds":
        found = quotient(one, two)
        return found is not None and found.differs
    a, b = _cost(one, cost) or 0, _cost(two, cost) or 0
    return max(a, b) > (1.1 if cost == "operations" else 1) * min(a, b)


def _twins(own: dict[str, list[Record]]) -> dict[str, str]:
    """The first integrator that does the same as each."""

    def same(one: Record, two: Record) -> bool:
        alike = one.status == two.status and one.work == two.work and one.pattern == two.pattern
        if (
            not alike
            or (one.h, one.rtol) != (two.h, two.rtol)
            or one.errors.keys() != two.errors.keys()
        ):
            return False
        if _apart(one, two, "operations") or (one.status == "ok" and not one.errors):
            return False
        for g, norms in one.errors.items():
            for norm, a in norms.items():
                b = two.errors[g].get(norm)
                trust = 100 * max(r.reference_error.get(g, {}).get(norm, 0) for r in (one, two))
                if a is None or b is None:
                    if a is not b:
                        return False
                elif max(a, b) > trust and abs(a - b) > 1e-3 * max(a, b):
                    return False
        return True

    found: dict[str, str] = {}
    for name, rs in own.items():
        size = lambda r: -(r.h or r.rtol or 0)  # noqa: E731
        mine = sorted(rs, key=size)
        found[name] = name
        for other in [k for k in found if found[k] == k and k != name]:
            its = sorted(own[other], key=size)
            some = any(r.status == "ok" for r in mine)
            if some and len(its) == len(mine) and all(map(same, mine, its)):
                found[name] = other
                break
    return found


def _standings(scenes: list[dict[str, Any]]) -> dict[str, tuple[int, ...]]:
    rows: dict[str, list[int]] = {}
    for scene in scenes:
        for name, state in scene["states"].items():
            row = rows.setdefault(name, [0, 0, 0, 0])
            first = scene["votes"] and name in scene["first"]
            row[0] += first and scene["alone"]
            row[1] += first and not scene["alone"]
            row[2] += not isinstance(state, str) or state == "unknown"
            row[3] += 1
    return {name: tuple(row) for name, row in rows.items()}


def _headline(scenes: list[dict[str, Any]]) -> str:
    """The end of the headline, in which its numbers are."""
    judged = len(scenes)
    reached = [[s for s in d["states"].values() if s not in ("far", "failed")] for d in scenes]
    every = {1: "the scene", 2: "both scenes"}.get(judged, f"all {judged} scenes")
    firsts = [(own + tied, own) for own, tied, *_ in _standings(scenes).values()]
    count, alone = max(firsts, default=(0, 0))
    if not judged:
        return "No scene here can be judged."
    if not any(reached):
        return f"Nobody reaches it on {every}."
    if not count:
        return "It is reached, but no costs can be compared."
    end = f"cheapest on {every if count == judged else f'{count} of {judged} scenes'}"
    if alone < count:
        return end + (f", alone on {alone}." if alone else ", always tied.")
    missed = sum(not own for own in reached)
    return end + (f"; nobody reaches {missed}." if missed else ".")


def _profile_faults(data: dict[str, Any], records: list[Record], names: list[str]) -> list[str]:
    """Every tenth multiple of each profile, counted pair by pair."""
    found = []
    for key, by_filter in data["profiles"].items():
        group, cost = key.split("|")
        for chosen in data["filters"]:
            shown = by_filter[chosen["id"]]
            pairs = []
            for k in chosen["scenes"]:
                runs = [r for r in records if r.problem == data["scenes"][k]["id"]]
                own = [_scene(runs, group, float(t), cost) for t in data["targets"]]
                pairs += [scene for scene in own if scene and scene["several"]]
            if shown["pairs"] != len(pairs):
                found.append(f"profile {key} {chosen['id']}: {shown['pairs']} pairs, {len(pairs)}")
            lines = {
                name: [s["states"][name] for s in pairs if name in s["states"]] for name in names
            }
            for name, states in lines.items():
                known = [s for s in states if s != "unknown"]
                own = shown["methods"].get(str(names.index(name)))
                for i, multiple in list(enumerate(shown["multiples"]))[::10]:
                    solved = sum(not isinstance(s, str) and s <= multiple for s in known)
                    counted = round(1000 * solved / len(known)) if known else 0
                    if own and abs(own[i] - counted) > 1:
                        found.append(f"profile {key} {name} at {multiple}: {own[i]}, {counted}")
                if bool(own) != bool(states):
                    found.append(f"profile {key}: {name} is shown {bool(own)}")
    return found
