"""Make README's pictures and docs/choosing.md of the current code; `make pictures`, half an hour.

Runs that an earlier attempt has measured are kept in the folders of results.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from chromium import chromium, waited

DOCS = Path(__file__).parents[1] / "docs"
MEASURED = "stepbench-pictures-full", "stepbench-pictures-families"


def stepbench(*arguments: object) -> None:
    subprocess.run(
        [str(Path(sys.executable).parent / "stepbench"), *map(str, arguments)], check=True
    )


def main() -> None:
    """Measure the suites `full` and `families` if they are not, then draw and write."""
    full, families = map(Path, MEASURED)
    stepbench("run", "full", "--out", full)
    stepbench("run", "families", "--out", families)
    stepbench("card", full, "-o", DOCS / "card_full.svg")
    stepbench("choose", families, "-o", DOCS / "choosing.md")
    with chromium("window-size=1400,1120") as page:
        page.get((full.absolute() / "report.html").as_uri())
        waited(lambda: page.execute_script("return stepbench.data.complete"))
        page.save_screenshot(str(DOCS / "report.png"))


if __name__ == "__main__":
    main()
