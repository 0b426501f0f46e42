"""Templates filled in as HTML or as Markdown."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from html import escape as escape_html
from importlib import resources
from types import MappingProxyType

import jinja2
from markupsafe import Markup, escape

from bench.results.table import Table, whole
from problems.base.text import clean
from reports.charts.vega_lite import chart_json
from reports.formatting import file_name, symbols
from reports.questions import plain
from reports.tables.glossary import terms_in

_DOI = re.compile(r"\bdoi:(10\.\d{4,9}/\S+)")
_DOI_LINK = Markup('<a href="https://doi.org/{}" rel="noreferrer">doi:{}</a>')
#: A name in the docstring of a scene.
_CODE = re.compile(r"``(.+?)``")
_TERM_LINK = Markup('<a class="term" href="{}" title="{}">{}</a>')


def html(
    programs: Sequence[str],
    assets: str | None = None,
    address: Callable[[str], str] | None = None,
    names: Mapping[str, tuple[str, str]] = MappingProxyType({}),
    made: Mapping[str, str] = MappingProxyType({}),
    **values: object,
) -> str:
    """Fill in the template of a page; all values are escaped.

    The page states a policy for browsers: no network, and no script but its own.

    Parameters
    ----------
    programs
        Names of its scripts, in their order; ``made`` has those that are no files of assets.
    assets
        Address of the folder of assets, relative to the page, with a slash at its end; None for a
        page that holds what it needs of them.
    address
        Gives the address of an anchor, on another page of a report, too; None for a page without a
        glossary, whose anchors are its own.
    names
        Anchors and short names of integrators and scenes, which stand for them in tables.
    **values
        For the template.
    """
    if assets is None:
        texts = [clean(made.get(file) or _asset(file)) for file in programs]
        digests = [hashlib.sha256(text.encode()).digest() for text in texts]
        own = " ".join(f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests)
        scripts = [Markup(f"<script>{text}</script>") for text in texts]
        style, styles = Markup(f"<style>{_asset('report.css')}</style>"), ""
    else:
        own = styles = "'self'"
        scripts = [Markup('<script src="{}{}" defer></script>').format(assets, f) for f in programs]
        style = Markup('<link rel="stylesheet" href="{}report.css">').format(assets)
    return _filled(
        "layout.html.j2",
        scripts=scripts,
        style=style,
        # Vega sets styles of its own.
        policy=f"default-src 'none'; script-src {own}; style-src {styles} 'unsafe-inline'; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'",
        names=names,
        address=address or "#{}".format,
        prose=_prose(address),
        **values,
    )


def _asset(file: str) -> str:
    return (resources.files("reports.pages") / "assets" / file).read_text(encoding="utf-8")


def _prose(address: Callable[[str], str] | None) -> Callable[[object], Markup]:
    """A filter that makes links of DOIs, and with a glossary of the first use of each term.

    ``name`` is set as code, and lam as λ.
    """
    used: set[str] = set()

    def terms(text: str) -> Markup:
        parts, at = [], 0
        for start, end, term in terms_in(text):
            if address and term.anchor not in used:
                used.add(term.anchor)
                link = _TERM_LINK.format(address(term.anchor), term.definition, text[start:end])
                parts += [escape(text[at:start]), link]
                at = end
        return Markup("").join([*parts, escape(text[at:])])

    def prose(text: object) -> Markup:
        said = [_doi(piece, terms) for piece in _CODE.split(str(text))]
        said[1::2] = [Markup("<code>{}</code>").format(p) for p in _CODE.findall(str(text))]
        return Markup("").join(said)

    return prose


def _doi(text: object, others: Callable[[str], Markup] = escape) -> Markup:
    """A filter that makes links of DOIs, and λ of lam."""
    text, parts, at = symbols(str(text)), [], 0
    for found in _DOI.finditer(text):
        name = found.group(1).rstrip(".,;:)")
        parts += [others(text[at : found.start()]), _DOI_LINK.format(name, name)]
        at = found.start(1) + len(name)
    return Markup("").join([*parts, others(text[at:])])


def markdown(name: str, names: Mapping[str, str] = MappingProxyType({}), **values: object) -> str:
    """Fill in a template of Markdown; several blank lines become one.

    ``names`` are short names of integrators and scenes, which stand for them in tables.
    """
    text = _filled(name, names=names, **values)
    return re.sub(r"\n{3,}", "\n\n", text).rstrip() + "\n"


def _filled(name: str, **values: object) -> str:
    return clean(_environment(name.endswith(".html.j2")).get_template(name).render(**values))


@cache
def _environment(autoescape: bool) -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("reports.pages"),
        autoescape=autoescape,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    compact = {"separators": (",", ":")}
    environment.policies |= {"json.dumps_function": chart_json, "json.dumps_kwargs": compact}
    environment.filters |= {
        "doi": _doi,
        "file_name": file_name,
        "whole": whole,
        "md": lambda text: escape_markdown(plain(text) if isinstance(text, list) else text),
        "code": code,
        # These differ between pages.
        "prose": jinja2.pass_context(lambda page, text: page["prose"](text)),
        "table": jinja2.pass_context(lambda page, table: markdown_table(table, page["names"])),
    }
    return environment


def escape_markdown(text: object) -> str:
    """Text on one line in which no character is Markdown; lam is λ, and ``name`` is code."""
    pieces = _CODE.split(symbols(" ".join(str(text).split())))
    signs = re.compile(r"([\\`*_\[\]|#~$])")
    pieces[::2] = [signs.sub(r"\\\1", escape_html(piece, quote=False)) for piece in pieces[::2]]
    pieces[1::2] = map(code, pieces[1::2])
    return "".join(pieces)


def code(text: object) -> str:
    """Text set as code, fit for a table's cell."""
    flat = " ".join(str(text).split()).replace("`", "'")
    return f"`{flat}`".replace("|", "\\|") if flat else ""


def markdown_table(table: Table | None, names: Mapping[str, str] = MappingProxyType({})) -> str:
    """A table in GitHub's Markdown, with its caption and note; nothing for None.

    A name of an integrator or a scene that has no short one is code.
    """
    if table is None:
        return ""

    def row(cells: Iterable[str]) -> str:
        return f"| {' | '.join(cells)} |"

    lines = [row(escape_markdown(names.get(head, head)) for head in table.head)]
    lines.append(row("---" for _ in table.head))
    for i, cells in enumerate(table.rows):
        shown = []
        for j, c in enumerate(cells):
            named = j in table.code
            cell = (
                code(c) if named and c not in names else escape_markdown(names[c] if named else c)
            )
            shown.append(f"**{cell}**" if (i, j) in table.best else cell)
        lines.append(row(shown))
    # With a colon: a line that is all bold would pass for a heading.
    parts = [f"**{escape_markdown(table.caption)}**:", "\n".join(lines)]
    return "\n\n".join([*parts, escape_markdown(table.note)] if table.note else parts)
