"""Templates filled in as HTML or as Markdown."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Callable, Iterable
from importlib import resources

import jinja2
from markupsafe import Markup, escape

from problems.plain_text import clean
from reports.charts.vega_lite import chart_json
from reports.text.table import Table

#: Stands in the head of a page for its content-security policy, until all scripts are known.
POLICY = "content-security-policy"


def html(name: str, assets: str | None = None, linked: bool = False, **values: object) -> str:
    """Fill in a template of HTML; all values are escaped.

    The page states a policy for browsers: no network, and no script but those that the template
    sets with ``call script()`` or ``program(file)``.

    Parameters
    ----------
    name
        The template.
    assets
        Address of the folder of assets, relative to the page, with a slash at its end; None for a
        page that holds what it needs of them.
    linked
        Whether a page that holds its scripts links others of its own site, too.
    **values
        For the template.
    """
    environment = _environment(autoescape=True)
    digests: list[str] = []

    def script(caller: Callable[[], str]) -> Markup:
        text = clean(caller())
        digest = hashlib.sha256(text.encode()).digest()
        digests.append(f"'sha256-{base64.b64encode(digest).decode()}'")
        return Markup(f"<script>{text}</script>")

    def program(file: str) -> Markup:
        """A script of the folder of assets."""
        if assets is None:
            return script(lambda: asset(file))
        return Markup(f'<script src="{escape(assets)}{file}" defer></script>')

    def style(file: str) -> Markup:
        """A style sheet of the folder of assets."""
        if assets is None:
            return Markup(f"<style>{asset(file)}</style>")
        return Markup(f'<link rel="stylesheet" href="{escape(assets)}{file}">')

    environment.globals |= {
        "script": script,
        "program": program,
        "style": style,
        "policy": POLICY,
    }
    text = clean(environment.get_template(name).render(**values))
    own = ["'self'"] if linked or assets is not None else []
    policy = {
        "default-src": "'none'",
        "script-src": " ".join([*own, *digests]) or "'none'",
        "style-src": " ".join([*own, "'unsafe-inline'"]),  # Vega sets styles of its own
        "img-src": "data: blob:",
        "base-uri": "'none'",
        "form-action": "'none'",
    }
    stated = "; ".join(f"{name} {allowed}" for name, allowed in policy.items())
    # The head comes before every value: the first one is the page's own.
    return text.replace(POLICY, stated, 1)


def asset(file: str) -> str:
    """Return the text of a file of assets."""
    return (resources.files("reports.pages") / "assets" / file).read_text(encoding="utf-8")


def markdown(name: str, **values: object) -> str:
    """Fill in a template of Markdown; several blank lines become one."""
    environment = _environment(autoescape=False)
    environment.filters |= {"md": escape_markdown, "code": code, "table": markdown_table}
    text = clean(environment.get_template(name).render(**values))
    return re.sub(r"\n{3,}", "\n\n", text).rstrip() + "\n"


def _environment(autoescape: bool) -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("reports.pages"),
        autoescape=autoescape,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.policies |= {"json.dumps_function": chart_json, "json.dumps_kwargs": {}}
    return environment


def escape_markdown(text: object) -> str:
    """Text on one line in which no character is Markdown."""
    flat = " ".join(str(text).split())
    flat = flat.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return re.sub(r"([\\`*_\[\]|#~$])", r"\\\1", flat)


def code(text: object) -> str:
    """Text set as code, fit for a table's cell."""
    flat = " ".join(str(text).split()).replace("`", "'")
    return f"`{flat}`".replace("|", "\\|") if flat else ""


def markdown_table(table: Table | None) -> str:
    """A table in GitHub's Markdown, with its caption and note; nothing for None."""
    if table is None:
        return ""
    lines = [_row(escape_markdown(head) for head in table.head), _row("---" for _ in table.head)]
    for i, cells in enumerate(table.rows):
        shown = [code(c) if j in table.code else escape_markdown(c) for j, c in enumerate(cells)]
        lines.append(_row(f"**{c}**" if (i, j) in table.best else c for j, c in enumerate(shown)))
    # With a colon: a line that is all bold would pass for a heading.
    parts = [f"**{escape_markdown(table.caption)}**:", "\n".join(lines)]
    return "\n\n".join([*parts, escape_markdown(table.note)] if table.note else parts)


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"
