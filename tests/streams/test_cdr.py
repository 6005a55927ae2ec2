"""The vectorised messages are byte for byte those of rosbags' serialiser."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rigs import every_small_block, small_rig

from stridetwin.streams.recording.cdr import layout_of
from stridetwin.streams.recording.mcap_writer import build_message_rows
from stridetwin.streams.recording.ros_samples import SAMPLE_MAPPINGS, fill_rows
from stridetwin.streams.recording.ros_types import build_message, serialise, typestore


@pytest.mark.parametrize("block", every_small_block(5), ids=lambda b: b.kind.__name__)
def test_rows_equal_the_reference_serialiser(block):
    small = SAMPLE_MAPPINGS[block.kind]
    payload, layout = small.build_template(block.topic, small_rig(), block.constants)
    rows, payloads = build_message_rows(1, payload, layout.dtype, block.t_ns)
    fill_rows(payloads, small, block)
    for i in range(len(block)):
        values = small.collect_values(block.topic, small_rig(), block.constants)
        if "header.stamp.sec" in layout.dtype.names:
            values["header.stamp.sec"], values["header.stamp.nanosec"] = divmod(int(block.t_ns[i]), 10**9)
        expected = build_message(small.typename, values)
        for path, column in small.write(block.columns).items():
            assign(expected, path.split("."), column[i])
        reference = bytes(typestore().serialize_cdr(expected, small.typename, little_endian=True))
        assert rows[i].tobytes()[31:] == reference


def assign(target, path, value):
    for name in path[:-1]:
        target = getattr(target, name)
    leaf = getattr(target, path[-1])
    if hasattr(leaf, "__msgtype__"):
        for name, component in zip(leaf.__dataclass_fields__, value):
            setattr(leaf, name, float(component))
    else:
        setattr(target, path[-1], np.asarray(value, leaf.dtype) if isinstance(leaf, np.ndarray) else value)


@given(frame=st.text(max_size=9), names=st.lists(st.text(max_size=6), max_size=4), little=st.booleans())
def test_layout_finds_numbers_behind_any_strings(frame, names, little):
    frame, names = frame.replace("\0", ""), [n.replace("\0", "") for n in names]
    numbers = np.arange(len(names), dtype=float) + 0.5
    msg = build_message("sensor_msgs/msg/JointState", {"header.frame_id": frame, "name": names, "position": numbers})
    payload = bytes(typestore().serialize_cdr(msg, "sensor_msgs/msg/JointState", little_endian=little))
    layout = layout_of(payload, "sensor_msgs/msg/JointState", typestore())
    row = np.frombuffer(payload, layout.dtype)
    assert layout.strings == {"header.frame_id": frame, "name": names}
    assert row["position"][0].tolist() == numbers.tolist()
    assert row["velocity"].size == 0
    assert layout.fits(row.view(f"V{len(payload)}"))


@given(st.binary(max_size=60))
def test_garbage_is_refused_with_a_value_error(data):
    with pytest.raises(ValueError, match=r"."):
        layout_of(data, "sensor_msgs/msg/Imu", typestore())


def test_layouts_differ_where_a_length_differs():
    kind = "sensor_msgs/msg/JointState"
    one = serialise(kind, {"name": ["ab"], "position": np.zeros(1)})
    other = serialise(kind, {"name": ["a", ""], "position": np.zeros(0)})
    padded = other.ljust(len(one), b"\0")[: len(one)]
    layout = layout_of(one, kind, typestore())
    assert not layout.fits(np.frombuffer(padded, f"V{len(one)}"))
