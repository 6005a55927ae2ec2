"""XML as OpenCV's `FileStorage` writes it, as plain data like those of its YAML."""

from __future__ import annotations

import re
from xml.etree import ElementTree

from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.yaml_file import DEEPEST, MOST_VALUES

_ROOT = re.compile(r"\s*(?:<\?xml[^>]*\?>\s*)?<opencv_storage\b")
"""Begin of a file, as `<?xml version="1.0"?><opencv_storage>`."""
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
"""A number, as `-1.5e-3` and `2.`."""
_MATRIX = "opencv-matrix"
"""Type of the elements that are matrices."""


def is_opencv_xml(text: str) -> bool:
    """Whether a text is XML of OpenCV."""
    return _ROOT.match(text) is not None


def parse_opencv_xml(text: str, source: str) -> dict[str, object]:
    """The plain data of XML of OpenCV; a matrix is a mapping with the key `data`, a list of numbers.

    Args:
        text: The text.
        source: Names it in errors.

    Raises:
        StrideTwinError: It is not such XML, is too large, or has declarations, which OpenCV never writes and with which
            a small file may become a large one.
    """
    if "<!" in re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL):
        raise ConfigError(source, "", "declarations in XML", "XML as OpenCV writes it")
    try:
        root = ElementTree.fromstring(text)  # without declarations nothing can grow
    except ElementTree.ParseError as error:
        raise StrideTwinError(f"{source}: not XML: {error}") from error
    if sum(1 for _ in root.iter()) > MOST_VALUES:
        raise ConfigError(source, "", "...", f"up to {MOST_VALUES} values")
    return {child.tag: _to_plain_data(child, source, 1) for child in root}


def _to_plain_data(element: ElementTree.Element, source: str, depth: int) -> object:
    """The plain data of an element: a mapping, a list, a number or a text.

    Raises:
        ConfigError: It is too deep, or a matrix has other than numbers.
    """
    if depth > DEEPEST:
        raise ConfigError(source, element.tag, "...", f"up to {DEEPEST} levels")
    tokens = (element.text or "").split()
    if element.get("type_id") == _MATRIX:
        numbers = (element.findtext("data") or "").split()
        if len(numbers) > MOST_VALUES or not all(map(_NUMBER.fullmatch, numbers)):
            raise ConfigError(source, element.tag, " ".join(numbers)[:80], "numbers")
        return {"data": [float(word) for word in numbers]}
    if len(element):
        items = [(child.tag, _to_plain_data(child, source, depth + 1)) for child in element]
        return [item for _, item in items] if all(tag == "_" for tag, _ in items) else dict(items)
    values: list[object] = [float(word) if _NUMBER.fullmatch(word) else word.strip('"') for word in tokens]
    if len(values) > 1 and all(isinstance(value, float) for value in values):
        return values
    return values[0] if len(values) == 1 else " ".join(tokens).strip('"')
