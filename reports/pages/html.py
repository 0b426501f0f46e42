"""report.html: one file with everything in it, which asks nothing of any network."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import platformdirs
import vl_convert

from reports.pages.report import read_page
from reports.pages.templating import template

FILE = "report.html"


def write(folder: Path) -> Path:
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
    page = read_page(folder, interactive=True)
    path = Path(folder) / FILE
    text = template("report.html.j2").render(page=page, library=_library())
    path.write_text(text, encoding="utf-8")
    return path


def _library() -> str:
    """The code that draws the charts, which stands in the page once.

    It takes seconds to bundle, so a copy is kept in the user's cache, where that can be written.
    """
    folder = Path(platformdirs.user_cache_dir("stepbench"))
    kept = folder / f"vega-{vl_convert.__version__}.js"
    with contextlib.suppress(OSError):
        return kept.read_text(encoding="utf-8")
    text = vl_convert.javascript_bundle().replace("</script", "<\\/script")
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        # Two pages may be written at a time: whoever comes last puts a whole file in place.
        mine = kept.with_suffix(f".{os.getpid()}")
        mine.write_text(text, encoding="utf-8")
        mine.replace(kept)
    return text
