import io
import re
from types import SimpleNamespace

import av
import numpy as np
import pytest
from browser import CHROMIUM, Browser

from stridetwin.outputs.path.report import describe_distance
from stridetwin.pages.plot import library
from stridetwin.reference.norms import level_norm, read_reference, speed_group
from stridetwin.report.figures_gait import level_strides
from stridetwin.report.images import colour_of_depth, crop_to_rendered, make_film
from stridetwin.report.rerun_file import recording_id, write_rerun
from stridetwin.run.recording import evaluate_recording
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Imu
from tests.plots import figures

WHOLE = "[...document.querySelectorAll('.scroll')].filter(e => e.scrollWidth > e.clientWidth).length === 0"
APART = """[...document.querySelectorAll('.plot')].every(plot => {
  const legend = plot.querySelector('.legend'), bar = plot.querySelector('.modebar').getBoundingClientRect();
  if (!legend) return true;
  const box = legend.getBoundingClientRect(), axes = plot.querySelector('.nsewdrag').getBoundingClientRect();
  return box.bottom <= axes.top + 2 && box.top >= bar.bottom - 2 && box.right <= plot.getBoundingClientRect().right + 2;
})"""


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
@pytest.mark.parametrize("width", [1280, 390])
def test_the_report_shows_everything_and_asks_the_network_for_nothing(walk, width):
    with Browser() as browser:
        page = browser.open(walk / "report.html", width, height=12_000)
        drawn = browser.wait("[...document.querySelectorAll('.plot')].every(d => d.querySelector('.main-svg'))")
        assert browser.wait(APART, 10)  # legends lie above their axes, below the buttons, and are not cut off
        assert browser.wait(WHOLE, 0)
        page = browser.state()
    assert drawn
    assert page["errors"] == []
    assert page["requests"] == []
    assert page["overflow"] <= 0
    assert len(page["images"]) == 8 + 2 * 6
    assert all(page["images"])
    assert page["videos"] == [True]
    for words in (
        "Accuracy",
        "Paths",
        "Gait",
        "stridetwin run level_20m --seed 3",
    ):
        assert words in page["text"]


def test_the_report_has_no_address_and_no_gap(walk):
    html = (walk / "report.html").read_text().replace(library(), "")
    assert not re.search(r'(src|href|poster)="(?!data:)', html)
    assert not re.search(r"<script [^>]*src|@import|url\(|https?:", html)
    text = re.sub(r"<script.*?</script>", "", re.sub(r"base64,[^\"]*", "", html), flags=re.S)
    assert "nan" not in text.lower().replace("finance", "")
    assert "$" not in text


def test_every_axis_has_a_title_and_every_curve_of_a_path_its_own_colour(walk):
    found = figures((walk / "report.html").read_text())
    assert {"Plan view", "Side view, left foot", "Position error over time, right foot"} <= set(found)
    for title, shown in found.items():
        assert shown.layout["yaxis"]["title"]["text"], title
    assert found["Plan view"].layout["yaxis"]["title"]["text"].startswith("y, m")
    colors = [t["line"]["color"] for t in found["Plan view"].traces if t.get("mode") == "lines" and "fill" not in t]
    assert len(set(colors[2:])) == len(colors[2:])  # the first two are the true path of each foot


def test_strides_are_level_and_inside_the_walk(walk):
    footprints = list(Recording(walk / "recording.mcap").block("/truth/footprints"))
    strides = level_strides(footprints)
    assert len(strides) == len(footprints) - 4
    assert {s.foot for s in strides} == {"l", "r"}
    assert all(s.speed_mps == pytest.approx(1.2 / 1.1, rel=1e-6) for s in strides)


def test_norms_come_from_the_reference_folder():
    cycle, mean, sd = level_norm("Free", "knee_flexion_deg")
    assert (cycle[0], cycle[-1], len(cycle)) == (0, 100, 51)
    assert 55 < mean.max() < 65
    assert np.all(sd > 0)
    groups = [speed_group(v) for v in (0.6, 0.7, 1.2, 1.6, 2.0)]
    assert groups == ["VerySlow", "Slow", "Free", "Fast", "VeryFast"]
    assert speed_group(1.2, leg_m=0.9 * 1.2**2 / 1.0) == speed_group(1.0) == "Slow"  # the same Froude number
    assert read_reference("jao2020")["jao_straight_53m"]["mean_end_error_m"]["zupt"] == [5.2113, 3.2046]


def test_depth_colours_distinguish_near_far_and_invalid():
    colours = colour_of_depth(np.array([[0.0, 0.5, 5.5]], np.float32))
    assert colours.shape == (1, 3, 3)
    assert colours[0, 0].tolist() == [0, 0, 0]
    assert colours[0, 1].sum() > colours[0, 2].sum()


def test_a_shoe_cameras_image_is_cropped_to_what_is_rendered():
    image = np.full((120, 160), 96, np.uint8)
    assert crop_to_rendered(image) is None
    image[30:60, 50:70] = 200
    part = crop_to_rendered(image)
    assert part.shape == (30, 40)
    assert (part == 200).sum() == 600
    image[30:60, 50:160] = 200  # cut off by the border
    assert crop_to_rendered(image) is None


def test_a_film_has_equal_bytes_few_bits_and_its_frames():
    t = np.arange(24) / 12
    x = np.arange(192)
    frames = [np.tile(np.uint8(127 + 100 * np.sin(x / 20 + 6 * s))[:, None], (108, 1, 3)) for s in t]
    film, again = (make_film(zip(t.tolist(), frames), 2.0) for _ in range(2))
    assert film.webm == again.webm
    assert 8 * len(film.webm) < 0.4 * 24 * 108 * 192
    assert len(film.stills) == 8
    with av.open(io.BytesIO(film.webm)) as opened:
        shown = [f.to_ndarray(format="rgb24") for f in opened.decode(video=0)]
    assert len(shown) == 24
    assert np.mean(np.abs(shown[12].astype(int) - frames[12])) < 4
    with pytest.raises(StrideTwinError, match="no frames"):
        make_film([], 2.0)


def test_the_rerun_file_is_small_and_whole(walk, tmp_path):
    recording = Recording(walk / "recording.mcap")
    path = tmp_path / "walk.rrd"
    write_rerun(path, recording, list(evaluate_recording(recording)))
    assert path.read_bytes()[:4] == b"RRF2"
    assert path.stat().st_size < 3_000_000


def test_viewers_keep_seeds_kinds_of_physics_and_imported_walks_apart(tmp_path):
    def named(file, stamps=(0, 10_000_000), **metadata):
        n = len(stamps)
        columns = {"angular_rate": np.zeros((n, 3)), "specific_force": np.tile((0.0, 0.0, 9.81), (n, 1))}
        with RecordingWriter(tmp_path / file, Rig(), metadata) as writer:
            writer.write(Block(topic="/head/imu", kind=Imu, t_ns=np.array(stamps), columns=columns))
        return recording_id(Recording(tmp_path / file))

    walk = {"scenario": "level_20m", "seed": "3", "physics": "kinematic"}
    same = named("a.mcap", **walk)
    assert same.startswith("stridetwin-level_20m-3-kinematic-")
    assert named("b.mcap", **walk) == same
    others = [
        named("c.mcap", **walk | {"seed": "4"}),
        named("d.mcap", **walk | {"physics": "dynamic"}),
        named("e.mcap", source="walk", imported_from="table"),
        named("f.mcap", (5, 10_000_005), source="walk", imported_from="table"),
    ]
    assert len({same, *others}) == 5
    rerun = pytest.importorskip("rerun")
    assert rerun
    write_rerun(tmp_path / "a.rrd", Recording(tmp_path / "a.mcap"), [])
    assert same.encode() in (tmp_path / "a.rrd").read_bytes()


def test_who_travelled_is_said():
    def result(frame, distance_m):
        return SimpleNamespace(estimate=SimpleNamespace(frame=frame), scores={"distance_m": distance_m})

    camera, feet = result("head/imu", 21.5), [result("foot_l/imu", 20.1), result("foot_r/imu", 20.3)]
    assert describe_distance([camera]) == "21.5 m travelled by the camera"
    assert describe_distance([*feet, camera]) == "20.3 m travelled by a foot"
