"""Small plots of the documentation as SVG files: lines, bands and dots on one pair of axes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from html import escape

import numpy as np
from numpy.typing import ArrayLike

from stridetwin.pages.plot import INK, MUTED, Range
from stridetwin.streams.samples import Array

_LEFT, _RIGHT, _TOP, _BOTTOM = 46.0, 12.0, 28.0, 40.0
_GRID, _AXIS = "#e6ebf1", "#b8c3d0"


def ticks(span: Range, about: int) -> list[float]:
    """About the given number of round values (1, 2 or 5 times a power of ten) within the span."""
    raw = (span[1] - span[0]) / max(about, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m for m in (1, 2, 5, 10) if m * power >= 0.7 * raw) * power
    first, last = math.ceil(span[0] / step - 1e-9), math.floor(span[1] / step + 1e-9)
    return [k * step for k in range(first, last + 1)]


@dataclass(kw_only=True)
class SvgPlot:
    """One pair of axes. Draw in order; `svg()` gives the text.

    Attributes:
        width: Width of the view box, in units of which the text is 12 high.
        height: Height of the view box.
        x: Range of the data.
        y: Range of the data.
        title: Text for screen readers.
        x_label: Text below the axis.
        y_label: Text at the top left.
    """

    width: float
    height: float
    x: Range
    y: Range
    title: str
    x_label: str
    y_label: str
    _marks: list[str] = field(default_factory=list)
    _legend: list[tuple[str, str]] = field(default_factory=list)

    def line(self, x: ArrayLike, y: ArrayLike, color: str, *, stroke: float = 1.6, dash: str = "none") -> None:
        """A line through the points."""
        style = f'fill="none" stroke="{color}" stroke-width="{stroke:g}" stroke-dasharray="{dash}"'
        self._marks.append(f'<polyline points="{self._points(x, y)}" {style}/>')

    def band(self, x: ArrayLike, low: ArrayLike, high: ArrayLike, color: str) -> None:
        """The area between two lines."""
        outline = self._points(np.r_[x, np.flip(x)], np.r_[low, np.flip(high)])
        self._marks.append(f'<polygon points="{outline}" fill="{color}"/>')

    def dots(self, x: ArrayLike, y: ArrayLike, color: str, *, label: str) -> None:
        """Round dots, with an entry in the legend."""
        for a, b in zip(self._px(x), self._py(y)):
            self._marks.append(f'<circle cx="{a:.1f}" cy="{b:.1f}" r="2.2" fill="{color}"/>')
        self._legend.append((label, color))

    def svg(self) -> str:
        """The file's text."""
        body = "".join([*self._grid(), *self._marks, *self._key()])
        box = f'font-family="sans-serif" viewBox="0 0 {self.width:g} {self.height:g}"'
        style = f'role="img" aria-label="{escape(self.title)}" font-size="12" fill="{MUTED}"'
        return f'<svg xmlns="http://www.w3.org/2000/svg" {box} {style}>{body}</svg>'

    def _points(self, x: ArrayLike, y: ArrayLike) -> str:
        return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(self._px(x), self._py(y)))

    def _px(self, x: ArrayLike) -> Array:
        span = self.width - _LEFT - _RIGHT
        return _LEFT + (np.asarray(x, dtype=float) - self.x[0]) / (self.x[1] - self.x[0]) * span

    def _py(self, y: ArrayLike) -> Array:
        span = self.height - _TOP - _BOTTOM
        return self.height - _BOTTOM - (np.asarray(y, dtype=float) - self.y[0]) / (self.y[1] - self.y[0]) * span

    def _grid(self) -> list[str]:
        out = []
        left, right, bottom = _LEFT, self.width - _RIGHT, self.height - _BOTTOM
        for value in ticks(self.y, int(self.height / 45)):
            at = float(self._py(value))
            out.append(f'<line x1="{left}" x2="{right:g}" y1="{at:.1f}" y2="{at:.1f}" stroke="{_GRID}"/>')
            out.append(f'<text x="{left - 6}" y="{at + 4:.1f}" text-anchor="end">{_number(value)}</text>')
        for value in ticks(self.x, int(self.width / 80)):
            at = float(self._px(value))
            out.append(f'<line x1="{at:.1f}" x2="{at:.1f}" y1="{bottom:g}" y2="{bottom + 4:g}" stroke="{_AXIS}"/>')
            out.append(f'<text x="{at:.1f}" y="{bottom + 17:g}" text-anchor="middle">{_number(value)}</text>')
        out.append(f'<line x1="{left}" x2="{right:g}" y1="{bottom:g}" y2="{bottom:g}" stroke="{_AXIS}"/>')
        out.append(f'<text x="{right:g}" y="{self.height - 6:g}" text-anchor="end">{escape(self.x_label)}</text>')
        return [*out, f'<text x="4" y="14">{escape(self.y_label)}</text>']

    def _key(self) -> list[str]:
        out, x = [], self.width - _RIGHT
        for label, color in reversed(self._legend):
            x -= 6.9 * len(label) + 4
            out.append(f'<text x="{x:.1f}" y="14" fill="{INK}">{escape(label)}</text>')
            out.append(f'<circle cx="{x - 9:.1f}" cy="10" r="3.5" fill="{color}"/>')
            x -= 28
        return out


def _number(value: float) -> str:
    return f"{value:.10g}".replace("-", "\N{MINUS SIGN}")
