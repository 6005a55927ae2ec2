"""Interactive figures: Plotly traces as JSON inside a page; a script of the page draws each when it comes into view."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike

from stridetwin.streams.samples import Array

Range = tuple[float, float]
INK, MUTED, ERROR = "#0f1c2e", "#5b6b7f", "#e03131"
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#aa3377", "#56b4e9", "#e69f00")
"""Distinct with any colour vision (after Okabe and Ito 2008)."""
_MOST_POINTS = 2000  # of a curve
_NARROWEST_SCALE = 0.12  # height over width of a figure true to scale; flatter ones have their y axis stretched


def data_range(*values: ArrayLike, include: Sequence[float] = (), margin: float = 0.06) -> Range:
    """The range of an axis: the span of the finite values with a margin; never empty, and about 0 to 1 without any.

    Args:
        *values: Arrays of any shape.
        include: Values that the range contains in any case.
        margin: Share of the span that is added at each end.
    """
    parts = [np.asarray(v, dtype=float).ravel() for v in values] + [np.asarray(include, dtype=float)]
    everything = np.concatenate(parts)
    finite = everything[np.isfinite(everything)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    # equal values have no span: the margin is a tenth of their size, at least 0.1; so it is for `margin=0`
    pad = margin * (high - low) or max(abs(high), 1.0) * 0.1
    return low - pad, high + pad


def thin(x: Array, y: Array, buckets: int) -> tuple[Array, Array]:
    """Thins a dense curve without losing its extremes: of each bucket, the lowest and the highest point stay.

    Both ends of the curve stay, too, and the first point of a bucket without a value (NaN), so that a gap stays a gap.

    Args:
        x: (N,).
        y: (N,); NaN where the curve has a gap.
        buckets: Number of parts with about the same number of points.

    Returns:
        The remaining x and y; all of them if there are at most two per bucket.
    """
    if len(x) <= 2 * buckets:
        return x, y
    edges = np.linspace(0, len(x), buckets + 1).astype(int)
    kept = {0, len(x) - 1}  # numbers of the points that stay
    for begin, end in pairwise(edges.tolist()):
        bucket = y[begin:end]
        if np.isfinite(bucket).any():
            kept |= {begin + int(np.nanargmin(bucket)), begin + int(np.nanargmax(bucket))}
        if not np.isfinite(bucket).all():
            # the first point without a value keeps the gap: `argmin` finds the first False
            kept.add(begin + int(np.argmin(np.isfinite(bucket))))
    numbers = sorted(kept)
    return x[numbers], y[numbers]


def join_curves(parts: Iterable[ArrayLike]) -> Array:
    """The (N, 2) rows of all parts, each followed by NaN: separate curves or polygons in one trace."""
    gap = np.full((1, 2), np.nan)
    pieces = [rows for part in parts for rows in (np.asarray(part, float), gap)]  # part, gap, part, gap, ...
    return np.concatenate(pieces or [gap])  # without any part, one gap


def faint(color: str, opacity: float = 0.15) -> str:
    """A hexadecimal colour, such as `#0f1c2e`, made translucent: as CSS text `rgba(...)`."""
    red, green, blue = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity:g})"


@dataclass(kw_only=True)
class Plot:
    """One pair of axes; what is drawn first lies below.

    Traces with equal labels have one entry in the legend, which shows and hides them together.

    Attributes:
        title: Above the figure.
        x: First range of the x axis; None shows all data.
        y: First range of the y axis; None shows all data.
        x_label: Title of the axis, with the unit.
        y_label: Title of the axis, with the unit.
        height: In pixels.
        to_scale: Both axes have one scale, and the height follows from the width; needs both ranges. The y axis of a
            very flat figure is stretched instead, and its title says so.
        x_names: Labels at x = 0, 1, 2 and so on instead of numbers.
        y_names: Labels by y instead of numbers.
        hover: Plotly's `hovermode`.
        continued: It continues the figure above: without title and legend.
    """

    title: str
    x: Range | None = None
    y: Range | None = None
    x_label: str = ""
    y_label: str = ""
    height: int = 300
    to_scale: bool = False
    x_names: Sequence[str] = ()
    y_names: Mapping[float, str] = field(default_factory=dict)
    hover: str = "closest"
    continued: bool = False
    _traces: list[dict[str, Any]] = field(default_factory=list)  # Plotly's, in the order of drawing
    _layout: dict[str, Any] = field(default_factory=dict)  # Plotly's layout beyond the axes, such as images

    def line(
        self, x: ArrayLike, y: ArrayLike, color: str, *, label: str = "", width: float = 1.6, dash: str = "solid"
    ) -> None:
        """Draws a line through the points (N,), interrupted where y is not finite; dense curves are thinned.

        Args:
            x: (N,) values of the axis.
            y: (N,) values of the axis.
            color: CSS colour.
            label: In the legend; "" leaves it out.
            width: In pixels.
            dash: Plotly's name, such as `dash` or `solid`.
        """
        xs, ys = np.asarray(x, float), np.asarray(y, float)
        if np.all(np.diff(xs) >= 0):  # a curve over x; others, such as paths from above, keep all points
            xs, ys = thin(xs, ys, _MOST_POINTS // 2)  # each bucket keeps two points
        line = {"color": color, "width": width, "dash": dash}
        self._add(label, x=_numbers(xs), y=_numbers(ys), mode="lines", line=line)

    def curves(self, parts: Iterable[ArrayLike], color: str, *, label: str = "", width: float = 1.6) -> None:
        """Draws separate curves of one kind, (N, 2) each, with one label."""
        points = join_curves(parts)
        self.line(points[:, 0], points[:, 1], color, label=label, width=width)

    def band(
        self, x: ArrayLike, low: ArrayLike, high: ArrayLike, color: str, *, label: str = "", stroke: str = ""
    ) -> None:
        """Fills the area between curves `low` and `high` over x, (N,) each, with an outline if `stroke` is a colour."""
        xs = np.asarray(x, float)
        # along `low` to the right, then along `high` back to the left
        outline = np.column_stack([np.r_[xs, xs[::-1]], np.r_[low, np.asarray(high)[::-1]]])
        self.areas([outline], color, label=label, stroke=stroke)

    def areas(self, outlines: Sequence[ArrayLike], fill: str, *, label: str = "", stroke: str = "") -> None:
        """Fills shapes given by their outlines, (N, 2) each, which are closed here.

        Args:
            outlines: The shapes; all of them are one trace.
            fill: CSS colour of the inside.
            label: In the legend; "" leaves it out.
            stroke: CSS colour of the outline; "" draws none.
        """
        if len(outlines):
            # each outline is closed; gaps separate the outlines
            points = join_curves([np.vstack([o, np.asarray(o)[:1]]) for o in outlines])
            line = {"color": stroke, "width": 1} if stroke else {"width": 0}
            self._add(
                label,
                x=_numbers(points[:, 0]),
                y=_numbers(points[:, 1]),
                mode="lines",
                line=line,
                fill="toself",
                fillcolor=fill,
                hoverinfo="name" if label else "skip",
                hoveron="fills",
            )

    def bars(
        self, left: ArrayLike, right: ArrayLike, low: ArrayLike, high: ArrayLike, color: str, *, label: str = ""
    ) -> None:
        """Draws upright rectangles from `left` to `right` and from `low` to `high`.

        Args:
            left: Number or (N,), like the three others; a number counts for all rectangles.
            right: On the x axis, like `left`.
            low: On the y axis.
            high: On the y axis.
            color: CSS colour.
            label: In the legend; "" leaves it out.
        """
        # four arrays of the same length
        sides = np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, float)) for v in (left, right, low, high)))
        rectangles = [[(x0, y0), (x1, y0), (x1, y1), (x0, y1)] for x0, x1, y0, y1 in zip(*sides)]
        self.areas(rectangles, color, label=label)

    def dots(
        self,
        x: ArrayLike,
        y: ArrayLike,
        color: str,
        *,
        size: float = 6.0,
        label: str = "",
        symbol: str = "circle",
        sd: ArrayLike | None = None,
        labels: Sequence[str] = (),
    ) -> None:
        """Draws markers at the points (N,), with error bars and texts where given.

        Args:
            x: (N,) values of the axis.
            y: (N,) values of the axis.
            color: CSS colour.
            size: Of a marker, pixels.
            label: In the legend; "" leaves it out.
            symbol: Plotly's name of the marker.
            sd: (N,) half lengths of the error bars; None draws none.
            labels: Text above each marker; empty for none.
        """
        mark = {"color": color, "size": size, "symbol": symbol}
        more: dict[str, Any] = {} if sd is None else {"error_y": {"array": _numbers(sd), "color": color}}
        if labels:
            more |= {"text": list(labels), "textposition": "top center"}
        self._add(
            label, x=_numbers(x), y=_numbers(y), mode="markers+text" if labels else "markers", marker=mark, **more
        )

    def heatmap(self, x: ArrayLike, y: ArrayLike, z: Array, *, label: str, reverse: bool) -> None:
        """Draws values (Y, X) as colours, bright where they are high, or low with `reverse`; NaN stays empty.

        Args:
            x: (X,) centres of the columns.
            y: (Y,) centres of the rows.
            z: (Y, X) values.
            label: Title of the colour scale.
            reverse: Makes low values bright.
        """
        self._add(
            "",
            type="heatmap",
            x=_numbers(x),
            y=_numbers(y),
            colorscale="Viridis",
            reversescale=reverse,
            # with six significant digits, which keeps the page small
            z=[[None if np.isnan(v) else float(f"{v:.6g}") for v in row] for row in z],
            colorbar={"title": {"text": label, "side": "right"}},
            hoverinfo="x+y+z",
        )

    def image(self, x: Range, y: Range, uri: str) -> None:
        """Draws an image below everything else, stretched over the ranges x and y; `uri` is a `data:` URI."""
        # Plotly places an image by its upper left corner
        self._layout.setdefault("images", []).append(
            {
                "source": uri,
                "xref": "x",
                "yref": "y",
                "x": x[0],
                "y": y[1],
                "sizex": x[1] - x[0],
                "sizey": y[1] - y[0],
                "sizing": "stretch",
                "layer": "below",
            }
        )

    def key(self, label: str, color: str) -> None:
        """Adds an entry to the legend for a colour of an image: a trace with one marker that has no place."""
        self._add(label, x=[None], y=[None], mode="markers", marker={"color": color, "symbol": "square", "size": 11})

    @property
    def drawn(self) -> bool:
        """Whether anything has been drawn."""
        return bool(self._traces)

    def html(self) -> Markup:
        """The figure as an element of a page made by `html.page`, whose script draws it."""
        figure = {"data": self._traces, "layout": self._axes() | self._layout, "aspect": self._aspect}
        # "<" as an escape sequence, so that no text can end the script element
        text = json.dumps(figure, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
        caption = Markup("") if self.continued else Markup("<figcaption>{}</figcaption>").format(self.title)
        return Markup(
            '<figure{}>{}<div class="plot" role="img" aria-label="{}" style="height:{}px">'
            '<script type="application/json">{}</script></div></figure>'
        ).format(Markup(' class="continued"' if self.continued else ""), caption, self.title, self.height, Markup(text))

    def _add(self, label: str, **trace: Any) -> None:
        """Adds a trace of Plotly; the first one with a label has the entry in the legend."""
        is_first = bool(label) and all(trace.get("name") != label for trace in self._traces)
        # traces of one group are shown and hidden together; without a label, the text at the pointer shows no name
        naming = {"name": label, "legendgroup": label} if label else {"hoverinfo": trace.get("hoverinfo", "x+y")}
        self._traces.append({"type": "scatter", "showlegend": is_first, **trace, **naming})

    @property
    def is_stretched(self) -> bool:
        """Whether a figure that was to be true to scale is too flat for it."""
        return self.to_scale and not self._aspect

    @property
    def _aspect(self) -> float:
        """Height over width of a figure true to scale; 0 for one of fixed height, or so flat that y is stretched."""
        if not self.to_scale or self.x is None or self.y is None:
            return 0.0
        aspect = (self.y[1] - self.y[0]) / (self.x[1] - self.x[0])
        return aspect if aspect >= _NARROWEST_SCALE else 0.0

    def _axes(self) -> dict[str, Any]:
        """Plotly's layout of both axes, with what the pointer shows and whether there is a legend."""
        scaled = self._aspect > 0.0
        y_label = f"{self.y_label} (stretched)" if self.is_stretched else self.y_label
        x_axis: dict[str, Any] = {"title": {"text": self.x_label}}
        y_axis: dict[str, Any] = {"title": {"text": y_label}}
        if self.x is not None:
            x_axis["range"] = list(self.x)
        if self.y is not None:
            y_axis["range"] = list(self.y)
        if self.x_names:
            x_axis |= {"tickvals": list(range(len(self.x_names))), "ticktext": list(self.x_names)}
        if self.y_names:
            y_axis |= {"tickvals": list(self.y_names), "ticktext": list(self.y_names.values()), "showgrid": False}
        if scaled:  # equal units on both axes: the range stays, and the drawn area shrinks
            x_axis["constrain"] = "domain"
            y_axis |= {"scaleanchor": "x", "constrain": "domain"}
        return {"xaxis": x_axis, "yaxis": y_axis, "hovermode": self.hover, "showlegend": not self.continued}


def _numbers(values: ArrayLike) -> dict[str, str]:
    """An array as single-precision numbers in base64, as Plotly reads them."""
    data = np.asarray(values, "<f4").tobytes()
    return {"dtype": "f4", "bdata": base64.b64encode(data).decode("ascii")}


@cache
def library() -> str:
    """Plotly's script, compressed, in base64: about 2 MB."""
    from plotly.offline import get_plotlyjs

    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), mtime=0)).decode("ascii")
