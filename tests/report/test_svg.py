import xml.etree.ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stridetwin.report.svg import Plot, data_range, thin, ticks


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6), st.integers(1, 12))
def test_ticks_are_round_lie_inside_and_are_as_many_as_asked(low, span, about):
    values = ticks((low, low + span), about)
    assert len(values) <= 1.5 * about + 1
    assert all(low - 1e-6 * span <= v <= low + span * (1 + 1e-6) for v in values)


def test_thinning_keeps_peaks_ends_and_order():
    x = np.arange(10_000.0)
    y = np.sin(x / 700)
    y[4321] = 9.0
    few_x, few_y = thin(x, y, 100)
    assert len(few_x) <= 202
    assert few_y.max() == 9.0
    assert few_x[0] == 0
    assert few_x[-1] == 9999
    assert np.all(np.diff(few_x) > 0)


def test_a_plot_is_well_formed_and_escapes_words():
    plot = Plot(width=400, height=200, x=(0, 1), y=(-1, 1), title="a < b & c", x_label="t, s", y_label="<v>")
    plot.line([0, 0.4, 0.6, 1], [0, np.nan, 1, -1], "#123456", label="<one>")
    plot.band([0, 1], [0, 0], [1, 1], "#eee", label="band")
    plot.dots([0.5], [0.5], "red", label="dot")
    root = ET.fromstring(plot.svg())
    assert root.attrib["viewBox"] == "0 0 400 200"
    lines = [e for e in root if e.tag == "polyline"]
    assert len(lines) == 1
    assert "nan" not in plot.svg()


@pytest.mark.parametrize("values", [[], [np.nan], [3.0], [0.0, 0.0]])
def test_ranges_are_never_empty(values):
    low, high = data_range(values)
    assert low < high


def test_lines_share_one_scale_whatever_is_drawn_first():
    plot = Plot(width=400, height=200, x=(0, 1), y=(0, 1), title="two")
    for name in ("first", "second"):
        plot.line([0, 1], [0.2, 0.8], "#123456", label=name)
    first, second = (e.attrib["points"] for e in ET.fromstring(plot.svg()) if e.tag == "polyline")
    assert first == second
