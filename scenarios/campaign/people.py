"""The people of a campaign: groups whose members' bodies are drawn once and used in many walks."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any

from pydantic import AfterValidator, Discriminator, Field, Tag

from stridetwin.scenarios.campaign.distributions import Distribution, DistributionInFile, Fixed
from stridetwin.sim.config import Person
from stridetwin.sim.wearer.anthropometry import PEOPLE
from stridetwin.streams.errors import Where
from stridetwin.streams.fields import FileModel, ReadAs, refused, unique, whole, words

MOST = 10_000
_NOWHERE = Where(source="")
_BODY = ("bmi", "sex", "height_m", "mass_kg", "shoe_mm")
_MASS_KG = (45.0, 110.0)
_MM = 1e-3


@dataclass(frozen=True, kw_only=True)
class Group:
    """People whose bodies are drawn from the same distributions.

    Attributes:
        count: Number of people.
        body: Distribution of each key of a person, and of `bmi` (kg/m²), which gives the mass.
        names: Predefined people by name, instead of drawn ones.
        at: Position of the group in the file.
    """

    count: int
    body: dict[str, Distribution]
    names: tuple[str, ...] = ()
    at: Where = _NOWHERE

    def placed(self, node: dict[str, Any], at: Where) -> Group:
        """The group with its place, and its keys in the order of the file, which is that of the draws."""
        return replace(self, body={key: self.body[key] for key in node if key in self.body}, at=at)

    @property
    def drawn(self) -> tuple[str, ...]:
        """Keys that vary."""
        return tuple(key for key, found in self.body.items() if not isinstance(found, Fixed))

    def person(self, quantiles: dict[str, float]) -> dict[str, Any]:
        """A member, in the form of a scenario file's person, from the quantile of each key that varies."""
        body = {key: found.at(quantiles.get(key, 0.0)) for key, found in self.body.items()}
        if "bmi" in body:
            mass = float(f"{body.pop('bmi') * body.get('height_m', Person.height_m) ** 2:.6g}")
            body["mass_kg"] = min(max(mass, _MASS_KG[0]), _MASS_KG[1])
        return body


class _Named(FileModel):
    """Predefined people.

    Attributes:
        named: Their names.
    """

    named: Annotated[tuple[Annotated[str, words(tuple(PEOPLE))], ...], Field(min_length=1), AfterValidator(unique)]

    def build(self) -> Group:
        """The group."""
        return Group(count=len(self.named), body={}, names=self.named)


class _Drawn(FileModel):
    """People whose bodies are drawn from distributions.

    Attributes:
        count: Number of people.
        bmi: Body mass index, kg/m², 15-45, which gives the mass; instead of mass_kg.
        sex: `male` or `female`.
        height_m: Standing height without shoes.
        mass_kg: Body mass.
        shoe_mm: Shoe size, as the length of a fitting foot.
    """

    count: Annotated[int, whole(1, MOST)]
    bmi: DistributionInFile = None
    sex: DistributionInFile = None
    height_m: DistributionInFile = None
    mass_kg: DistributionInFile = None
    shoe_mm: DistributionInFile = None

    def build(self) -> Group:
        """The group."""
        body = {key: getattr(self, key) for key in _BODY if key in self.model_fields_set}
        if {"bmi", "mass_kg"} <= body.keys():
            raise refused(body["bmi"].words, "either bmi or mass_kg", "bmi")
        for end in body["bmi"].ends if "bmi" in body else ():
            if isinstance(end, bool) or not isinstance(end, (int, float)) or not 15 <= end <= 45:
                raise refused(end, "15-45 (kg/m²)", "bmi")
        return Group(count=self.count, body=body)


_GroupInFile = Annotated[
    Annotated[_Named, AfterValidator(_Named.build), Tag("=named")]
    | Annotated[_Drawn, AfterValidator(_Drawn.build), Tag("=drawn")],
    Discriminator(lambda node: "=named" if isinstance(node, dict) and "named" in node else "=drawn"),
]
GroupInFile = Annotated[Group, ReadAs(_GroupInFile)]
"""Type of an item of the list `people`; it becomes a `Group`."""


def plain_person(person: Person) -> dict[str, Any]:
    """A person in the form of scenario file and manifest, with all defaults filled in."""
    body = asdict(person)
    shoe = body.pop("shoe_m")
    return body | ({} if shoe is None else {"shoe_mm": float(f"{shoe / _MM:.6g}")})
