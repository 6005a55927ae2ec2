"""Recordings name the version of what they hold; those of every release are read, and scored, as they were then."""

from pathlib import Path

import pytest
from mcap.reader import make_reader

from stridetwin.estimators.base import Options
from stridetwin.estimators.foot_ins import FootIns
from stridetwin.outputs.path.scores import compare, score
from stridetwin.outputs.truth import true_path
from stridetwin.streams.errors import RecordingError
from stridetwin.streams.formats.opening import open_any
from stridetwin.streams.recording import recording_schema, writer
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from stridetwin.streams.recording.recording_schema import METADATA_NAME
from stridetwin.streams.rig import Rig

RELEASES = Path(__file__).parents[1] / "streams" / "releases"
SCORES = {
    "0.1": {"ape_rmse_m": 0.001311, "end_error_m": 0.001677, "end_height_error_m": -0.000903, "distance_m": 1.094263},
}
"""Of today's `foot_ins` on a recording of the release: m."""


def written(path, version=None):
    with pytest.MonkeyPatch.context() as patch:
        if version is not None:
            patch.setitem(recording_schema.VERSION_VALUES, "version", version)
        with RecordingWriter(path, Rig(), {"seed": "1"}):
            pass
    return path


def test_a_recording_names_its_version(tmp_path):
    recording = Recording(written(tmp_path / "a.mcap"))
    assert recording.schema_version == recording_schema.VERSION == "1.0"
    assert recording.metadata == {"seed": "1"}
    with (tmp_path / "a.mcap").open("rb") as file:
        metadata = {m.name: m.metadata for m in make_reader(file).iter_metadata()}
    assert metadata[recording_schema.VERSION_RECORD] == {"version": "1.0"}
    assert metadata[METADATA_NAME] == {"seed": "1"}


def test_newer_minor_versions_are_read_and_newer_major_ones_are_not(tmp_path):
    assert Recording(written(tmp_path / "a.mcap", "1.7")).schema_version == "1.7"
    newer = written(tmp_path / "b.mcap", "2.0")
    for lenient in (False, True):
        for opening in (Recording, open_any):
            with pytest.raises(RecordingError, match=r"b\.mcap: made by a newer release: .*2\.0.*up to 1\.0.*update"):
                opening(newer, lenient)
    with pytest.raises(RecordingError, match=r"invalid schema version 'now': expected MAJOR\.MINOR, up to 1\.0"):
        Recording(written(tmp_path / "c.mcap", "now"))


def test_recordings_without_a_version_are_read(tmp_path):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(writer, "VERSION_RECORD", "something_else")
        with RecordingWriter(tmp_path / "old.mcap", Rig()):
            pass
    assert Recording(tmp_path / "old.mcap").schema_version == "0.0"


@pytest.mark.parametrize("release", list(SCORES))
def test_recordings_of_a_release_are_read_and_scored_as_then(release):
    file = RELEASES / f"{release}.mcap"
    assert file.stat().st_size < 100_000
    recording = Recording(file)
    assert recording.schema_version == "1.0"
    assert recording.problems == []
    assert recording.unread == {}
    assert {info.kind.__name__ for info in recording.topics.values()} >= {
        "Imu",
        "Insole",
        "Ahrs",
        "Encoder",
        "Interaction",
        "Actuator",
        "Range",
        "Odometry",
        "Joints",
        "Wrench",
        "Point",
        "FootPhase",
        "Footprint",
    }
    assert {"scenario", "seed", "physics", "terrain", "exoskeleton"} <= set(recording.metadata)
    assert len(list(recording.samples())) == sum(info.count for info in recording.topics.values())
    (estimate,) = FootIns.follow(recording, Options())
    scores = score(compare(estimate.path, true_path(recording, estimate.frame)))
    for name, value in SCORES[release].items():
        assert scores[name] == pytest.approx(value, rel=0.02, abs=2e-4), name


def test_every_release_has_its_scores():
    assert {file.stem for file in RELEASES.glob("*.mcap")} == set(SCORES)
