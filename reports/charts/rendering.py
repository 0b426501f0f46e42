"""Charts as SVG files, drawn by several processes when there are many.

Drawing uses one core per process. A helper process is
``python -m reports.charts.rendering FOLDER``; it reads its charts from the standard input.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import vl_convert

from reports.charts.vega_lite import Spec

#: Characters of charts per process; a process takes a third of a second to start.
PART_SIZE = 240_000


def draw(charts: Mapping[str, Spec], folder: Path) -> None:
    """Write every chart into the folder as name.svg; SVG files of an earlier time are deleted.

    Raises
    ------
    RuntimeError
        If a chart cannot be drawn.
    """
    for old in folder.glob("*.svg"):
        old.unlink()
    if not charts:
        return
    folder.mkdir(parents=True, exist_ok=True)
    texts = {name: json.dumps(_plain(chart)) for name, chart in charts.items()}
    size = sum(map(len, texts.values()))
    own, *others = parts(texts, max(1, min(cores(), size // PART_SIZE)))
    # -P: a folder "reports" in the user's current folder is not meant.
    command = [sys.executable, "-P", "-m", "reports.charts.rendering", str(folder)]
    run = partial(subprocess.run, command, stderr=subprocess.PIPE, text=True)
    with ThreadPoolExecutor(len(others) or 1) as pool:
        helpers = [pool.submit(run, input=json.dumps(part)) for part in others]
        _write(own, folder)
    for helper in helpers:
        ended = helper.result()
        if ended.returncode:
            code = ended.returncode
            raise RuntimeError(ended.stderr.strip() or f"A drawing process ended: {code}.")


def _plain(chart: Spec) -> Spec:
    """The chart without slow options that a picture does not need.

    These are a description of every point for screen readers, and limits of label lengths, for
    which every label would be measured twice.
    """
    config = chart.get("config", {})
    axis = config.get("axis", {}) | {"labelLimit": 0, "titleLimit": 0}
    legend = config.get("legend", {}) | {"labelLimit": 0}
    return chart | {"config": config | {"aria": False, "axis": axis, "legend": legend}}


def parts(texts: Mapping[str, str], count: int) -> list[dict[str, str]]:
    """Split charts into parts of about the same size."""
    split: list[dict[str, str]] = [{} for _ in range(count)]
    sizes = [0] * count
    for name, text in sorted(texts.items(), key=lambda item: -len(item[1])):
        smallest = sizes.index(min(sizes))
        split[smallest][name] = text
        sizes[smallest] += len(text)
    return split


def cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _write(charts: Mapping[str, str], folder: Path) -> None:
    for name, text in charts.items():
        try:
            svg = vl_convert.vegalite_to_svg(text)
        except ValueError as error:
            reason, *_ = str(error).splitlines()
            raise RuntimeError(f"The chart {name} cannot be drawn: {reason}") from None
        (folder / f"{name}.svg").write_text(svg, encoding="utf-8")


if __name__ == "__main__":
    try:
        _write(json.load(sys.stdin), Path(sys.argv[1]))
    except RuntimeError as error:
        sys.exit(str(error))
