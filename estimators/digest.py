"""What compiled code is cached under."""

from __future__ import annotations

import zlib
from pathlib import Path


def digest_of_sources(*folders: Path) -> int:
    """Checksum, ≥ 0, of every Python file that lies in the folders.

    numba's cache looks at the file of the cached function alone, and would go on with what that function
    took in from other files, however much those have changed since. So only an outermost function is cached, made anew
    where this differs.
    """
    return zlib.crc32(b"".join(f.read_bytes() for folder in folders for f in sorted(folder.glob("*.py"))))
