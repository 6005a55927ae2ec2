"""Seeds of walks in files: their number, from 0 on or from a first one, or a list."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from pydantic import AfterValidator, Discriminator, Field, StrictInt, Tag

from stridetwin.streams.fields import FileModel, field_error


def _check_unique(seeds: tuple[int, ...]) -> tuple[int, ...]:
    """Returns seeds that are all different; refuses others."""
    if len(set(seeds)) < len(seeds):
        raise field_error(list(seeds), "every seed once")
    return seeds


class _SeedRange(FileModel):
    """Consecutive seeds.

    Attributes:
        first: The first one.
        count: Their number.
    """

    first: Annotated[StrictInt, Field(ge=0, le=2**31)]
    count: Annotated[StrictInt, Field(ge=1, le=10_000)]

    def build(self) -> tuple[int, ...]:
        """The consecutive seeds."""
        return tuple(range(self.first, self.first + self.count))


def _form(node: object) -> str:
    """The tag of the form that seeds in a file have: a list of seeds, a range (first and count), or a count alone."""
    return "=list" if isinstance(node, list) else "=range" if isinstance(node, dict) else "=count"


if TYPE_CHECKING:
    SeedsInFile = tuple[int, ...]
else:
    SeedsInFile = Annotated[
        Annotated[StrictInt, Field(ge=1, le=10_000), AfterValidator(lambda count: tuple(range(count))), Tag("=count")]
        | Annotated[_SeedRange, AfterValidator(_SeedRange.build), Tag("=range")]
        | Annotated[
            tuple[Annotated[StrictInt, Field(ge=0, le=2**31)], ...],
            Field(min_length=1),
            AfterValidator(_check_unique),
            Tag("=list"),
        ],
        Discriminator(_form),
    ]
"""Type of the key `seeds`: whatever its form, it becomes the tuple of all seeds."""
