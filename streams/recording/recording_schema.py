"""What a recording holds beside its topics: the names of calibration and metadata, and the version of the schema.

The schema version covers topics, message types, metadata and calibration. A new minor version adds items that older
readers ignore; a new major version changes the meaning of existing items. Recordings without a version are those of
major version 0, and are read as 1.0.
"""

from __future__ import annotations

from collections.abc import Mapping

from stridetwin.streams.errors import RecordingError

RIG_NAME = "rig.yaml"
"""Name of the MCAP attachment with the calibration."""
METADATA_NAME = "stridetwin"
"""Name of the MCAP metadata record with the walk's metadata."""
VERSION_RECORD = "stridetwin_schema"
"""Name of the MCAP metadata record with the version."""
VERSION = "1.0"
VERSION_VALUES = {"version": VERSION}
"""Contents of the version record of a new recording."""
NO_VERSION = "0.0"
"""Version of a recording without a version record."""


def read_version(values: Mapping[str, str], source: object) -> str:
    """The version in a recording's version record, such as `1.0`.

    Args:
        values: Contents of the version record: texts by name.
        source: Names the recording in errors.

    Raises:
        RecordingError: The version is invalid, or of a newer major version.
    """
    version = values.get("version", "")
    major, _, minor = version.partition(".")
    is_number = [part.isascii() and part.isdecimal() for part in (major, minor)]
    if not (all(is_number) and len(version) < 16):
        raise RecordingError(
            f"{source}: invalid schema version {version[:40]!r}: expected MAJOR.MINOR, up to {VERSION}"
        )
    if int(major) > int(VERSION.partition(".")[0]):
        raise RecordingError(
            f"{source}: made by a newer release: its schema version is {version}, and this release reads "
            f"up to {VERSION}; update stridetwin to read it"
        )
    return version
