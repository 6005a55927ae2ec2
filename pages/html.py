"""Self-contained HTML pages without network access. The templates are in `templates/`."""

from __future__ import annotations

import base64
from collections.abc import Container, Iterable, Sequence
from functools import cache

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from stridetwin.pages.plot import library


def page(title: str, description: str, chips: Sequence[str], sections: Iterable[str], footer: str) -> str:
    """Renders a self-contained HTML page; Plotly's script is included only if a section has a plot.

    Args:
        title: Plain text, as are description, chips and footer.
        description: One line.
        chips: A few words each.
        sections: HTML; empty ones are left out.
        footer: One line.
    """
    body = Markup("\n".join(s for s in sections if s))
    plots = render_template("plots", library=library()) if '<div class="plot"' in body else ""
    return str(
        render_template(
            "page", title=title, description=description, chips=chips, sections=body, footer=footer, plots=plots
        )
    )


def section(title: str, lead: str, body: str, css: str = "card") -> Markup:
    """Renders a section of a page.

    Args:
        title: Plain text.
        lead: Plain text below the title.
        body: HTML.
        css: Class of the box around the body; "" for none.
    """
    return render_template("section", title=title, lead=lead, body=Markup(body), css=css)


def table(
    head: Sequence[str], rows: Iterable[Sequence[object]], numbers: Container[int], *, note: str = "", css: str = ""
) -> Markup:
    """Renders a table of HTML.

    Args:
        head: Titles of the columns; plain text like the cells, unless they are `Markup`.
        rows: Cells of each row.
        numbers: Indices of the columns with numbers, which are right-aligned.
        note: Text below it.
        css: An additional class of its box; "" for none.
    """
    return render_template("table", head=head, rows=rows, numbers=numbers, note=note, css=f"scroll {css}".strip())


def text_block(lines: Iterable[str]) -> Markup:
    """Renders lines of a text table, which scrolls sideways where it is too wide."""
    return Markup('<pre class="table">{}</pre>').format("\n".join(lines))


def boxes(bodies: Iterable[str]) -> Markup:
    """Renders a box around each HTML body that is not empty."""
    return Markup("").join(Markup('<div class="card">{}</div>').format(Markup(body)) for body in bodies if body)


def multiples(figures: Iterable[str]) -> Markup:
    """Renders small figures side by side."""
    return Markup('<div class="multiples">{}</div>').format(Markup("").join(map(Markup, figures)))


def render_template(template: str, **values: object) -> Markup:
    """Renders a template of `pages/templates` with values, which are escaped unless they are `Markup`."""
    return Markup(_environment().get_template(f"{template}.html").render(values))


def data_uri(data: bytes, media_type: str) -> str:
    """The data as a `data:` URI."""
    return f"data:{media_type};base64,{base64.b64encode(data).decode('ascii')}"


def number_text(value: float, digits: int) -> str:
    """A number with fixed decimals and a typographic minus sign."""
    return f"{value:.{digits}f}".replace("-", "\N{MINUS SIGN}")


def code(text: str) -> Markup:
    """A name in a fixed-width font."""
    return Markup("<code>{}</code>").format(text)


@cache
def _environment() -> Environment:
    """The templates of pages; a value that a template lacks is an error."""
    loader = PackageLoader("stridetwin.pages")
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
