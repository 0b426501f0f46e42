"""Make README's picture and the times of docs/iftomm.md; `make pictures`.

Runs that an earlier attempt has measured are kept in the folders of results.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

from chromium import chromium

from bench.results.demands import overviews
from bench.results.store import Store
from reports.pages.templating import markdown_table

DOCS = Path(__file__).parents[1] / "docs"
MEASURED = "stepbench-pictures-full", "stepbench-pictures-iftomm"
#: The line of docs/iftomm.md from which on it is written here.
TIMES = "## Times"


def stepbench(*arguments: object, **more: Any) -> Any:
    command = [str(Path(sys.executable).parent / "stepbench"), *map(str, arguments)]
    return subprocess.run(command, check=True, **more)


def main() -> None:
    """Measure the suites if they are not, then write and draw."""
    full, iftomm = map(Path, MEASURED)
    stepbench("run", "full", "--out", full)
    stepbench("recommend", "iftomm", "--rule", "iftomm", "--out", iftomm)
    with Store(iftomm) as store:
        machines = store.environments().values()
        made = [f"- {e.name}, stepbench {e.versions['stepbench']}: `{e.command}`" for e in machines]
        tables = map(markdown_table, overviews(store.plan(), store.records()))
    times = "\n\n".join(["\n".join(["Measured with:", "", *made]), *tables])
    page = DOCS / "iftomm.md"
    page.write_text(f"{page.read_text().partition(TIMES)[0]}{TIMES}\n\n{times}\n")
    with chromium("window-size=1400,1120") as page:
        page.get((full.absolute() / "report.html").as_uri())
        page.save_screenshot(str(DOCS / "report.png"))


if __name__ == "__main__":
    main()
