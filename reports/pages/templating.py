"""Templates of the HTML pages."""

from __future__ import annotations

import jinja2


def template(name: str) -> jinja2.Template:
    """A page's template, which escapes what it is given."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("reports.pages"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template(name)
