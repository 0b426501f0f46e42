"""Charts as pictures. Engines draw them: processes of their own, which end with this one.

The library that draws may end its process. That costs the picture, never the page: the engine is
replaced. An engine is ``python -m reports.charts.rendering``; it reads a question per line from its
standard input and answers each by a line.
"""

from __future__ import annotations

import atexit
import base64
import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from threading import Timer
from typing import IO, Any

from bench.guard.keeper import die_with_parent
from bench.results.clean_text import clean
from reports.charts.vega_lite import Spec, chart_json

#: Characters of charts per engine; one takes a third of a second to start.
PART_SIZE = 240_000
#: An engine that draws one chart for longer, in s, is stopped.
LONGEST = 120.0


@dataclass(frozen=True)
class Picture:
    """The content of a picture's file, or the reason why there is none."""

    content: bytes = b""
    reason: str = ""

    @property
    def svg(self) -> str:
        """The picture in a page; a sentence if there is none."""
        return self.content.decode() if self.content else f"<p>{escape(self.sentence)}</p>"

    @property
    def sentence(self) -> str:
        """The reason as a sentence."""
        return f"This chart cannot be drawn: {self.reason}."


def draw(charts: Mapping[str, Spec], folder: Path) -> dict[str, Picture]:
    """Write every chart into the folder as name.svg; SVG files of an earlier time are deleted.

    Returns
    -------
    dict
        The charts that cannot be drawn, with the reason; they have no file.
    """
    for old in folder.glob("*.svg"):
        old.unlink()
    failed = {}
    for name, picture in pictures({n: _plain(chart) for n, chart in charts.items()}).items():
        if picture.content:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / f"{name}.svg").write_bytes(picture.content)
        else:
            failed[name] = picture
    return failed


def pictures(charts: Mapping[str, Spec], form: str = "svg", **options: float) -> dict[str, Picture]:
    """Draw charts by name, several at a time when there are many.

    Parameters
    ----------
    charts
        The charts by name.
    form
        "svg", "png" or "pdf".
    **options
        Those of vl-convert for this form: ``scale``, ``ppi``.
    """
    texts = {name: chart_json(chart) for name, chart in charts.items()}
    if not texts:
        return {}
    split = parts(texts, max(1, min(cores(), sum(map(len, texts.values())) // PART_SIZE)))
    # Taken here: on Linux an engine ends with the thread that started it.
    engines = [_taken() for _ in split]
    with ThreadPoolExecutor(len(split)) as pool:
        found = pool.map(partial(_drawn, form=form, options=options), engines, split)
        drawn = {name: picture for part in found for name, picture in part.items()}
    return {name: drawn[name] for name in charts}


def picture(chart: Spec, form: str = "svg", **options: float) -> Picture:
    """Draw one chart; see ``pictures``."""
    return pictures({"": chart}, form, **options)[""]


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


# ---- parts -------------------------------------------------------------------------------
def _plain(chart: Spec) -> Spec:
    """The chart without slow options that a picture does not need.

    These are a description of every point for screen readers, and limits of label lengths, for
    which every label would be measured twice.
    """
    config = chart.get("config", {})
    axis = config.get("axis", {}) | {"labelLimit": 0, "titleLimit": 0}
    legend = config.get("legend", {}) | {"labelLimit": 0}
    return chart | {"config": config | {"aria": False, "axis": axis, "legend": legend}}


class _Engine:
    """A drawing process."""

    def __init__(self) -> None:
        # -P: a folder "reports" in the user's current folder is not meant.
        command = [sys.executable, "-P", "-m", "reports.charts.rendering"]
        pipe, nothing = subprocess.PIPE, subprocess.DEVNULL
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=nothing)

    @property
    def alive(self) -> bool:
        """Whether it can be asked."""
        return self._process.poll() is None

    def ask(self, question: bytes) -> Picture:
        """Have a chart drawn; an engine that dies of it has ended when this returns."""
        late = Timer(LONGEST, self._process.kill)
        late.start()
        answer = b""
        try:
            with contextlib.suppress(OSError):
                _pipe(self._process.stdin).write(question)
                _pipe(self._process.stdin).flush()
                answer = _pipe(self._process.stdout).readline()
        finally:
            late.cancel()
            if not answer.endswith(b"\n"):
                self.end()
        if answer.endswith(b"\n"):
            found = json.loads(answer)
            return Picture(base64.b64decode(found["content"]), found["reason"])
        return Picture(reason=f"its drawing process ended with code {self._process.returncode}")

    def end(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()


#: Engines without work. They are kept, as starting one takes longer than drawing a small chart.
_idle: list[_Engine] = []


@atexit.register
def _end_engines() -> None:
    while _idle:
        _idle.pop().end()


if hasattr(os, "register_at_fork"):  # the child must not talk to the engines of its parent
    os.register_at_fork(after_in_child=_idle.clear)


def _taken() -> _Engine:
    while _idle:
        engine = _idle.pop()
        if engine.alive:
            return engine
    return _Engine()


def _drawn(
    engine: _Engine, texts: Mapping[str, str], form: str, options: Mapping[str, float]
) -> dict[str, Picture]:
    found = {}
    for name, text in texts.items():
        question = json.dumps({"chart": text, "form": form, "options": options}).encode() + b"\n"
        found[name] = engine.ask(question)
        if not engine.alive:
            # Somebody else may have ended it: the chart is guilty if a second one dies of it.
            engine = _Engine()
            found[name] = engine.ask(question)
            engine = engine if engine.alive else _Engine()
    _idle.append(engine)
    return found


def _pipe(stream: IO[bytes] | None) -> IO[bytes]:
    assert stream is not None
    return stream


def _answer(question: dict[str, Any]) -> Picture:
    import vl_convert

    convert = getattr(vl_convert, f"vegalite_to_{question['form']}")
    try:
        content = convert(question["chart"], **question["options"])
    except BaseException as error:  # a panic of the library is no Exception
        reason = clean(str(error)).strip().partition("\n")[0][:300].rstrip(".")
        return Picture(reason=reason or type(error).__name__)
    return Picture(content.encode() if isinstance(content, str) else content)


def _serve() -> None:
    """Answer questions until there are no more."""
    die_with_parent()
    # What the library itself prints is no answer.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    for line in sys.stdin.buffer:
        found = _answer(json.loads(line))
        content = base64.b64encode(found.content).decode()
        answers.write(json.dumps({"content": content, "reason": found.reason}).encode() + b"\n")
        answers.flush()


if __name__ == "__main__":
    _serve()
