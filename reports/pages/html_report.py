"""report.html: the report in one file that needs no network."""

from __future__ import annotations

import contextlib
import hashlib
import os
from importlib.metadata import version
from pathlib import Path

import platformdirs
import vl_convert

from reports.pages.report import read_report
from reports.pages.templating import html

FILE = "report.html"


def write_html_report(folder: Path) -> Path:
    """Write report.html into a run folder, from its store alone.

    Parameters
    ----------
    folder
        The run folder.

    Returns
    -------
    pathlib.Path
        The page.

    Raises
    ------
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    report = read_report(folder, interactive=True)
    path = Path(folder) / FILE
    text = html("report.html.j2", report=report, library=javascript_library())
    path.write_text(text, encoding="utf-8")
    return path


def javascript_library() -> str:
    """The JavaScript that draws the charts.

    Its making takes seconds, so a copy is kept in the user's cache folder if possible. Its first
    line is the digest of the others; a copy that differs is made anew.
    """
    folder = Path(platformdirs.user_cache_dir("stepbench"))
    kept = folder / f"vega-{version('vl-convert-python')}.js"
    with contextlib.suppress(OSError, UnicodeDecodeError):
        digest, _, text = kept.read_text(encoding="utf-8").partition("\n")
        if digest == _digest(text):
            return text
    # The type stub lacks the default of the argument.
    text = vl_convert.javascript_bundle()  # pyright: ignore[reportCallIssue]
    text = text.replace("</script", "<\\/script")
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        # Two processes may write at a time: each puts a whole file in place.
        own = kept.with_suffix(f".{os.getpid()}")
        own.write_text(f"{_digest(text)}\n{text}", encoding="utf-8")
        own.replace(kept)
    return text


def _digest(text: str) -> str:
    return f"// sha256 {hashlib.sha256(text.encode()).hexdigest()}"
