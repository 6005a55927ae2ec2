"""Inputs of the fuzzer, and their changes: small folders of files, of which one file or name is changed at a time.

An input is packed as one line of JSON with the names and sizes of its files, and their bytes after it. Text is changed
by rows, cells and words, MCAP files and bags by records and messages, so that most changes get past the container.
"""

from __future__ import annotations

import contextlib
import io
import json
import random
import sqlite3
import struct
import tempfile
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag1 import Writer as Ros1Writer

from stridetwin.streams.recording.mcap_writer import MAGIC

Members = dict[str, bytes]
"""The files of an input by their paths in its folder; names that begin with `--` are options of the command line."""
ChangeBytes = Callable[[bytes], bytes]
"""Changes bytes without knowledge of what they mean, such as `atheris.Mutate`."""
MOST_BYTES = 1 << 18
"""Largest input, bytes: four times the largest seed."""
_MOST_MEMBERS = 60
"""Most files of an input to which another one is added."""
_CHUNK, _MESSAGE, _DATA_END, _FOOTER = 6, 5, 15, 2
"""Opcodes of MCAP records (https://mcap.dev/spec#records)."""
_INDEXES = (7, 8, 10, 11, 13, 14)
"""Opcodes of MCAP records that repeat what others say."""
VALUES = (
    *("nan", "inf", "-inf", "-1", "0", "-0", "1e999", "1e308", "1e-320", "9" * 30, "9" * 5000, "1e5000000000"),
    *("", " ", "\0", "\n", '"', "'", ",", ";", "\t", "#", "%", "²", "٣", "−1", "1,5", "1_000", "0x10", "1e", ".", "½"),
    *("2147483648", "9223372036854775807", "9223372036854775808", "18446744073709551616", "-9223372036854775809"),
    *("null", "~", "true", ".inf", ".nan", "[]", "{}", "[1]", "{a: 1}", "[[1, 2], [3]]", "!!binary x", "&a [*a]", "*a"),
    *(
        "2020-01-01",
        "2020-01-01 00:00:00",
        "12:00:61",
        "0000-00-00T99:99:99Z",
        "é",
        "\ufeff",
        "\u2028",
        "\x85",
        "\x1b[2J",
    ),
)
"""Cells and words that readers may not expect."""


def pack(members: Members) -> bytes:
    """An input as bytes."""
    head = json.dumps({name: len(data) for name, data in members.items()})
    return head.encode() + b"\n" + b"".join(members.values())


def unpack(data: bytes) -> Members | None:
    """The files of an input; None for bytes that are no input."""
    head, _, body = data.partition(b"\n")
    try:
        sizes = json.loads(head)
        names = [name for name in dict(sizes) if is_safe_name(name)]
        if not names or len(names) != len(sizes) or sum(sizes.values()) != len(body):
            return None
    except (ValueError, TypeError, RecursionError):
        return None
    members, start = {}, 0
    for name in names:
        members[name] = body[start : start + sizes[name]]
        start += sizes[name]
    return members


def is_safe_name(name: str) -> bool:
    """Whether a name is a relative path that stays in its folder and that a file system takes."""
    parts = name.split("/")
    return all(part not in ("", ".", "..") and "\0" not in part and len(part.encode()) < 200 for part in parts)


def write_members(folder: Path, members: Members) -> Path:
    """Writes the files of an input to an empty folder; files that others' names leave no place for are left out.

    Returns:
        What a user opens: the file if it is the only one, else the folder.
    """
    files = {name: data for name, data in members.items() if not name.startswith("--")}
    for name, data in files.items():
        with contextlib.suppress(OSError):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(data)
    return folder / next(iter(files)) if len(files) == 1 and "/" not in next(iter(files)) else folder


def read_members(source: Path) -> Members:
    """The files of a source, a file or a folder, as an input."""
    if source.is_file():
        return {source.name: source.read_bytes()}
    return {str(file.relative_to(source)): file.read_bytes() for file in sorted(source.rglob("*")) if file.is_file()}


def mutate(members: Members, rng: random.Random, vocabulary: Sequence[str], change_bytes: ChangeBytes) -> Members:
    """An input with one to three changes: of a file's contents, sometimes of a name or of the set of files.

    Args:
        members: The input, which is not changed.
        rng: Draws the changes.
        vocabulary: Keys and words of headers.
        change_bytes: Changes bytes of unknown meaning.
    """
    changed = dict(members)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        name = rng.choice(list(changed))
        draw = rng.random()
        if draw < 0.85 or len(changed) == 1 == len(members):
            changed[name] = _mutate_contents(name, changed[name], rng, vocabulary, change_bytes)
        elif draw < 0.90:
            new = _mutate_name(name, rng, vocabulary)
            if is_safe_name(new):
                changed = {new if n == name else n: data for n, data in changed.items()}
        elif draw < 0.94 and len(changed) > 1:
            del changed[name]
        elif draw < 0.97 and len(changed) < _MOST_MEMBERS:
            stem, dot, suffix = name.rpartition(".")
            changed[f"{stem}_2{dot}{suffix}" if dot else f"{name}_2"] = changed[name]
        else:
            changed[name] = changed[rng.choice(list(changed))]
    return changed if sum(map(len, changed.values())) <= MOST_BYTES else dict(members)


def cross(first: Members, second: Members, rng: random.Random) -> Members:
    """The first input with one file of the second in place of one of its own, or with some lines of that file."""
    name = rng.choice(list(first))
    donor = second.get(name) or rng.choice(list(second.values()))
    if rng.random() < 0.3:
        return {**first, name: donor}
    lines, donated = first[name].split(b"\n"), donor.split(b"\n")
    at, start = rng.randrange(len(lines) + 1), rng.randrange(len(donated))
    count = rng.choice((1, 1, 2, 5, 20))
    return {**first, name: b"\n".join([*lines[:at], *donated[start : start + count], *lines[at:]])[:MOST_BYTES]}


def _mutate_name(name: str, rng: random.Random, vocabulary: Sequence[str]) -> str:
    """Another path of a file: with another ending, case, number or word."""
    parent, slash, base = name.rpartition("/")
    stem, _, suffix = base.rpartition(".")
    endings = ("csv", "txt", "tsv", "sto", "dat", "npz", "yaml", "json", "png", "jpg", "mcap", "bag", "db3", "CSV", "")
    choices = [
        f"{stem}.{rng.choice(endings)}",
        base.upper(),
        f"{rng.choice(vocabulary).replace('/', '_')}.{suffix}",
        f"{stem}{rng.choice(VALUES).replace('/', '_')}.{suffix}",
        base.replace("0", str(rng.randrange(100)), 1),
        f"{base}/{base}",
    ]
    return parent + slash + rng.choice(choices)


def _mutate_contents(
    name: str, data: bytes, rng: random.Random, vocabulary: Sequence[str], change_bytes: ChangeBytes
) -> bytes:
    """A file's contents with one change that fits its kind; one in ten changes of any kind is of plain bytes.

    Args:
        name: Name of the file, whose ending tells its kind.
        data: Its contents.
        rng: Draws the change.
        vocabulary: Keys and words of headers.
        change_bytes: Changes bytes of unknown meaning.
    """
    suffix = name.rpartition(".")[2].lower()
    by_suffix: dict[str, Callable[[bytes, random.Random, ChangeBytes], bytes]] = {
        "mcap": _mutate_mcap,
        "bag": _mutate_rosbag1,
        "db3": _mutate_database,
        "npz": _mutate_arrays,
        "png": _mutate_image,
    }
    if rng.random() < 0.1:
        return change_bytes(data)
    try:
        if suffix in by_suffix:
            return by_suffix[suffix](data, rng, change_bytes)
        text = data.decode()
    except Exception:  # damaged by an earlier change
        return change_bytes(data)
    return _mutate_text(text, rng, vocabulary).encode("utf-8", "surrogatepass")


def _mutate_text(text: str, rng: random.Random, vocabulary: Sequence[str]) -> str:
    """Text with one change of a line, a cell, a column, or of all lines."""
    lines = text.split("\n")
    at = rng.randrange(min(len(lines), 12) if rng.random() < 0.5 else len(lines))  # heads are short
    separator = next((mark for mark in (",", ";", "\t", ": ", " ") if mark in lines[at]), ",")
    cells = lines[at].split(separator)
    cell = rng.randrange(len(cells))
    word = rng.choice(vocabulary) if rng.random() < 0.5 else rng.choice(VALUES)
    draw = rng.randrange(16)
    if draw < 5:
        cells[cell] = rng.choice((word, cells[cell] + word, f" {word}", f"{word}: {cells[cell]}", f'"{word}"'))
        lines[at] = separator.join(cells)
    elif draw == 5:
        del lines[at : at + rng.choice((1, 1, 2, 10, 1000))]
    elif draw == 6:
        lines[at:at] = lines[at : at + rng.choice((1, 1, 3, 30))]
    elif draw == 7:
        to = rng.randrange(len(lines))
        lines[at], lines[to] = lines[to], lines[at]
    elif draw == 8:
        lines.insert(
            at, rng.choice((word, f"{word}: {rng.choice(VALUES)}", f"# {word}", separator.join([word] * len(cells))))
        )
    elif draw == 9:
        lines[at] = rng.choice((" " * rng.randrange(9), "- ", "#", "%", "//", '"')) + lines[at].lstrip()
    elif draw == 10:
        _change_column(lines, separator, cell, rng, word)
    elif draw == 11:
        mark = rng.choice((",", ";", "\t", " ", "|", "  ", "\0"))
        lines = [line.replace(separator, mark) for line in lines]
    elif draw == 12:
        lines[at] = lines[at][: rng.randrange(len(lines[at]) + 1)] + lines[rng.randrange(len(lines))]
    elif draw == 13:
        digits = [i for i, mark in enumerate(lines[at]) if mark.isdigit()]
        if digits:
            i = rng.choice(digits)
            lines[at] = (
                lines[at][:i] + rng.choice(("0", "9", "-", ".", "e", "e9", "e-9", "e99", "")) + lines[at][i + 1 :]
            )
    elif draw == 14:
        lines = [rng.choice(("\n", "\r", "\r\n", "\n\n")).join(lines)]
    else:
        lines = lines[: at + 1]
    return "\n".join(lines)


def _change_column(lines: list[str], separator: str, column: int, rng: random.Random, word: str) -> None:
    """Drops, doubles, fills or scales one cell of every line, in place.

    Args:
        lines: The lines.
        separator: Between their cells.
        column: Index of the cell.
        rng: Draws the change.
        word: With which the cells are filled.
    """
    way, factor = rng.randrange(4), rng.choice((0.0, -1.0, 1e-9, 1e3, 1e9, 1e300))
    for i, line in enumerate(lines):
        cells = line.split(separator)
        if column >= len(cells):
            continue
        if way == 0:
            del cells[column]
        elif way == 1:
            cells.insert(column, cells[column])
        elif way == 2:
            cells[column] = word
        else:
            with contextlib.suppress(ValueError):
                cells[column] = repr(float(cells[column]) * factor)
        lines[i] = separator.join(cells)


def _overwrite(data: bytes, rng: random.Random) -> bytes:
    """Bytes of the same length with one number of 1 to 8 bytes changed."""
    if not data:
        return data
    form = rng.choice(("<B", "<H", "<I", "<Q", "<f", "<d"))
    size = struct.calcsize(form)
    at = rng.randrange(len(data)) if rng.random() < 0.5 else rng.randrange(min(len(data), 64))
    if form in ("<f", "<d"):
        number = struct.pack(form, rng.choice((0.0, -1.0, float("nan"), float("inf"), 1e30, -1e-30)))
    else:
        most = (1 << 8 * size) - 1
        number = struct.pack(form, rng.choice((0, 1, 2, most, most >> 1, (most >> 1) + 1, rng.randrange(most + 1))))
    return (data[:at] + number + data[at + size :])[: len(data)]


def _split_records(data: bytes) -> list[tuple[int, bytes]]:
    """(opcode, content) of MCAP records that follow each other.

    Raises:
        struct.error: A record is cut off.
    """
    records, at = [], 0
    while at < len(data):
        opcode, size = struct.unpack_from("<BQ", data, at)
        records.append((opcode, data[at + 9 : at + 9 + size]))
        at += 9 + size
    return records


def _join_records(records: Sequence[tuple[int, bytes]]) -> bytes:
    """MCAP records as bytes."""
    return b"".join(struct.pack("<BQ", opcode, len(content)) + content for opcode, content in records)


def _mutate_mcap(data: bytes, rng: random.Random, change_bytes: ChangeBytes) -> bytes:
    """An MCAP file with one changed record, also inside a chunk, whose CRC is mended.

    If the lengths change, records of indexes are left out half of the time, as they would be wrong.
    """
    records = _split_records(data[len(MAGIC) : -len(MAGIC)])
    at = rng.choice([i for i, (opcode, _) in enumerate(records) if opcode == _CHUNK] or range(len(records)))
    if rng.random() < 0.3:
        at = rng.randrange(len(records))
    opcode, content = records[at]
    if opcode == _CHUNK and rng.random() < 0.9:
        content = _mutate_chunk(content, rng, change_bytes)
    else:
        content = _overwrite(content, rng) if rng.random() < 0.6 else change_bytes(content)
    has_shifted = len(content) != len(records[at][1])
    records[at] = opcode, content
    if rng.random() < 0.05:
        records.insert(rng.randrange(len(records)), rng.choice(records))
        has_shifted = True
    if has_shifted and rng.random() < 0.8:
        records = [record for record in records if record[0] not in _INDEXES]
        ends = {_FOOTER: bytes(20), _DATA_END: bytes(4)}
        records = [(opcode, ends.get(opcode, content)) for opcode, content in records]
    return MAGIC + _join_records(records) + MAGIC


def _mutate_chunk(content: bytes, rng: random.Random, change_bytes: ChangeBytes) -> bytes:
    """The content of a chunk record, unpacked, with one changed record inside and a right CRC."""
    start, end, _, _, length = struct.unpack_from("<QQQII", content)
    packing, at = content[32 : 32 + length], 32 + length + 8
    inner = content[at:]
    if packing == b"lz4":
        inner = lz4.frame.decompress(inner)
    elif packing == b"zstd":
        inner = zstandard.ZstdDecompressor().decompress(inner, max_output_size=1 << 24)
    records = _split_records(inner)
    i = rng.randrange(len(records))
    opcode, body = records[i]
    if opcode == _MESSAGE and rng.random() < 0.8:
        payload = _overwrite(body[22:], rng) if rng.random() < 0.7 else change_bytes(body[22:])
        body = body[:22] + payload
    else:
        body = _overwrite(body, rng) if rng.random() < 0.6 else change_bytes(body)
    records[i] = opcode, body
    if rng.random() < 0.1:
        records[i : i + 1] = rng.choice(([], [(opcode, body)] * 2, records[i : i + 2][::-1]))
    inner = _join_records(records)
    head = struct.pack("<QQQII", start, end, len(inner), zlib.crc32(inner), 0)
    return head + struct.pack("<Q", len(inner)) + inner


def _mutate_rosbag1(data: bytes, rng: random.Random, change_bytes: ChangeBytes) -> bytes:
    """A ROS 1 bag with one changed message, type or topic, written anew; or with changed bytes."""
    if rng.random() < 0.3:
        return _overwrite(data, rng)
    with tempfile.TemporaryDirectory() as folder:
        old, new = Path(folder) / "old.bag", Path(folder) / "new.bag"
        old.write_bytes(data)
        with Ros1Reader(old) as reader:
            links = {c.id: [c.topic, c.msgtype, c.msgdef.data, c.digest] for c in reader.connections}
            messages = [(c.id, t, bytes(raw)) for c, t, raw in reader.messages()]
        if rng.random() < 0.75 and messages:
            i = rng.randrange(len(messages))
            link, t, raw = messages[i]
            messages[i] = link, t, _overwrite(raw, rng) if rng.random() < 0.7 else change_bytes(raw)
        else:
            fields = rng.choice(list(links.values()))
            i = rng.randrange(3)
            fields[i] = change_bytes(str(fields[i]).encode()).decode("utf-8", "replace") or "x"
        with Ros1Writer(new) as writer:
            ends = {
                link: writer.add_connection(topic, name, msgdef=text, md5sum=str(digest))
                for link, (topic, name, text, digest) in links.items()
            }
            for link, t, raw in messages:
                writer.write(ends[link], t, raw)
        return new.read_bytes()


def _mutate_database(data: bytes, rng: random.Random, change_bytes: ChangeBytes) -> bytes:
    """A `.db3` of ROS 2 with one changed message, stamp or entry of a topic; or with changed bytes."""
    if rng.random() < 0.25:
        return _overwrite(data, rng)
    with tempfile.NamedTemporaryFile(suffix=".db3") as file:
        Path(file.name).write_bytes(data)
        with contextlib.closing(sqlite3.connect(file.name)) as database:
            draw = rng.random()
            if draw < 0.6:
                rows = database.execute("SELECT id, data FROM messages").fetchall()
                key, raw = rng.choice(rows)
                raw = _overwrite(raw, rng) if rng.random() < 0.7 else change_bytes(raw)
                database.execute("UPDATE messages SET data = ? WHERE id = ?", (raw, key))
            elif draw < 0.8:
                value = rng.choice((0, -1, 1, 2**63 - 1, "text", 0.5, None, b"\xff"))
                column = rng.choice(("timestamp", "topic_id", "data"))
                keys = [key for (key,) in database.execute("SELECT id FROM messages")]
                database.execute(f"UPDATE OR IGNORE messages SET {column} = ? WHERE id = ?", (value, rng.choice(keys)))
            else:
                column = rng.choice(("name", "type", "serialization_format", "offered_qos_profiles"))
                value = rng.choice(
                    (*VALUES, "sensor_msgs/msg/Image", "sensor_msgs/msg/Imu", "std_msgs/msg/String", None)
                )
                keys = [key for (key,) in database.execute("SELECT id FROM topics")]
                database.execute(f"UPDATE OR IGNORE topics SET {column} = ? WHERE id = ?", (value, rng.choice(keys)))
            database.commit()
        return Path(file.name).read_bytes()


def _mutate_arrays(data: bytes, rng: random.Random, _: ChangeBytes) -> bytes:
    """An npz file with one array of another name, shape, type or value."""
    with np.load(io.BytesIO(data)) as table:
        arrays = dict(table)
    name = rng.choice(list(arrays))
    array = arrays.pop(name)
    value = rng.choice((np.nan, np.inf, -1.0, 0.0, 1e30, 1e308))
    ways: list[Callable[[], np.ndarray]] = [
        lambda: array[: rng.randrange(len(array) + 1)],
        lambda: array.T,
        lambda: array[::-1],
        lambda: np.array(value),
        lambda: array[..., None],
        lambda: array.astype(
            rng.choice(("f2", "f4", "i1", "u1", "i8", "c16", "U8", "S8", "?", "M8[ns]", "m8[s]", ">f8"))
        ),
        lambda: np.where(np.arange(array.size).reshape(array.shape) == rng.randrange(max(array.size, 1)), value, array),
        lambda: array * value,
        lambda: array.ravel(),
        lambda: np.empty((0, 3)),
    ]
    arrays[rng.choice((name, name, name, name, "", "t", "accel", "gyro", "/a", name + "_2"))] = rng.choice(ways)()
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def _mutate_image(data: bytes, rng: random.Random, _: ChangeBytes) -> bytes:
    """Another image file in place of one: other size, channels, bit depth or coding, or a header that lies."""
    if rng.random() < 0.3 and len(data) > 33:
        head = _overwrite(data[16:29], rng)  # width, height, bit depth, colour type, ...
        return data[:16] + head + struct.pack(">I", zlib.crc32(data[12:16] + head)) + data[33:]
    size = rng.choice(((1, 1), (2, 3), (24, 32), (32, 24), (1, 300)))
    shape = rng.choice((size, (*size, 3), (*size, 4)))
    kind = rng.choice((np.uint8, np.uint16))
    pixels = np.full(shape, rng.choice((0, 1, 255, 65535)) % (np.iinfo(kind).max + 1), kind)
    return cv2.imencode(rng.choice((".png", ".png", ".jpg", ".pgm", ".tiff")), pixels.astype(kind))[1].tobytes()
