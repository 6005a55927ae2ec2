"""YAML as OpenCV's `FileStorage` writes it: with a directive and a tag that other parsers do not know."""

from __future__ import annotations

import re
from pathlib import Path

from stridetwin.streams.bounded import LARGEST_SETTING, read_text
from stridetwin.streams.yaml_file import parse_yaml


def read_opencv_yaml(file: Path) -> object:
    """The plain data of a YAML file with or without OpenCV's extensions; a matrix is a mapping with the key `data`.

    Raises:
        StrideTwinError: The file cannot be read or is no such YAML; the message names the line.
    """
    text = re.sub(r"!!opencv-matrix|^%.*$", "", read_text(file, LARGEST_SETTING), flags=re.MULTILINE)
    return parse_yaml(text, str(file))
