"""What a command says, and whom it tells how far it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Progress = Callable[[str, float], None]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a command has to say.

    Attributes:
        data: For `--json`.
        lines: For people.
        code: Exit code.
    """

    data: dict[str, Any]
    lines: list[str]
    code: int = 0
