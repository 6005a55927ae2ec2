"""Seeds of walks in files: their number, from 0 on, or a list."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Discriminator, Field, Tag

from stridetwin.streams.fields import refused, whole


def _check_unique(seeds: tuple[int, ...]) -> tuple[int, ...]:
    if len(set(seeds)) < len(seeds):
        raise refused(list(seeds), "every seed once")
    return seeds


SeedsInFile = Annotated[
    Annotated[int, whole(1, 10_000), AfterValidator(lambda count: tuple(range(count))), Tag("=count")]
    | Annotated[
        tuple[Annotated[int, whole(0, 2**31)], ...], Field(min_length=1), AfterValidator(_check_unique), Tag("=list")
    ],
    Discriminator(lambda node: "=list" if isinstance(node, list) else "=count"),
]
"""Type of the key `seeds`, which becomes a tuple of them."""
