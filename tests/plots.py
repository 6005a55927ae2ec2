"""Reads the figures of a page: traces with NumPy arrays, by title."""

import base64
import html as html_text
import json
import re

import numpy as np

_FIGURE = re.compile(
    r'<div class="plot" role="img" aria-label="([^"]*)"[^>]*><script type="application/json">(.*?)</script>', re.S
)


class Figure:
    """One figure: its traces and its layout."""

    def __init__(self, text):
        figure = json.loads(text)
        self.layout, self.aspect = figure["layout"], figure["aspect"]
        self.traces = [{key: _array(value) for key, value in trace.items()} for trace in figure["data"]]

    @property
    def labels(self):
        return [trace["name"] for trace in self.traces if trace["showlegend"]]

    def points(self, label):
        """(N, 2) points of all traces of a label, NaN between separate shapes."""
        return np.concatenate([np.column_stack([t["x"], t["y"]]) for t in self.traces if t.get("name") == label])

    def shapes(self, label):
        """The separate shapes of a label."""
        points = self.points(label)
        parts = np.split(points, np.flatnonzero(np.isnan(points[:, 0])) + 1)
        return [p[np.isfinite(p[:, 0])] for p in parts if np.isfinite(p[:, 0]).any()]


def _array(value):
    if isinstance(value, dict) and "bdata" in value:
        return np.frombuffer(base64.b64decode(value["bdata"]), "<f4").astype(float)
    return value


def figures(html):
    """Title to figure, in order."""
    return {html_text.unescape(title): Figure(text) for title, text in _FIGURE.findall(str(html))}


def figure(html):
    """The only figure."""
    (found,) = figures(html).values()
    return found
