"""Write problems/truth/digits.json, the certain digits of all built-in scenes; `make digits`."""

import json
import sys
from pathlib import Path
from typing import Any

from bench.plugins.registry import Registry, Sources
from bench.running.inventory import load_registry
from bench.running.truth import truth_job
from bench.running.worker import Worker

FILE = Path(__file__).parents[1] / "problems" / "truth" / "digits.json"
#: Instants in parts of the interval, and those of a scene that can be computed twice up to there.
PARTS, SHORT = (0.01, 0.1, 0.5, 1.0), {"n_four_bar": (0.01, 0.05)}


def computed(worker: Worker, name: str) -> dict[str, Any]:
    """The entry of a scene."""
    t0, end = worker.problem(name).interval
    at = [t0 + part * (end - t0) for part in SHORT.get(name, PARTS)]
    found = truth_job(worker, name, None, at)
    return {key: found[key] for key in ("how", "remarks", "rows")}


def text(entries: dict[str, Any]) -> str:
    """All entries as JSON, a row a line."""
    dumped = []
    for name, entry in sorted(entries.items()):
        rows = ",\n".join(json.dumps(row) for row in entry["rows"])
        how, remarks = json.dumps(entry["how"]), json.dumps(entry["remarks"])
        head = f'{json.dumps(name)}: {{"how": {how},\n"remarks": {remarks},\n'
        dumped.append(f'{head}"rows": [\n{rows}]}}')
    return "{\n" + ",\n".join(dumped) + "\n}\n"


if __name__ == "__main__":
    names = sys.argv[1:] or [n for n, p in Registry().problems.items() if not p.reason]
    entries = json.loads(FILE.read_text()) if FILE.exists() else {}
    worker = Worker(load_registry(lambda phase, words: None, Sources()))
    for name in names:
        entries[name] = computed(worker, name)
        print(name, [row["digits"] for row in entries[name]["rows"]], flush=True)
        FILE.write_text(text(entries))
