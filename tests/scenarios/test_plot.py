import numpy as np
import pytest

from stridetwin.pages.html import page, section
from stridetwin.pages.plot import Plot, data_range, join_curves, thin
from tests.plots import figure, figures


def test_thinning_keeps_peaks_ends_order_and_gaps():
    x = np.arange(10_000.0)
    y = np.sin(x / 700)
    y[4321] = 9.0
    y[7000:7003] = np.nan
    few_x, few_y = thin(x, y, 100)
    assert len(few_x) <= 203
    assert np.nanmax(few_y) == 9.0
    assert (few_x[0], few_x[-1]) == (0, 9999)
    assert np.all(np.diff(few_x) > 0)
    assert few_x[np.isnan(few_y)].tolist() == [7000]


@pytest.mark.parametrize("values", [[], [np.nan], [3.0], [0.0, 0.0]])
def test_ranges_are_never_empty(values):
    low, high = data_range(values)
    assert low < high


def test_separate_curves_of_one_label_have_one_entry_in_the_legend():
    plot = Plot(title="a < b & c", x_label="t, s", y_label="<v>")
    plot.line(*join_curves([[(0, 1), (1, 2)], [(3, 4), (5, 6)]]).T, "#123456", label="</script>")
    plot.dots([0.5], [0.5], "#123456", label="</script>")
    plot.band([0, 1], [0, 0], [1, 1], "#eeeeee")
    found = figures(plot.html())
    assert list(found) == ["a < b & c"]
    assert found["a < b & c"].labels == ["</script>"]
    assert [len(s) for s in found["a < b & c"].shapes("</script>")][:2] == [2, 2]
    assert found["a < b & c"].layout["yaxis"]["title"]["text"] == "<v>"


def test_a_metre_is_as_long_both_ways_unless_the_figure_would_be_a_line():
    square = figure(Plot(title="", x=(0, 4), y=(0, 2), to_scale=True, y_label="y, m").html())
    assert square.aspect == 0.5
    assert square.layout["yaxis"]["scaleanchor"] == "x"
    flat = figure(Plot(title="", x=(0, 50), y=(0, 0.4), to_scale=True, y_label="y, m").html())
    assert flat.aspect == 0
    assert flat.layout["yaxis"]["range"] == [0, 0.4]
    assert flat.layout["yaxis"]["title"]["text"] == "y, m (stretched)"


def test_bars_are_one_or_many():
    plot = Plot(title="")
    plot.bars(1.0, 2.0, 0.0, 3.0, "#123456", label="one")
    plot.bars([1.0, 4.0], [2.0, 5.0], 0.0, [3.0, 4.0], "#123456", label="two")
    plot.bars([], [], 0.0, [], "#123456", label="none")
    drawn = figure(plot.html())
    assert drawn.labels == ["one", "two"]
    assert [len(drawn.shapes(label)) for label in drawn.labels] == [1, 2]


def test_equal_figures_give_equal_bytes_and_a_page_holds_the_library_once():
    def make():
        plots = []
        for name in ("first", "second"):
            plot = Plot(title=name)
            plot.line([0, 1], [0.2, 0.8], "#123456")
            plots.append(plot.html())
        return page("Two", "", [], [section("Figures", "", plots[0] + plots[1])], "")

    html = make()
    assert html == make()
    assert html.count("const plotlyPacked") == 1
    assert 1_500_000 < len(html) < 2_500_000
    assert "plotlyPacked" not in page("None", "", [], [section("Text", "", "words")], "")
