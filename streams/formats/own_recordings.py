"""Calibration and metadata of our own recordings, when they are read as a bag."""

from __future__ import annotations

import zlib
from pathlib import Path

from mcap import records
from mcap.opcode import Opcode

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.kalibr import rig_from_yaml
from stridetwin.streams.recording import index
from stridetwin.streams.recording.imported import Notes
from stridetwin.streams.recording.index import Problem
from stridetwin.streams.recording.mcap_scan import DamagedError, parse, top_records
from stridetwin.streams.recording.writer import METADATA_NAME, RIG_NAME
from stridetwin.streams.rig import Rig


def is_ours(path: Path, if_damaged: bool) -> bool:
    """Whether an MCAP file begins like our recordings, with calibration and metadata.

    Args:
        path: The file.
        if_damaged: Result for a file that cannot be read that far.
    """
    try:
        for opcode, _, body in top_records(path):
            if opcode == Opcode.ATTACHMENT and parse(records.Attachment, body).name == RIG_NAME:
                return True
            if opcode == Opcode.METADATA and parse(records.Metadata, body).name in (
                METADATA_NAME,
                index.RECORD,
            ):
                return True
            if opcode not in (Opcode.HEADER, Opcode.ATTACHMENT, Opcode.METADATA):
                return False
    except (DamagedError, OSError):
        return if_damaged
    return False


def read_calibration(path: Path, notes: Notes) -> tuple[Rig, dict[str, str]]:
    """The calibration and the metadata at the beginning of one of our recordings.

    Args:
        path: The file.
        notes: Collects damage.

    Raises:
        StrideTwinError: A newer release made the file, or (unless lenient) one of them is damaged.
    """
    rig, metadata = Rig(), dict[str, str]()
    try:
        for opcode, _, body in top_records(path):
            if opcode == Opcode.ATTACHMENT:
                attachment = parse(records.Attachment, body)
                if attachment.name != RIG_NAME:
                    continue
                if int.from_bytes(body[-4:], "little") not in (0, zlib.crc32(body[:-4])):
                    notes.problem(Problem("", None, f"CRC mismatch of the attachment {RIG_NAME}"))
                else:
                    rig = _rig(attachment.data, notes)
            elif opcode == Opcode.METADATA:
                record = parse(records.Metadata, body)
                if record.name == index.RECORD:
                    index.read(record.metadata, path)
                elif record.name == METADATA_NAME:
                    metadata.update(record.metadata)
            elif opcode != Opcode.HEADER:
                break  # the recorder writes them before all messages
    except DamagedError:
        pass  # reported when the messages are read
    return rig, metadata


def _rig(data: bytes, notes: Notes) -> Rig:
    try:
        return rig_from_yaml(data.decode(), RIG_NAME)
    except (UnicodeDecodeError, StrideTwinError) as error:
        notes.problem(Problem("", None, f"invalid calibration: {error}"))
        return Rig()
