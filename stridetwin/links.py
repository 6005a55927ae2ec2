"""Refuses a copy of the repository without its symbolic links: its sub-packages would be missing.

Git on Windows and some unpackers of zip files write a link as a text file. `setup.py` runs this file before it builds,
the package when it is imported.
"""

from pathlib import Path

if not Path(__file__).with_name("streams").is_dir():
    raise ImportError(
        f"{Path(__file__).with_name('streams')}: invalid link: expected a link to the folder ../streams. Clone with git and "
        "symbolic links: git config --global core.symlinks true (on Windows with Developer Mode on), then git clone again"
    )
