"""The outcome of a command, and its progress callback."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Progress = Callable[[str, float], None]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Outcome of a command.

    Attributes:
        data: For `--json`.
        lines: Text output.
        code: Exit code.
    """

    data: dict[str, Any]
    lines: list[str]
    code: int = 0
