"""report.html: one file with everything in it, which asks nothing of any network."""

from __future__ import annotations

from pathlib import Path

import jinja2
import vl_convert

from reports.content import read_page

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
    bench.store.StoreError
        If the folder holds no readable store.
    """
    page = read_page(folder, interactive=True)
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("reports"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    path = Path(folder) / FILE
    text = environment.get_template("report.html.j2").render(
        page=page,
        # The drawing code stands in the page once; it holds no "</script>" to escape.
        library=vl_convert.javascript_bundle().replace("</script", "<\\/script"),
    )
    path.write_text(text, encoding="utf-8")
    return path
