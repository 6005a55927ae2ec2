"""Plots as inline SVG text: one set of axes, lines, bands and shapes; without scripts, fonts or network access."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from stridetwin.streams.samples import Array

Range = tuple[float, float]
_LEFT, _RIGHT, _TOP = 46.0, 12.0, 28.0
_INK, _MUTED, _GRID = "#0f1c2e", "#5b6b7f", "#e6ebf1"


def data_range(*values: ArrayLike, include: Sequence[float] = (), margin: float = 0.06) -> Range:
    """The span of the finite values, with a margin; never empty."""
    parts = [np.asarray(v, dtype=float).ravel() for v in values] + [np.asarray(include, dtype=float)]
    everything = np.concatenate(parts)
    finite = everything[np.isfinite(everything)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    pad = margin * (high - low) or max(abs(high), 1.0) * 0.1
    return low - pad, high + pad


def ticks(span: Range, about: int) -> list[float]:
    """About the given number of round values (1, 2 or 5 times a power of ten) within the span."""
    raw = (span[1] - span[0]) / max(about, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m for m in (1, 2, 5, 10) if m * power >= 0.7 * raw) * power
    first, last = math.ceil(span[0] / step - 1e-9), math.floor(span[1] / step + 1e-9)
    return [k * step for k in range(first, last + 1)]


def thin(x: Array, y: Array, buckets: int) -> tuple[Array, Array]:
    """At most two points per bucket, the lowest and the highest: as much as a line of that many pixels shows."""
    if len(x) <= 2 * buckets:
        return x, y
    edges = np.linspace(0, len(x), buckets + 1).astype(int)
    kept = set()
    for a, b in pairwise(edges.tolist()):
        part = y[a:b]
        if np.isfinite(part).any():
            kept |= {a + int(np.nanargmin(part)), a + int(np.nanargmax(part))}
    index = sorted(kept | {0, len(x) - 1})
    return x[index], y[index]


@dataclass(kw_only=True)
class Plot:
    """One set of axes. Draw in order; `svg()` gives the text.

    Attributes:
        width: Width of the view box, in units of which the text is 12 high.
        height: Height of the view box.
        x: Range of the data.
        y: Range of the data.
        title: Text for screen readers.
        x_label: Text below the axis.
        y_label: Text at the top left.
        x_names: Labels at x = 0, 1, 2 and so on instead of numbers.
        y_names: Labels by y instead of numbers and their lines.
    """

    width: float
    height: float
    x: Range
    y: Range
    title: str
    x_label: str = ""
    y_label: str = ""
    x_names: Sequence[str] = ()
    y_names: Mapping[float, str] = field(default_factory=dict)
    _marks: list[str] = field(default_factory=list)
    _legend: list[tuple[str, str, str]] = field(default_factory=list)

    @property
    def _bottom(self) -> float:
        return 40.0 if self.x_label else 24.0

    def _px(self, x: ArrayLike) -> Array:
        span = self.width - _LEFT - _RIGHT
        return _LEFT + (np.asarray(x, dtype=float) - self.x[0]) / (self.x[1] - self.x[0]) * span

    def _py(self, y: ArrayLike) -> Array:
        span = self.height - _TOP - self._bottom
        return self.height - self._bottom - (np.asarray(y, dtype=float) - self.y[0]) / (self.y[1] - self.y[0]) * span

    def _points(self, x: ArrayLike, y: ArrayLike) -> str:
        return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(self._px(x), self._py(y)))

    def line(
        self, x: ArrayLike, y: ArrayLike, color: str, *, label: str = "", stroke: float = 1.6, dash: str = ""
    ) -> None:
        """A line through the points, thinned to the visible detail, interrupted where y is not finite."""
        xs, ys = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
        if np.all(np.diff(xs) >= 0):
            xs, ys = thin(xs, ys, int(self.width))
        style = f'fill="none" stroke="{color}" stroke-width="{stroke:g}" stroke-linejoin="round"'
        if dash:
            style += f' stroke-dasharray="{dash}"'
        for part in np.split(np.arange(len(xs)), np.flatnonzero(~np.isfinite(ys))):
            part = part[np.isfinite(ys[part])]
            if len(part) > 1:
                self._marks.append(f'<polyline points="{self._points(xs[part], ys[part])}" {style}/>')
        if label:
            self._legend.append((label, color, dash))

    def band(self, x: ArrayLike, low: ArrayLike, high: ArrayLike, color: str, *, label: str = "") -> None:
        """The area between two lines."""
        xs = np.asarray(x, dtype=float)
        outline = self._points(np.r_[xs, xs[::-1]], np.r_[np.asarray(low), np.asarray(high)[::-1]])
        self._marks.append(f'<polygon points="{outline}" fill="{color}"/>')
        if label:
            self._legend.append((label, color, "band"))

    def polygon(self, x: ArrayLike, y: ArrayLike, fill: str, *, stroke: str = "none") -> None:
        """A filled shape."""
        self._marks.append(f'<polygon points="{self._points(x, y)}" fill="{fill}" stroke="{stroke}"/>')

    def dots(self, x: ArrayLike, y: ArrayLike, color: str, *, radius: float = 2.5, label: str = "") -> None:
        """Round dots."""
        for a, b in zip(self._px(x), self._py(y)):
            self._marks.append(f'<circle cx="{a:.1f}" cy="{b:.1f}" r="{radius:g}" fill="{color}"/>')
        if label:
            self._legend.append((label, color, "dot"))

    def ellipse(self, middle: Array, covariance: Array, within: float, fill: str) -> None:
        """The ellipse of a (2, 2) covariance about a (2,) point, at `within` standard deviations; equal scales."""
        variances, axes = np.linalg.eigh(covariance)
        scale = abs(float(self._px(1.0) - self._px(0.0)))
        short, long = within * scale * np.sqrt(np.maximum(variances, 0.0))
        turn = -math.degrees(math.atan2(axes[1, 1], axes[0, 1]))
        at = f"{float(self._px(middle[0])):.1f} {float(self._py(middle[1])):.1f}"
        self._marks.append(
            f'<ellipse rx="{long:.1f}" ry="{short:.1f}" transform="translate({at}) rotate({turn:.0f})" fill="{fill}"/>'
        )

    def image(self, x: Range, y: Range, uri: str) -> None:
        """An image stretched over a range of the data, with sharp pixels."""
        (left, right), (bottom, top) = self._px(x), self._py(y)
        box = f'x="{left:.1f}" y="{top:.1f}" width="{right - left:.1f}" height="{bottom - top:.1f}"'
        how = 'preserveAspectRatio="none" style="image-rendering:pixelated"'
        self._marks.append(f'<image {box} {how} href="{uri}"/>')

    def legend(self, label: str, color: str, style: str = "") -> None:
        """An entry of the legend: a line, dashed if `style` gives dashes, a `band` or a `dot`."""
        self._legend.append((label, color, style))

    def note(self, x: float, y: float, words: str, *, anchor: str = "middle") -> None:
        """Text at a point of the data."""
        at = f'x="{float(self._px(x)):.1f}" y="{float(self._py(y)):.1f}"'
        self._marks.append(f'<text {at} text-anchor="{anchor}" fill="{_MUTED}" font-size="11">{escape(words)}</text>')

    def _grid(self) -> list[str]:
        out = []
        left, right, bottom = _LEFT, self.width - _RIGHT, self.height - self._bottom
        for value, words in self.y_names.items():
            at = float(self._py(value)) + 4
            out.append(f'<text x="{left - 6}" y="{at:.1f}" text-anchor="end">{escape(words)}</text>')
        for value in () if self.y_names else ticks(self.y, int(self.height / 45)):
            at = float(self._py(value))
            out.append(f'<line x1="{left}" x2="{right:g}" y1="{at:.1f}" y2="{at:.1f}" stroke="{_GRID}"/>')
            out.append(f'<text x="{left - 6}" y="{at + 4:.1f}" text-anchor="end">{_number(value)}</text>')
        named = dict(enumerate(self.x_names))
        for value in named or ticks(self.x, int(self.width / 80)):
            at = float(self._px(value))
            out.append(f'<line x1="{at:.1f}" x2="{at:.1f}" y1="{bottom:g}" y2="{bottom + 4:g}" stroke="#b8c3d0"/>')
            words = escape(named[int(value)]) if named else _number(value)
            out.append(f'<text x="{at:.1f}" y="{bottom + 17:g}" text-anchor="middle">{words}</text>')
        out.append(f'<line x1="{left}" x2="{right:g}" y1="{bottom:g}" y2="{bottom:g}" stroke="#b8c3d0"/>')
        if self.x_label:
            corner = f'x="{right:g}" y="{self.height - 6:g}"'
            out.append(f'<text {corner} text-anchor="end">{escape(self.x_label)}</text>')
        if self.y_label:
            out.append(f'<text x="4" y="14">{escape(self.y_label)}</text>')
        return out

    def _key(self) -> list[str]:
        out, x = [], self.width - _RIGHT
        for label, color, style in reversed(self._legend):
            x -= 6.9 * len(label) + 4
            out.append(f'<text x="{x:.1f}" y="14" fill="{_INK}">{escape(label)}</text>')
            if style == "band":
                out.append(f'<rect x="{x - 20:.1f}" y="5" width="16" height="10" rx="2" fill="{color}"/>')
            elif style == "dot":
                out.append(f'<circle cx="{x - 9:.1f}" cy="10" r="3.5" fill="{color}"/>')
            else:
                dash = f' stroke-dasharray="{style}"' if style else ""
                line = f'x1="{x - 20:.1f}" x2="{x - 4:.1f}" y1="10" y2="10"'
                out.append(f'<line {line} stroke="{color}" stroke-width="2.5"{dash}/>')
            x -= 28
        return out

    def svg(self, css_class: str = "") -> str:
        """The plot as an `<svg>` element that scales to its container's width."""
        body = "".join([*self._grid(), *self._marks, *self._key()])
        name = f' class="{css_class}"' if css_class else ""
        box = f'viewBox="0 0 {self.width:g} {self.height:g}"'
        style = f'role="img" aria-label="{escape(self.title)}" font-size="12" fill="{_MUTED}"'
        return f"<svg{name} {box} {style}>{body}</svg>"


def wide_and_narrow(draw: Callable[[float], Plot]) -> str:
    """A plot drawn for a wide and for a narrow window; the style sheet shows the one that fits."""
    return draw(1120.0).svg("wide") + draw(420.0).svg("narrow")


def _number(value: float) -> str:
    return f"{value:.10g}".replace("-", "\N{MINUS SIGN}")
