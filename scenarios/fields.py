"""A position in a file, for errors that are found after the file has been read."""

from __future__ import annotations

from dataclasses import dataclass

from stridetwin.streams.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Where:
    """Position of a node: the file as the user named it, and the path of keys inside it."""

    source: str
    path: str = ""

    def key(self, name: str) -> Where:
        """The position of a key below this one."""
        return Where(source=self.source, path=f"{self.path}.{name}" if self.path else name)

    def item(self, index: int) -> Where:
        """The position of a list's item."""
        return Where(source=self.source, path=f"{self.path}[{index}]")

    def error(self, value: object, valid: str) -> ConfigError:
        """The error to raise about an invalid value at this position."""
        return ConfigError(self.source, self.path, value, valid)
