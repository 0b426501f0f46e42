"""Sizes of a large report's pages: 18 scenes with 50 methods and 20 runs each.

python tests/benchmarks/report_size.py [FOLDER]
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from planted import curves, planted

from bench.results.records import Plan, SceneRecord
from bench.results.store import Store
from reports.pages.chapter import FOLDER
from reports.pages.html_report import write_html_report

SCENES, METHODS, RUNS = 18, 50, 20
TAGS = ("constrained", "mechatronic", "stiff", "smooth", "conservative")
GROUPS = {"q": 0.1, "v": 1.0, "a": 3.0, "lam": 4.0}


def plant_many(folder: Path) -> Path:
    """Plant the store: methods of orders 1 to 5, of which some fail or stay far on some scenes."""
    with Store(folder, create=True) as store:
        for i in range(SCENES):
            name = f"scene_{i + 1}"
            sizes = {"nq": 2, "nl": 1, "nx": 0, "ny": 0}
            scene = SceneRecord(
                problem=name,
                t_end=1.0,
                title=f"Scene {i + 1}.",
                sizes=sizes,
                t0=0.0,
                reference_method="closed form",
                reference_error=dict.fromkeys(GROUPS, 1e-15),
                reference=curves(1.0, {"q": 2}),
                drawings=[{"t": 0.0, "lines": [[(0.0, 0.0), (1.0, 0.2 * i), (2.0, 0.5)]]}],
                tags=[TAGS[i % 5], TAGS[(i + 2) % 5]],
            )
            store.keep(scene)
            for m in range(METHODS):
                order, label = 1 + m % 5, f"method_{m % 10}[rho_inf={m // 10 / 10}]"
                for k in range(RUNS):
                    fails = (m + i) % 17 == 0 and k < 6
                    groups = {g: (c * (1 + m % 7), order) for g, c in GROUPS.items()}
                    record = planted(
                        name,
                        label,
                        {} if fails else groups,
                        h=0.1 / 1.4**k,
                        family=f"family_{m % 10}",
                        status="newton_failed" if fails else "ok",
                        work={"steps": 14 * 2**k, "residuals": round((10 + m) * order * 1.4**k)},
                    )
                    store.save(record, curves(1.0, {"q": 1}))
                    for n in range(2):
                        store.add_sample(record.key, n, 1e-6 * record.work["residuals"] * (1 + n))
        store.keep(Plan(name="large", title="Large", samples=2, budget_s=1.0, studies=[]))
    return folder


def main() -> None:
    """Plant, write, and print."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
    if not (folder / "stepbench.sqlite").exists():
        plant_many(folder)
    start = time.perf_counter()
    front = write_html_report(folder)
    print(f"written in {time.perf_counter() - start:.1f} s: {SCENES} x {METHODS * RUNS} runs")
    rest = folder / FOLDER
    for file in (front, rest / "data.js", rest / "scene-scene_1.html"):
        print(f"{file.stat().st_size / 1e3:10.0f} kB  {file.name}")


if __name__ == "__main__":
    main()
