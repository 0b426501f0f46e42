"""Charts as SVG files, drawn by several processes when there are many.

A drawing engine works on one core, so that a large page has one engine per core. An engine is
``python -m reports.charts.rendering FOLDER`` and reads its charts from the standard input.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import vl_convert

from reports.charts.vega import Spec

#: Characters of charts that are worth another engine, which takes a third of a second to start.
_WORTH = 240_000


def draw(charts: Mapping[str, Spec], folder: Path) -> None:
    """Write every chart into the folder as name.svg; those of an earlier time go.

    Raises
    ------
    RuntimeError
        If a chart could not be drawn.
    """
    for old in folder.glob("*.svg"):
        old.unlink()
    if not charts:
        return
    folder.mkdir(parents=True, exist_ok=True)
    texts = {name: json.dumps(_plain(chart)) for name, chart in charts.items()}
    size = sum(map(len, texts.values()))
    mine, *others = _shares(texts, max(1, min(_cores(), size // _WORTH)))
    # -P: whatever is called "reports" where the user stands is not meant.
    command = [sys.executable, "-P", "-m", "reports.charts.rendering", str(folder)]
    engines = []
    for share in others:
        engine = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        with contextlib.suppress(BrokenPipeError):  # its death is told by its exit code
            engine.stdin.write(json.dumps(share))
            engine.stdin.close()
        engine.stdin = None  # it is told all; what is left is to listen
        engines.append(engine)
    _write(mine, folder)
    for engine in engines:
        _, said = engine.communicate()
        if engine.returncode:
            raise RuntimeError(said.strip() or f"A drawing engine ended: {engine.returncode}.")


def _plain(chart: Spec) -> Spec:
    """Without what only costs time: of a picture in a page nobody is read every point, and to
    see whether a name is too long, the engine would measure it a second time."""
    config = chart.get("config", {})
    axis = config.get("axis", {}) | {"labelLimit": 0, "titleLimit": 0}
    legend = config.get("legend", {}) | {"labelLimit": 0}
    return chart | {"config": config | {"aria": False, "axis": axis, "legend": legend}}


def _shares(texts: Mapping[str, str], count: int) -> list[dict[str, str]]:
    """Parts of about the same size: the largest first, each to whom has least."""
    shares: list[dict[str, str]] = [{} for _ in range(count)]
    sizes = [0] * count
    for name, text in sorted(texts.items(), key=lambda item: -len(item[1])):
        least = sizes.index(min(sizes))
        shares[least][name] = text
        sizes[least] += len(text)
    return shares


def _cores() -> int:
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
