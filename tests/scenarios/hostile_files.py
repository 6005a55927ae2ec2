"""Files that were made to hurt: each is small, and asks its reader for gigabytes, minutes or worse."""

import functools
import io
import json
import os
import sqlite3
import struct
import zipfile
import zlib
from pathlib import Path

import cv2
import lz4.frame
import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore

from benchmarks.foreign_files import Walk, write_csv_table, write_euroc, write_npz_table, write_rosbag2, write_tum
from stridetwin.streams.recording.mcap_writer import MAGIC
from stridetwin.streams.recording.ros_types import definition

MIB = 1 << 20
GIB = 1 << 30
ZSTD_BLOCK = 128 << 10
RIG = """
imu0: {rostopic: /head/imu, update_rate: 200, gyroscope_noise_density: 0.001, gyroscope_random_walk: 2.0e-5,
       accelerometer_noise_density: 0.01, accelerometer_random_walk: 3.0e-4}
stridetwin:
  imu0: {part: a, mount: {body: head, T_body_sensor: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}}
"""
ALIASES = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 12)
)
MERGES = "a0: &a0 {x: 1}\n" + "".join(f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 10)}]}}\n" for i in range(1, 12))
DEEP = "[" * 100_000
DEPTH = "16UC1; compressedDepth"
YAMLS = {
    "aliases": ALIASES,
    "merges": MERGES,
    "deep": DEEP,
    "itself": "a: &a [*a, *a]\n",
    "digits": "9" * 10_000 + "\n",
    "date": "a: 2001-99-99\n",
    "values": "[" + "1," * 400_000 + "1]",
}


def encoded(record):
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def mcap(path, *parts):
    """An MCAP file of records, with neither index nor CRC."""
    end = encoded(records.DataEnd(0)) + encoded(records.Footer(0, 0, 0)) + MAGIC
    path.write_bytes(MAGIC + encoded(records.Header("ros2", "evil")) + b"".join(parts) + end)
    return path


def chunk(data, size, compression, crc=0):
    return encoded(
        records.Chunk(
            compression=compression,
            data=data,
            message_start_time=0,
            message_end_time=1,
            uncompressed_crc=crc,
            uncompressed_size=size,
        )
    )


def zstd_zeros(size, head=b""):
    """A frame of zstd: a block of the bytes at its head, and blocks that repeat one zero."""

    def block(kind, length, data, is_last=False):
        return (is_last | kind << 1 | length << 3).to_bytes(3, "little") + data

    whole, rest = divmod(size - len(head), ZSTD_BLOCK)
    frame = struct.pack("<IBB", 0xFD2FB528, 0, 11 << 3)  # a window of 2 MiB
    frame += block(0, len(head), head) + block(1, ZSTD_BLOCK, b"\0") * whole
    return frame + block(1, rest, b"\0", is_last=True)


@functools.cache
def lz4_zeros(size):
    """A frame of lz4, all blocks of which are equal."""
    packer = lz4.frame.LZ4FrameCompressor(block_size=lz4.frame.BLOCKSIZE_MAX1MB, block_linked=False)
    return packer.begin() + packer.compress(bytes(MIB)) * (size // MIB) + packer.flush()


def announced(typename, topic="/head/color", text=None):
    """A schema and a channel of it."""
    data = (definition(typename) if text is None else text).encode()
    return encoded(records.Schema(1, data, "ros2msg", typename)) + encoded(records.Channel(1, topic, "cdr", {}, 1))


def message(payload, t_ns=1):
    body = struct.pack("<HIqq", 1, 0, t_ns, t_ns) + payload
    return struct.pack("<BQ", 5, len(body)) + body


def packed(data):
    return chunk(zstandard.compress(data), len(data), "zstd")


def compressed(data, form="png"):
    """A CompressedImage in CDR."""
    text = form.encode() + b"\0"
    head = b"\0\1\0\0" + struct.pack("<iI", 1, 1) + struct.pack("<I", 1) + b"\0" + bytes(3)
    body = head + struct.pack("<I", len(text)) + text
    body += bytes(-(len(body) - 4) % 4)
    return body + struct.pack("<I", len(data)) + data


def sized_png(width, height):
    """A PNG that claims a size, whole by its CRCs, with a few bytes inside."""
    parts = b"\x89PNG\r\n\x1a\n"
    for kind, data in (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(bytes(1000))),
        (b"IEND", b""),
    ):
        parts += struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    return parts


def sized_jpeg(width, height):
    frame = b"\xff\xc0" + struct.pack(">HBHHB", 17, 8, height, width, 3) + b"\1\x22\0\2\x11\1\3\x11\1"
    return b"\xff\xd8" + frame + b"\xff\xda\0\x0c\3\1\0\2\x11\3\x11\0?\0" + bytes(100) + b"\xff\xd9"


def scanned_jpeg(width, height):
    """A small progressive JPEG that asks for 4000 passes over its pixels, each with tables of its own."""
    grey = np.zeros((height, width), np.uint8)
    data = cv2.imencode(".jpg", grey, (cv2.IMWRITE_JPEG_PROGRESSIVE, 1))[1].tobytes()
    at = data.index(b"\xff\xda", data.index(b"\xff\xda") + 2)  # the first may come but once
    scan = data[at : at + 2 + int.from_bytes(data[at + 2 : at + 4], "big")]
    tables = b"\xff\xc4\0\x14\x10\1" + bytes(15) + b"\0"  # one code: the end of a block
    return data[:-2] + (tables + scan) * 4000 + data[-2:]


def rig_attached(text):
    return encoded(records.Attachment(create_time=0, log_time=0, name="rig.yaml", media_type="a", data=text.encode()))


def told_metadata(**values):
    return encoded(records.Metadata(name="stridetwin", metadata=values))


def sparse(path, head, size):
    path.write_bytes(head)
    os.truncate(path, size)
    return path


def mcaps(folder):
    """Hostile MCAP files."""
    ours = rig_attached(RIG)
    for name, compression, data in (("zstd", "zstd", zstd_zeros(GIB)), ("lz4", "lz4", lz4_zeros(GIB))):
        yield mcap(folder / f"bomb_{name}.mcap", ours, chunk(data, GIB, compression))
        yield mcap(folder / f"bomb_{name}_denied.mcap", ours, chunk(data, 1000, compression))
        yield mcap(folder / f"bomb_{name}_foreign.mcap", chunk(data, GIB, compression))
    head = message(b"")[9:] + b"\0\1\0\0"  # one message of 60 MiB in each of many chunks
    head = struct.pack("<BQ", 5, 60 * MIB - 9) + head
    many = chunk(zstd_zeros(60 * MIB, head), 60 * MIB, "zstd")
    video = announced("sensor_msgs/msg/Image")
    yield mcap(folder / "bombs.mcap", ours, video, many * 300)
    yield mcap(folder / "bombs_foreign.mcap", video, many * 300)
    yield mcap(folder / "huge_record.mcap", struct.pack("<BQ", 6, 2**62))
    yield sparse(folder / "sparse.mcap", MAGIC + struct.pack("<BQ", 6, 30 * GIB), 40 * GIB)
    yield mcap(folder / "huge_chunk_size.mcap", ours, chunk(zstandard.compress(b"x"), 2**63, "zstd"))
    imu = "sensor_msgs/msg/Imu"
    crowd = packed(message(b"") * 1_500_000)
    yield mcap(folder / "crowd.mcap", ours, announced(imu, "/head/imu"), crowd)
    yield mcap(folder / "crowd_foreign.mcap", announced(imu, "/head/imu"), crowd * 20)
    types = [encoded(records.Schema(i % 65535 + 1, b"x" * 10, "ros2msg", imu)) for i in range(50_000)]
    yield mcap(folder / "schemas.mcap", ours, packed(b"".join(types)))
    line = "=" * 80
    for name, text in {
        "strings": "string[1000000000] x",
        "numbers": "float64[4000000000] x",
        "nothing": f"Empty[] x\n{line}\nMSG: sensor_msgs/Empty\n",
        "itself": "Imu[] x",
        "levels": "A0 x\n" + "".join(f"{line}\nMSG: sensor_msgs/A{i}\nA{i + 1} y\nA{i + 1} z\n" for i in range(60)),
        "long": "\n".join(f"float64 a{i}" for i in range(100_000)),
    }.items():
        data = announced(imu, "/head/imu", text), packed(message(b"\0\1\0\0" + b"\xff" * 400))
        yield mcap(folder / f"type_{name}.mcap", ours, *data)
        yield mcap(folder / f"type_{name}_foreign.mcap", *data)
    for topic, typename, payload in (
        ("/truth/joints", "sensor_msgs/msg/JointState", b"\0\1\0\0" + b"\xff\xff\xff\x7f" * 9000),
        ("/head/depth", "sensor_msgs/msg/Image", b"\0\1\0\0" + bytes(16) + b"\0\0\1\0" * 2 + bytes(99)),
        ("/tf_static", "tf2_msgs/msg/TFMessage", b"\0\1\0\0" + b"\0\xca\x9a\x3b" + bytes(5000)),
        ("/head/color", "sensor_msgs/msg/CompressedImage", compressed(sized_png(60_000, 60_000))),
        ("/head/other", "sensor_msgs/msg/CompressedImage", compressed(sized_jpeg(65_000, 65_000), "jpeg")),
        ("/head/third", "sensor_msgs/msg/CompressedImage", compressed(bytes(12) + sized_png(40_000, 40_000), DEPTH)),
        ("/head/scans", "sensor_msgs/msg/CompressedImage", compressed(scanned_jpeg(4096, 4096), "jpeg")),
        ("/head/tiff", "sensor_msgs/msg/CompressedImage", compressed(b"II*\0\x08\0\0\0" + bytes(500), "tiff")),
    ):
        name = topic.strip("/").replace("/", "_")
        data = announced(typename, topic), packed(message(payload) + message(payload, 2))
        yield mcap(folder / f"payload_{name}.mcap", ours, *data)
        yield mcap(folder / f"payload_{name}_foreign.mcap", *data)
    for name, text in YAMLS.items():
        yield mcap(folder / f"rig_{name}.mcap", rig_attached(text), announced(imu, "/head/imu"))
    deep = "[" * 200_000
    yield mcap(folder / "metadata.mcap", ours, told_metadata(terrain=deep, faults=deep, exoskeleton=ALIASES))


def tables(folder, walk):
    """Hostile tables."""
    plain = write_npz_table(folder, walk)
    with np.load(plain) as table:
        accel = table["accel"]
    declared = {"bomb": ((32 * MIB,), bytes(256 * MIB)), "declared": ((10**9, 3), bytes(24)), "none": ((2**62,), b"")}
    for name, (shape, data) in declared.items():
        with zipfile.ZipFile(folder / f"table_{name}.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
            head = io.BytesIO()
            np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": shape})
            for member in ("t", "accel", "gyro"):
                with file.open(f"{member}.npy", "w", force_zip64=True) as out:
                    out.write(head.getvalue() + (data if member == "gyro" else bytes(24)))
        yield folder / f"table_{name}.npz"
    evil = np.array([b"cos\nsystem\n(S'true'\ntR."], object)
    np.savez(folder / "pickle.npz", t=evil, accel=accel, gyro=accel)
    yield folder / "pickle.npz"
    plain.unlink()
    rows = write_csv_table(folder, walk).read_bytes()
    (folder / "imu.csv").unlink()
    yield sparse(folder / "rows.csv", rows, 80 * GIB)  # 10⁹ rows and their bytes
    yield sparse(folder / "line.csv", rows, 200 * MIB)
    (folder / "short.csv").write_bytes(b"t,ax,ay,az,gx,gy,gz\n" + b"0\n" * 3_000_000)
    yield folder / "short.csv"


def ros1(folder):
    """Hostile ROS 1 bags."""
    store = get_typestore(Stores.ROS1_NOETIC)
    name = "std_msgs/msg/String"

    def written(file, compressor=None, form=Ros1Writer.CompressionFormat.LZ4):
        bag = Ros1Writer(folder / file)
        bag.set_compression(form)
        if compressor is not None:
            bag.compressor = compressor
        with bag as writer:
            to = writer.add_connection("/head/imu", "sensor_msgs/msg/Imu", typestore=store)
            other = writer.add_connection("/head/text", name, typestore=store)
            for i in range(3):
                writer.write(other, i, store.serialize_ros1(store.types[name]("hi"), name))
                writer.write(to, i, bytes(400))
        return folder / file

    yield written("bomb_lz4.bag", lambda _: lz4_zeros(GIB))
    import bz2

    yield written("bomb_bz2.bag", lambda _: bz2.compress(bytes(100 * MIB), 1), Ros1Writer.CompressionFormat.BZ2)
    plain = written("plain.bag").read_bytes()
    for field in (b"chunk_count=", b"conn_count=", b"count="):
        at = plain.rindex(field) + len(field)
        path = folder / f"bag_{field.decode().strip('=')}.bag"
        path.write_bytes(plain[:at] + struct.pack("<I", 10**9) + plain[at + 4 :])
        yield path
    path = folder / "bag_header.bag"
    path.write_bytes(plain[:13] + struct.pack("<I", 2**32 - 1) + plain[17:])
    os.truncate(path, 20 * GIB)
    yield path
    text = b"geometry_msgs/Quaternion orientation"
    path = folder / "bag_type.bag"  # a fixed array in the place of a field, in a definition of the same length
    evil = b"string[999999999] x".ljust(len(text))
    path.write_bytes(plain.replace(text, evil))
    yield path
    (folder / "plain.bag").unlink()


def ros2(folder, walk):
    """Hostile ROS 2 bags."""
    plain = write_rosbag2(folder, walk)
    database = next(plain.glob("*.db3")).read_bytes()
    metadata_text = (plain / "metadata.yaml").read_text()

    def bag(name, script, metadata=metadata_text):
        place = folder / name
        place.mkdir()
        file = place / "bag_sqlite.db3"
        file.write_bytes(database)
        (place / "metadata.yaml").write_text(metadata)
        if script:
            connection = sqlite3.connect(file)
            connection.executescript(script)
            connection.commit()
            connection.close()
        return place

    rows = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n LIMIT 1000000000)"
    yield bag(
        "view",
        f"DROP TABLE messages; CREATE VIEW messages AS {rows} SELECT i AS id, 1 AS topic_id, i AS timestamp, "
        "zeroblob(400) AS data FROM n;",
    )
    yield bag(
        "reckoned",
        "DROP TABLE messages; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
        "data BLOB GENERATED ALWAYS AS (zeroblob(900000000)) VIRTUAL); "
        "INSERT INTO messages(topic_id, timestamp) VALUES (1, 1), (1, 2);",
    )
    for name, text in YAMLS.items():
        yield bag(f"metadata_{name}", "", f"rosbag2_bagfile_information:\n  version: 9\n{text}")
    for mode, text in (("mode", "file"), ("format", "zstd")):
        metadata_text = metadata_text.replace(f"compression_{mode}: ''", f"compression_{mode}: {text}")
    yield bag("packed", "", metadata_text)


def folders(folder, walk):
    """Hostile folders of other tools."""
    for name, text in YAMLS.items():
        place = folder / f"euroc_{name}"
        root = write_euroc(place, walk) / "mav0"
        (root / "imu0" / "sensor.yaml").write_text(text)
        yield root.parent
    images = {
        "png": sized_png(60_000, 60_000),
        "jpeg": sized_jpeg(65_000, 65_000),
        "gif": b"GIF89a" + b"\xff" * 99,
        "scans": scanned_jpeg(4096, 4096),
    }
    for name, data in images.items():
        place = folder / f"euroc_{name}"
        root = write_euroc(place, walk) / "mav0"
        for file in (root / "cam0" / "data").iterdir():
            file.write_bytes(data)
        yield root.parent
        place = folder / f"tum_{name}"
        place.mkdir()
        tum = write_tum(place, walk)
        for file in [*(tum / "rgb").iterdir(), *(tum / "depth").iterdir()]:
            file.write_bytes(data)
        yield tum
    place = folder / "euroc_rows"
    root = write_euroc(place, walk) / "mav0"
    sparse(root / "imu0" / "data.csv", (root / "imu0" / "data.csv").read_bytes(), 100 * GIB)
    yield root.parent
    place = folder / "euroc_line"
    root = write_euroc(place, walk) / "mav0"
    sparse(root / "cam0" / "data.csv", b"#timestamp [ns],filename\n1,", 250 * MIB)
    yield root.parent


def hostile(folder: Path):
    """Every hostile file, by name."""
    walk = Walk()
    made = []
    for kind, files in (("mcap", mcaps), ("bags1", ros1)):
        (folder / kind).mkdir()
        made += files(folder / kind)
    for kind, files in (("tables", tables), ("bags2", ros2), ("folders", folders)):
        (folder / kind).mkdir()
        made += files(folder / kind, walk)
    return {str(p.relative_to(folder)): p for p in made}


if __name__ == "__main__":
    import sys

    print(json.dumps({k: str(v) for k, v in hostile(Path(sys.argv[1])).items()}))
