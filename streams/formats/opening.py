"""Opens any source as a recording: detects its kind by content, and maps its streams to our topics."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from stridetwin.streams.depth_planes import choose_views, find_implausible_views
from stridetwin.streams.errors import ConfigError, RecordingError, StrideTwinError, read_error
from stridetwin.streams.formats import euroc, iphone, openloris, seven_scenes, tum_rgbd
from stridetwin.streams.formats.aria_vrs import read_aria_vrs
from stridetwin.streams.formats.assumed_calibration import read_first_image_size, with_assumed_calibration
from stridetwin.streams.formats.bag import read_bag
from stridetwin.streams.formats.bag_files import BagInParts, McapBag, RosBag, check_tables, sqlite_is_sound
from stridetwin.streams.formats.file_formats import FILE_FORMATS
from stridetwin.streams.formats.given_rig import Streams, match_rig, rename_rig, report_unmatched, streams_of
from stridetwin.streams.formats.imu_bridging import bridge_gaps
from stridetwin.streams.formats.imu_columns import NUMBERED, OPTION
from stridetwin.streams.formats.imu_folder import is_imu_folder
from stridetwin.streams.formats.imu_table import read_imu_tables
from stridetwin.streams.formats.imu_text import OPEN_SUFFIXES, TableRequest, has_table_suffix, is_imu_text
from stridetwin.streams.formats.imu_unmeasured import leave_out_unmeasured
from stridetwin.streams.formats.unknown_folder import (
    MOST_LISTED,
    VIDEO,
    VIDEO_SUFFIXES,
    describe_parent,
    describe_unknown,
)
from stridetwin.streams.kalibr import read_rig
from stridetwin.streams.notices import warn
from stridetwin.streams.plausible import DEPTH_UNITS, IMAGE_RATES_HZ, find_implausible_rates, find_implausible_values
from stridetwin.streams.recording.imported import IMPORTED_FROM, ImageStream, ImportedContents, Source
from stridetwin.streams.recording.index import Notes, Problem, is_stridetwin_recording, read_calibration
from stridetwin.streams.recording.mcap_writer import MAGIC
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.recording.recording_schema import RIG_NAME
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import (
    QUATERNION_NORM_ERROR,
    Accelerometer,
    Array,
    Block,
    Depth,
    Footprint,
    Image,
    Imu,
    Odometry,
    Point,
    Sample,
    is_increasing,
)
from stridetwin.streams.segments import segment_of, side_of
from stridetwin.streams.yaml_file import read_yaml

TABLE_TOPIC = "/foot_l/imu"
"""Topic of the only IMU of a table."""
_BAGS = ("mcap", "rosbag1", "rosbag2")
"""Formats whose streams have topics of their own."""
_REGISTERED_KINDS = ("tum", "7scenes")
"""Formats whose layout says that depth is registered to colour."""
_REGISTERED = re.compile(r"aligned|registered")
"""What drivers' names of registered depth images contain, as `/camera/aligned_depth_to_color/image_raw`."""
_HEADS = {MAGIC[:5]: "mcap", b"#ROSBAG": "rosbag1", b"SQLite format 3\0": "rosbag2"}
"""First bytes of a file of each kind."""
_PACKINGS = {b"PK\3\4": "zip", b"\x28\xb5\x2f\xfd": "zstd", b"\x1f\x8b": "gzip", b"BZh": "bzip2", b"7z\xbc\xaf": "7z"}
"""First bytes of files of packed content."""
_TABLES = "table"
"""Kind of the tables of an IMU, and of folders of them."""
_LAYOUTS: Mapping[str, Callable[[Path], bool]] = {
    "euroc": lambda path: euroc.find_euroc_root(path) is not None,
    "openloris": openloris.is_openloris,  # before TUM's, as it may have a depth.txt, too
    "tum": tum_rgbd.is_tum_rgbd,
    "7scenes": lambda path: seven_scenes.find_frames_folder(path) is not None,
    "strayscanner": iphone.is_stray_scanner,
    "record3d": iphone.is_record3d,
    _TABLES: is_imu_folder,
}
"""Whether a folder has the layout of each kind."""
_AS_CSV = "export the table as CSV, in UTF-8, with the names and units of its columns"
"""What to do with a table of another program."""
_UNREAD: Mapping[str, str] = {
    **dict.fromkeys((".xls", ".xlsx", ".ods", ".mat", ".json", ".parquet", ".h5", ".hdf5", ".feather"), _AS_CSV),
    **dict.fromkeys(VIDEO_SUFFIXES, VIDEO),
    **dict.fromkeys((".zip", ".gz", ".7z", ".rar", ".tar", ".tgz", ".zst"), "unpack it first"),
}
"""What to do about files of other kinds that may have a table."""
_READERS: Mapping[str, Callable[..., Source]] = {
    "euroc": euroc.read_euroc,
    "openloris": openloris.read_openloris,
    "tum": tum_rgbd.read_tum_rgbd,
    "7scenes": seven_scenes.read_seven_scenes,
    "strayscanner": iphone.read_stray_scanner,
    "record3d": iphone.read_record3d,
    "vrs": read_aria_vrs,
}
"""The reader of each kind that is neither a bag nor a table."""
_DEPTH_SCALES: Mapping[str, float] = {
    "tum": tum_rgbd.PER_METRE,
    "7scenes": seven_scenes.PER_METRE,
    "openloris": openloris.PER_METRE,
    "strayscanner": iphone.PER_METRE,
}
"""Usual units of depth images per metre, of the formats whose reader takes another number of them."""
_EVENTS = (Footprint, Point)  # irregular events
_PART_SUFFIXES = (".txt", ".csv", ".yaml", ".png", ".jpg")
"""Endings of files that are a part of a folder with a recording."""
_IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".exr", ".tif", ".tiff", ".pgm")
"""Endings of files of images, in lower case."""
_METADATA = "metadata.yaml"
"""File that describes a ROS 2 bag."""
_REINDEX = "`ros2 bag reindex` writes it anew; without it, the files are read in the order of their names"
"""What to do about invalid metadata."""
_SHORT = 0.05
"""Share of the longest stream that may be missing from another one without a warning."""
_FEWEST = 10
"""Samples that are needed to check a rate or a unit."""


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """Options for reading a foreign source.

    Attributes:
        kind: One of `FILE_FORMATS`; None detects it from the content.
        names: Topic of a stream, by its name in the source or its default topic.
        rig: Kalibr YAML whose calibrations replace those of the source.
        depth_scale: Units of depth images per metre; None for those of the layout or of the messages' encoding.
        table: What the header of a table leaves open.
    """

    kind: str | None = None
    names: Mapping[str, str] = field(default_factory=dict)
    rig: Path | None = None
    depth_scale: float | None = None
    table: TableRequest = field(default_factory=TableRequest)


def recognise(path: Path) -> str:
    """Detects the kind of a source from its content, or of a folder from its layout.

    Returns:
        One of `FILE_FORMATS`.

    Raises:
        StrideTwinError: The source does not exist or is not one of `FILE_FORMATS`.
    """
    try:
        if path.is_dir():
            return _recognise_folder(path)
        with path.open("rb") as file:
            head = file.read(16)
    except OSError as error:
        raise read_error(path, error) from error
    if not head:
        raise StrideTwinError(f"{path}: the file is empty")
    for first_bytes, kind in _HEADS.items():
        if head.startswith(first_bytes):
            return kind
    if path.suffix == ".vrs":
        return "vrs"
    suffix = path.suffix.lower()
    if suffix == ".npz" or (has_table_suffix(path) and (suffix not in OPEN_SUFFIXES or is_imu_text(path))):
        return _TABLES
    if path.suffix.lower() in _UNREAD:
        raise StrideTwinError(f"{path}: {path.suffix} files are not read: {_UNREAD[path.suffix.lower()]}")
    packing = next((name for first_bytes, name in _PACKINGS.items() if head.startswith(first_bytes)), None)
    if packing is not None:
        raise ConfigError(path, "", f"{packing} content", "a recording, or a folder of one: unpack it first")
    by_name = {".mcap": "MCAP file", ".bag": "ROS 1 bag", ".db3": "SQLite file"}
    if path.suffix in by_name:
        raise RecordingError(f"{path}: this is no {by_name[path.suffix]}")
    kinds = ", ".join(FILE_FORMATS)
    numbered = f"; a text table of an IMU needs names of its columns, or their numbers: {OPTION} {NUMBERED}"
    hint = numbered if suffix in OPEN_SUFFIXES else ""
    if path.suffix in _PART_SUFFIXES and (above := describe_parent(path, _find_layout_of_images)) is not None:
        hint = f"; {above}"
    raise StrideTwinError(f"{path}: unknown content: expected a recording of one of the kinds {kinds}{hint}")


def is_table(path: Path, request: TableRequest) -> bool:
    """Whether a source is a table of an IMU: by its content, or a text table whose columns the user names.

    Raises:
        StrideTwinError: The source does not exist or is of no known kind.
    """
    if request.columns and (path.is_file() or _has_tables(path)):
        return True
    return recognise(path) == _TABLES


def _has_tables(path: Path) -> bool:
    """Whether a path is a folder of text tables that has the layout of no other kind."""
    if not path.is_dir() or _find_layout(path) not in (None, _TABLES):
        return False
    return any(map(has_table_suffix, path.iterdir()))


def open_any(path: str | Path, lenient: bool = False, options: ImportOptions | None = None) -> Recording:
    """Opens a recording, or another tool's file or folder as one.

    Args:
        path: Recording, bag, dataset folder or IMU table.
        lenient: Read everything that is readable; problems are listed in `problems`.
        options: Options for a foreign source.

    Returns:
        The recording; assumptions are listed in its `warnings`.

    Raises:
        StrideTwinError: The source cannot be read or (unless lenient) would corrupt an estimate; names file,
            field, value and what is valid.
    """
    path, options = Path(path), options or ImportOptions()
    if options.kind is not None and options.kind not in FILE_FORMATS:
        raise ConfigError("import", "--as", options.kind, ", ".join(FILE_FORMATS))
    kind = options.kind or (_TABLES if is_table(path, options.table) else recognise(path))
    is_plain = not options.names and options.rig is None  # the user changes neither topics nor calibration
    # the file of a recording that StrideTwin has written; None for another tool's source
    may_be_ours = kind == "mcap" or (kind == "rosbag2" and (path.is_dir() or path.suffix == ".mcap"))
    own_file = _find_stridetwin_file(path, is_plain) if may_be_ours else None
    if own_file is not None and is_plain:
        return Recording(own_file, lenient)
    notes = Notes(path, lenient)
    metadata = {IMPORTED_FROM: kind, "source": path.name}
    per_metre = _units_per_metre(kind, options)
    if per_metre is not None:
        metadata[DEPTH_UNITS] = f"{per_metre:g}"
    try:
        if own_file is not None:
            # first, because recordings of newer releases are rejected
            rig, metadata = read_calibration(own_file, notes)
        source = _read_source(path, kind, options, notes)
    except OSError as error:
        raise read_error(Path(error.filename or path), error) from error
    if own_file is not None:  # its own calibration and topics, not those that are derived from messages
        source = replace(source, rig=rig, names={}, assumed={})
    topics = _assign_topics(source, options.names)  # our topic, by the source's name
    streams = streams_of(source, topics, numbered=kind not in _BAGS)  # by which calibrations find their streams
    registered = _find_registered(source, topics)  # our topics of depth that is registered to colour
    source = _rename_topics(source, topics, bodies_are_known=own_file is not None)
    if own_file is None:
        source = _clean_streams(source, notes)
    better = _read_better_rig(path, source, options, streams, notes)  # calibrations from files
    rig = with_assumed_calibration(_merge_rigs(source.rig, better), source.blocks, source.images, notes, registered)
    for topic, text in source.assumed.items():
        if topic in rig.cameras and topic not in better.cameras:  # no better calibration replaces the assumed one
            notes.warn(f"{topic}: {text}")
    if own_file is None:  # units and clocks of our own recordings are not in doubt
        _check_plausible(source, notes)
        _check_depth(source, rig, per_metre, notes)
    contents = ImportedContents(source.blocks, source.images, rig, metadata, source.unread, notes)
    if own_file is None:
        _check_overlap(contents, notes)
    return Recording(path, lenient, contents)


def open_with_warnings(
    path: Path, lenient: bool, options: ImportOptions | None = None, *, reports: bool = True
) -> Recording:
    """Opens any source as a recording, and prints a warning on stderr for each assumption and problem.

    Args:
        path: Recording, bag, dataset folder or IMU table.
        lenient: Read everything that is readable; problems become warnings.
        options: Options for a foreign source.
        reports: Whether the warnings are printed.

    Raises:
        StrideTwinError: The source cannot be read or (unless lenient) would corrupt an estimate.
    """
    recording = open_any(path, lenient, options)
    if reports:
        print_warnings(path, [*recording.warnings, *map(str, recording.problems)])
    return recording


def print_warnings(source: Path | str, warnings: Iterable[str]) -> None:
    """Prints warnings about a source on stderr."""
    for warning in warnings:
        warn(f"{source}: {warning}")


def _recognise_folder(path: Path) -> str:
    """The kind of a folder by its layout.

    Raises:
        StrideTwinError: The folder has none of the known layouts; the message says what it has.
    """
    if (kind := _find_layout(path)) is not None:
        return kind
    kinds = ", ".join(known for known in FILE_FORMATS[2:] if known != "vrs")  # without those of single files
    what = describe_parent(path, _find_layout_of_images) or describe_unknown(path, _find_layout)
    raise StrideTwinError(f"{path}: unknown layout: expected a folder of one of the kinds {kinds}; {what}")


def _find_layout(path: Path) -> str | None:
    """The kind whose layout a folder has: a ROS 2 bag first, then the order of `_LAYOUTS`; None for another layout."""
    if (path / _METADATA).is_file() or any(path.glob("*.mcap")) or any(path.glob("*.db3")):
        return "rosbag2"
    return next((kind for kind, has_layout in _LAYOUTS.items() if has_layout(path)), None)


def _find_layout_of_images(path: Path) -> str | None:
    """The kind whose layout with images a folder has; None for others. No file is read, however large the folder."""
    return next((kind for kind, has_layout in _LAYOUTS.items() if kind != _TABLES and has_layout(path)), None)


def imu_topic(name: str) -> str:
    """Our topic of a sensor of a table.

    Args:
        name: The table's name of the sensor, such as `left_sensor`, `RightFoot` or `pelvis`.

    Returns:
        That of a foot if the name has a side and tells no other part of the body; else a topic of its own name.
    """
    side, segment = side_of(name.lower()), segment_of(name)
    if segment in ("foot_l", "foot_r"):
        return f"/{segment}/imu"
    if side and not segment:
        return f"/foot_{side}/imu"
    topic = re.sub(r"[^A-Za-z0-9_]+", "_", name).strip("_")
    return f"/imu_{topic}/imu" if topic[:1].isdigit() else f"/{topic}/imu"


def _read_source(path: Path, kind: str, options: ImportOptions, notes: Notes) -> Source:
    """Reads a source of a known kind with the reader of that kind; topics are still the source's own.

    Args:
        path: File or folder.
        kind: One of `FILE_FORMATS`.
        options: What the user gives, of which the table's header and the scale of depth matter here.
        notes: Collects problems and assumptions.
    """
    if kind == _TABLES:
        _report_images(path, notes)
        if (above := describe_parent(path, _find_layout_of_images)) is not None:
            notes.warn(f"read as an IMU table alone: {above} for the whole recording")
        imus = read_imu_tables(path, options.table, notes)
        names = {name: imu_topic(name) for name in imus if name}
        only = "/foot_r/imu" if segment_of(path.stem) == "foot_r" else TABLE_TOPIC
        blocks: dict[str, Block[Sample]] = {name or only: block for name, block in imus.items()}
        return Source(kind=kind, blocks=blocks, images={}, rig=Rig(), names=names)
    if kind in _READERS:
        per_metre = _units_per_metre(kind, options)
        return _READERS[kind](path, notes, **({} if per_metre is None else {"per_metre": per_metre}))
    return _read_bag(path, kind, notes, options.depth_scale)


def _units_per_metre(kind: str, options: ImportOptions) -> float | None:
    """Units of depth images per metre; None for formats whose depth has a unit of its own, as messages of bags have."""
    if kind in _DEPTH_SCALES:
        return options.depth_scale or _DEPTH_SCALES[kind]
    return None if kind in _READERS else options.depth_scale


def _report_images(path: Path, notes: Notes) -> None:
    """Warns if a folder that is read as IMU tables has images, whose layout is none that is read."""
    entries = sorted(path.iterdir()) if path.is_dir() else []
    with_images = [f"{entry.name}/" for entry in entries if entry.is_dir() and _has_images(entry)]
    with_images += [entry.name for entry in entries if entry.suffix.lower() in VIDEO_SUFFIXES]
    if with_images:
        names = ", ".join(with_images[:MOST_LISTED])
        notes.warn(f"read as IMU tables alone: the images in {names} have no layout that is read")


def _has_images(folder: Path) -> bool:
    """Whether a folder has files of images; false for one that cannot be listed."""
    try:
        return any(file.suffix.lower() in _IMAGE_SUFFIXES for file in folder.iterdir())
    except OSError:
        return False


def _find_stridetwin_file(path: Path, is_plain: bool) -> Path | None:
    """The path of our own MCAP file, which may be in a folder; None for anything else.

    Args:
        path: File or folder.
        is_plain: Whether neither topics nor a rig are given. Then a damaged MCAP file counts as ours, too, because
            `Recording` gives the best error message.
    """
    files = _list_bag_files(path) if path.is_dir() else [path]
    if len(files) != 1 or files[0].suffix == ".db3":  # ours are single files, and no SQLite
        return None
    return files[0] if is_stridetwin_recording(files[0], if_damaged=is_plain) else None


def _read_bag(path: Path, kind: str, notes: Notes, per_metre: float | None) -> Source:
    """Reads an MCAP file, a ROS 1 bag, or a ROS 2 bag of MCAP or SQLite files, whose tables are checked first.

    Args:
        path: File or folder.
        kind: `mcap`, `rosbag1` or `rosbag2`.
        notes: Collects problems and assumptions.
        per_metre: Units of depth images per metre; None for those of the messages.

    Raises:
        StrideTwinError: The bag cannot be read, or has no readable sample.
    """
    if kind == "mcap":
        return read_bag(McapBag([path], notes), kind, notes, per_metre)
    if kind == "rosbag1":
        return read_bag(RosBag(path, True, notes), kind, notes, per_metre)
    files = _list_bag_files(path) if path.is_dir() else [path]
    if not files:
        raise ConfigError(path, "", "no metadata.yaml, .db3 or .mcap", "a ROS 2 bag")
    if path.is_file() and path.suffix not in (".db3", ".mcap"):
        raise ConfigError(path, "", path.suffix, "a file .db3, as SQLite files of ROS 2 bags are called; rename it")
    if all(f.suffix == ".mcap" for f in files):
        return read_bag(McapBag(files, notes), kind, notes, per_metre)
    for file in files:  # before rosbags runs queries on them
        if file.suffix == ".db3":
            _check_database(file, notes)
    if path.is_dir() and not (path / _METADATA).is_file():  # the recorder was killed, or the files were copied alone
        names = ", ".join(file.name for file in files)
        notes.warn(f"no {_METADATA}, as after a recorder that was killed; files that are read: {names}")
        parts = [RosBag(file, False, notes) for file in files]
        if len(parts) > 1:
            return read_bag(BagInParts(parts), kind, notes, per_metre)
        return read_bag(parts[0], kind, notes, per_metre)
    return read_bag(RosBag(path, False, notes), kind, notes, per_metre)


def _check_database(file: Path, notes: Notes) -> None:
    """Reports what makes an SQLite file of a bag incomplete or damaged, and refuses one that is no bag's.

    Args:
        file: The file.
        notes: Collects the reports.

    Raises:
        StrideTwinError: It has other objects than tables of plain columns; or, unless lenient, it is damaged.
    """
    journal = file.with_name(f"{file.name}-wal")
    if journal.is_file() and journal.stat().st_size > 0:
        what = f"{journal.name} beside it holds messages that the recorder did not move into the file before it ended"
        advice = f"sqlite3 {file.name} 'PRAGMA wal_checkpoint(TRUNCATE)' moves them"
        notes.add_problem(Problem("", None, f"{file.name}: {what}: expected no such file; {advice}"))
    check_tables(file)
    if not sqlite_is_sound(file):
        notes.add_problem(Problem("", None, f"{file.name}: a damaged SQLite file"))


def _list_bag_files(path: Path) -> list[Path]:
    """The files of a ROS 2 bag in the order of its metadata, or all files if it has no metadata.

    Raises:
        StrideTwinError: The metadata are invalid, name a file that is missing, or say that the bag is compressed.
    """
    metadata = path / _METADATA
    stored = sorted(path.glob("*.mcap"), key=_part_order) or sorted(path.glob("*.db3"), key=_part_order)
    if not metadata.is_file():
        return stored
    try:
        data: Any = read_yaml(metadata)
        info = data["rosbag2_bagfile_information"]
        names = [str(n) for n in info["relative_file_paths"]]
        compressed = str(info.get("compression_mode") or "none").lower() != "none"
    except (KeyError, TypeError, AttributeError, ValueError, StrideTwinError) as error:
        is_other = isinstance(error, TypeError | AttributeError)  # such as an empty file
        reason = "it is empty, or has other contents" if is_other else " ".join(str(error).split())
        raise StrideTwinError(f"{metadata}: no description of a ROS 2 bag: {reason[:120]}; {_REINDEX}") from error
    if compressed:
        raise ConfigError(
            metadata, "compression_mode", info["compression_mode"], "none: unpack it first (ros2 bag convert)"
        )
    files = [path / Path(n).name for n in names]
    for file in files:
        if not file.is_file():
            valid = f"existing files; the folder has {', '.join(f.name for f in stored) or 'none'}; {_REINDEX}"
            raise ConfigError(metadata, "relative_file_paths", file.name, valid)
    return files


def _part_order(file: Path) -> tuple[str, int]:
    """Sort key of the files of a bag: by name, and those that differ in the number at the end alone by this."""
    stem = file.stem.rstrip("0123456789")
    return stem, int(file.stem[len(stem) :] or -1)


def _assign_topics(source: Source, requested: Mapping[str, str]) -> dict[str, str]:
    """Our topic of every stream of a source, by its name in the source.

    Args:
        source: The source, whose `names` are the defaults.
        requested: The user's topics, by a name in the source or by its default topic.

    Raises:
        ConfigError: An unknown name, an invalid topic, or one topic for two streams.
    """
    names = [*source.blocks, *source.images]
    defaults = {name: source.names.get(name, name) for name in names}  # topics without the user's wishes
    for old, new in requested.items():
        if old not in defaults and old not in defaults.values():
            raise ConfigError("import", "--map", old, f"one of {', '.join(names)}")
        if not new.startswith("/") or len(new) < 2:
            raise ConfigError("import", "--map", new, "a topic that begins with /")
    # a wish for the name in the source counts before one for its default topic
    topics = {n: requested.get(n, requested.get(default, default)) for n, default in defaults.items()}
    ours = list(topics.values())
    shared = next((topic for topic in ours if ours.count(topic) > 1), None)  # a topic of two streams
    if shared is not None:
        same = " and ".join(name for name, topic in topics.items() if topic == shared)
        raise ConfigError("import", "--map", shared, f"a topic of its own for each of {same}")
    return topics


def _rename_topics(source: Source, topics: Mapping[str, str], bodies_are_known: bool) -> Source:
    """The source with its streams, assumptions and calibrations under our topics.

    Args:
        source: The source, with its own names.
        topics: Our topic of each of these.
        bodies_are_known: Whether the rig knows the body of each sensor; otherwise the new topics imply it.
    """
    blocks = {topics[name]: replace(block, topic=topics[name]) for name, block in source.blocks.items()}
    images = {topics[name]: stream for name, stream in source.images.items()}
    assumed = {topics.get(name, name): text for name, text in source.assumed.items()}
    # a rig may also have sensors that are no streams, which keep their names
    rig = rename_rig(source.rig, lambda name: topics.get(name, name), bodies_are_known)
    return replace(source, blocks=blocks, images=images, rig=rig, assumed=assumed)


def _clean_streams(source: Source, notes: Notes) -> Source:
    """Another tool's streams with gaps of its IMUs bridged, and without paths that have no attitudes.

    Args:
        source: The source, under our topics.
        notes: Collects what was bridged and left out, and streams of images that cannot be read.

    Raises:
        StrideTwinError: Nothing is left.
    """
    if source.kind != _TABLES:  # a table's IMUs are bridged before they are joined
        blocks = {topic: _bridge_inertial(topic, block, notes) for topic, block in source.blocks.items()}
        source = replace(source, blocks=blocks)
    source = replace(source, blocks=_leave_out_paths(source, notes))
    _report_unreadable(source, notes)
    return source


def _bridge_inertial(topic: str, block: Block[Sample], notes: Notes) -> Block[Sample]:
    """An IMU or accelerometer whose numbers are all finite without unmeasured rows and gaps; other blocks unchanged."""
    if block.kind not in (Imu, Accelerometer) or not block.finite.all():
        return block
    return bridge_gaps(topic, leave_out_unmeasured(topic, block, notes), notes)


def _leave_out_paths(source: Source, notes: Notes) -> dict[str, Block[Sample]]:
    """The small streams of a source without paths that have no attitudes, as of a satellite receiver; these are named.

    Raises:
        StrideTwinError: Nothing else is left.
    """
    blocks = dict(source.blocks)
    for topic, block in source.blocks.items():
        if block.kind is not Odometry or not len(block):
            continue
        norm = np.linalg.norm(block.columns["q_world_frame"], axis=1)
        is_off = np.isfinite(norm) & (
            np.abs(norm - 1.0) > QUATERNION_NORM_ERROR
        )  # other numbers are reported elsewhere
        if is_off.any():
            row = int(np.argmax(is_off))
            reason = f"the quaternion of row {row + 1} has the norm {norm[row]:.3g}, not 1"
            notes.warn(f"{topic} is not read: {reason}; {int(is_off.sum())} of {len(block)} poses have no attitude")
            del blocks[topic]
    if source.blocks and not blocks and not source.images:
        raise RecordingError(f"{notes.path}: no readable sample: {'; '.join(notes.warnings)}")
    return blocks


def _report_unreadable(source: Source, notes: Notes) -> None:
    """Warns of streams whose first image cannot be read, which would be an error only where it is used."""
    for topic, images in source.images.items():
        try:
            images.load(topic, 0)
        except (StrideTwinError, ValueError, IndexError) as error:
            notes.warn(f"{topic}: its first image cannot be read: {error}")


def _find_registered(source: Source, topics: Mapping[str, str]) -> set[str]:
    """Our topics of the depth streams that are registered to colour.

    A depth stream counts as registered if the layout of the source says so, if its name does, or if it has the
    intrinsics of a colour camera.

    Args:
        source: The source, with its own names.
        topics: Our topic of each of these.
    """
    cameras = source.rig.cameras
    # the colour cameras with a calibration
    colour = [cameras[name] for name, stream in source.images.items() if stream.kind is Image and name in cameras]
    registered: set[str] = set()
    for name, images in source.images.items():
        if images.kind is not Depth:
            continue
        by_name = source.kind in _REGISTERED_KINDS or bool(_REGISTERED.search(name.lower()))
        camera = cameras.get(name)  # None if the source has no calibration of it
        has_colour_intrinsics = camera is not None and any(np.allclose(camera.intrinsics, c.intrinsics) for c in colour)
        if by_name or has_colour_intrinsics:
            registered.add(topics[name])
    return registered


def _list_image_sizes(images: Mapping[str, ImageStream]) -> set[tuple[int, int]]:
    """(width, height) of the first image of each stream, as far as they can be read."""
    sizes = {read_first_image_size(stream) for stream in images.values()}
    return {size for size in sizes if size is not None}


def _read_better_rig(path: Path, source: Source, options: ImportOptions, streams: Streams, notes: Notes) -> Rig:
    """Calibrations with precedence over those of the source: from a `rig.yaml` in its folder, and from `--rig`.

    Those of `--rig` come before those of the folder.

    Args:
        path: File or folder of the source.
        source: The source, whose calibrations and images are under our topics.
        options: The user's options.
        streams: Mapping of the source's streams to ours.
        notes: Collects calibrations that match no stream.

    Returns:
        The calibrations of the streams that they describe, under our topics.

    Raises:
        StrideTwinError: A file is invalid, or (unless lenient) that of `--rig` matches no stream.
    """
    better = Rig()
    if (beside := path / RIG_NAME).is_file():
        try:
            # it describes the source: its topics are the source's, even if others were given
            better, _ = match_rig(
                read_rig(beside, warn=notes.warn, sizes=_list_image_sizes(source.images), needs_rates=False),
                source.rig,
                streams,
                as_read=False,
            )
        except StrideTwinError as error:
            notes.add_error(error)
    if options.rig is not None:
        user_rig = read_rig(options.rig, warn=notes.warn, sizes=_list_image_sizes(source.images), needs_rates=False)
        matched, unmatched = match_rig(user_rig, _merge_rigs(source.rig, better), streams)
        report_unmatched(options.rig, user_rig, unmatched, streams, notes)
        better = _merge_rigs(better, matched)
    return better


def _merge_rigs(rig: Rig, better: Rig) -> Rig:
    """The calibrations of both rigs; those of `better` replace others of the same topic."""
    return Rig(
        imus={**rig.imus, **better.imus},
        cameras={**rig.cameras, **better.cameras},
        boards={**rig.boards, **better.boards},
        others={**rig.others, **better.others},
    )


def _check_plausible(source: Source, notes: Notes) -> None:
    """Rejects implausible units and rates, which would silently corrupt an estimate.

    The IMUs of tables are left out: their reader has judged them, and knows the columns.
    """
    for topic, block in source.blocks.items():
        if block.kind in (Imu, Accelerometer) and source.kind != _TABLES:
            sound = block[is_increasing(block.t_ns) & block.finite]  # invalid samples are reported elsewhere
            if len(sound) < _FEWEST:
                continue
            for implausible in find_implausible_values(sound):
                if implausible.is_error:
                    notes.add_problem(Problem(topic, int(sound.t_ns[0]), str(implausible)))
                else:
                    notes.warn(f"{topic}: {implausible}")
    for topic, images in source.images.items():
        rising = images.t_ns[is_increasing(images.t_ns)]
        if len(rising) < _FEWEST:
            continue
        for implausible in find_implausible_rates(rising, IMAGE_RATES_HZ):
            notes.add_problem(Problem(topic, int(rising[0]), str(implausible)))


def _check_depth(source: Source, rig: Rig, per_metre: float | None, notes: Notes) -> None:
    """Warns of depth of another unit and of wrong focal lengths, which distances and planes in some images show.

    Args:
        source: The source, under our topics.
        rig: Calibrations of its streams, whose assumed values count as well.
        per_metre: Units of its depth images per metre; None if no option gives them.
        notes: Collects the warnings.
    """
    for camera in rig.cameras.values():
        images = source.images.get(camera.depth_topic)
        if images is None or len(images.t_ns) < _FEWEST:
            continue
        depths = _read_some_depths(images)
        for finding in find_implausible_views(depths, camera, per_metre):
            notes.warn(f"{camera.depth_topic}: {finding}")


def _read_some_depths(images: ImageStream) -> list[Array]:
    """A few depth images (H, W), m, spread over a stream; those that cannot be read are left out."""
    depths = []
    for index in choose_views(len(images.t_ns)):
        try:
            image = images.load("", index)  # its topic does not matter
        except (StrideTwinError, ValueError, IndexError):
            continue  # is reported when the image is used
        if isinstance(image, Depth):
            depths.append(np.asarray(image.depth, float))
    return depths


def _check_overlap(contents: ImportedContents, notes: Notes) -> None:
    """Checks that all streams of a recording share one clock over its whole duration.

    Each stream is compared with the longest one. A stream that does not overlap it has another epoch or unit, which is
    a problem. A stream that begins late or ends early gets a warning, as part of it may be missing.
    """
    name, longest = max(contents.topics.items(), key=lambda item: item[1].last_ns - item[1].first_ns)
    for topic, info in contents.topics.items():
        # by how much the stream begins late and ends early, and how much of that is allowed, ns
        late, early = info.first_ns - longest.first_ns, longest.last_ns - info.last_ns
        period = (info.last_ns - info.first_ns) / max(1, info.count - 1)  # mean time between its samples, ns
        slack = _SHORT * (longest.last_ns - longest.first_ns) + 2 * period
        if info.count > 1 and info.kind not in _EVENTS and max(late, early) > slack:
            # of one clock, a sensor that starts late or stops early is shorter
            last_equally_long = late + early <= slack
            clocks = f"; as both last equally long, their clocks are probably {abs(late) * 1e-9:.3f} s apart"
            notes.warn(
                f"{topic}: covers {info.first_ns * 1e-9:.3f} to {info.last_ns * 1e-9:.3f} s alone, "
                f"{name} {longest.first_ns * 1e-9:.3f} to {longest.last_ns * 1e-9:.3f} s"
                f"{clocks if last_equally_long else ''}"
            )
        if info.last_ns < longest.first_ns or info.first_ns > longest.last_ns:
            spans = [f"{i.first_ns * 1e-9:.3f} to {i.last_ns * 1e-9:.3f} s" for i in (info, longest)]
            description = f"stamps from {spans[0]}, where {name} has {spans[1]}: expected stamps of one clock"
            notes.add_problem(Problem(topic, info.first_ns, description))
