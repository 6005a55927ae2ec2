"""An MCAP file whose streams without images are read in one pass, as `check` reads all of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stridetwin.streams.mcap_contents import McapContents
from stridetwin.streams.recording import Recording
from stridetwin.streams.samples import Block
from stridetwin.streams.topic_reader import concatenated


class _ReadOnce(McapContents):
    """Holds the blocks of all topics without images in memory."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, lenient=True)
        self._blocks: dict[str, Block[Any]] = {}

    def block(self, topic: str) -> Block[Any]:
        """All samples of a topic without images."""
        if not self._blocks:
            parts: dict[str, list[Block[Any]]] = {}
            for chunk in self._index.chunks:
                small = [t for t in chunk.parts if not self._index.readers[t].is_image]
                for name, messages in self._messages(chunk, small).items() if small else ():
                    block = self._kept_block(self._index.readers[name], messages, chunk.parts[name])
                    parts.setdefault(name, []).append(block)
            self._blocks = {name: concatenated(blocks) for name, blocks in parts.items()}
        return self._blocks[topic]


def read_once(path: Path) -> Recording:
    """A recording, opened leniently."""
    return Recording(path, lenient=True, contents=_ReadOnce(path))
