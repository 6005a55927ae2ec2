"""Streams as tables: the columns have the names of axes, cells and joints."""

import csv

import numpy as np
import pytest
from rigs import every_small_block, small_rig

from stridetwin.cli.main import main
from stridetwin.streams.recording.reader import Recording, RecordingWriter

COLUMNS = {
    "/foot_l/insole": ["force_heel", "force_lateral_ball", "force_medial_ball", "force_toe"],
    "/exo/thigh_l/interaction": ["force_front", "force_back"],
    "/exo/knee_l/encoder": ["angle"],
    "/exo/back/ahrs": [f"q_world_sensor_{c}" for c in "wxyz"] + [f"angular_rate_{c}" for c in "xyz"],
    "/truth/joints": [f"{f}_{joint}" for f in ("position", "velocity", "torque") for joint in ("hip", "knee", "ankle")],
    "/truth/foot_l/phase": ["phase"],
    "/truth/footprints": [
        "foot",
        *(f"p_foot_in_world_{c}" for c in "xyz"),
        *(f"q_world_foot_{c}" for c in "wxyz"),
        "terrain",
        "mode",
    ],
}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("tables") / "walk.mcap"
    with RecordingWriter(path, small_rig(), {}) as writer:
        for block in every_small_block():
            writer.write(block)
    return path


@pytest.mark.parametrize("topic", COLUMNS)
def test_columns_of_a_frame_have_the_names_of_what_they_hold(path, topic):
    recording = Recording(path)
    frame, block = recording.frame(topic), recording.block(topic)
    assert sorted(frame.columns) == sorted(COLUMNS[topic])
    assert frame.index.name == "t_s"
    vectors = [values for values in block.columns.values() if values.ndim == 2]
    if vectors:
        name = next(n for n, values in block.columns.items() if values is vectors[0])
        of_vector = [column for column in frame.columns if column.startswith(f"{name}_")]
        np.testing.assert_array_equal(frame[of_vector].to_numpy(), vectors[0])


@pytest.mark.parametrize("topic", COLUMNS)
@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_any_stream_without_images_is_exported_as_a_table(path, capsys, tmp_path, topic, suffix):
    table, recording = tmp_path / f"table{suffix}", Recording(path)
    assert main(["export", str(path), "--format", "table", "--frame", topic.strip("/"), "-o", str(table)]) == 0
    expected = recording.block(topic).split_columns()
    if suffix == ".npz":
        columns = dict(np.load(table))
    else:
        head, *rows = csv.reader(table.open(encoding="utf-8"))
        columns = {name: np.array([row[i] for row in rows]) for i, name in enumerate(head)}
    assert list(columns) == ["t_s", *expected]
    np.testing.assert_allclose(columns["t_s"].astype(float), recording.times(topic) * 1e-9, atol=1e-9)
    for name, values in expected.items():
        if values.dtype.kind == "f":
            np.testing.assert_allclose(columns[name].astype(float), values, rtol=1e-8)
        else:
            assert columns[name].astype(str).tolist() == values.astype(str).tolist()


def test_a_stream_that_is_not_there_is_refused_with_the_nearest_one(path, capsys, tmp_path):
    table = tmp_path / "table.csv"
    assert main(["export", str(path), "--format", "table", "--frame", "truth/joint", "-o", str(table)]) == 2
    error = capsys.readouterr().err
    assert "export: --frame: invalid 'truth/joint': expected a stream of" in error
    assert "(did you mean 'truth/joints'?)" in error
    assert not table.exists()
