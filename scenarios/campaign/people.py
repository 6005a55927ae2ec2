"""The people of a campaign: groups whose members' bodies are drawn once and used in many walks."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from stridetwin.scenarios.campaign.distributions import Distribution, Fixed, distribution
from stridetwin.scenarios.fields import Where, integer, names_of
from stridetwin.sim.config import Person
from stridetwin.sim.people import PEOPLE

MOST = 10_000
_BODY = ("sex", "height_m", "mass_kg", "shoe_mm")
_OWN = ("count", "bmi", *_BODY)
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
    at: Where

    @property
    def drawn(self) -> tuple[str, ...]:
        """Keys that vary."""
        return tuple(key for key, found in self.body.items() if not isinstance(found, Fixed))

    def person(self, quantiles: dict[str, float]) -> dict[str, Any]:
        """A member, in the form of a scenario file's person.

        Args:
            quantiles: Of each key that varies.
        """
        body = {key: found.at(quantiles.get(key, 0.0)) for key, found in self.body.items()}
        if "bmi" in body:
            height = body.get("height_m", Person.height_m)
            mass = float(f"{body.pop('bmi') * height**2:.6g}")
            body["mass_kg"] = min(max(mass, _MASS_KG[0]), _MASS_KG[1])
        return body


def group(node: object, where: Where) -> Group:
    """One item of the list `people`.

    Raises:
        ConfigError: The message names file, field, value and what is valid.
    """
    if isinstance(node, dict) and "named" in node:
        if len(node) > 1:
            raise where.error(", ".join(node), "the key named alone, or none of it")
        names = names_of(PEOPLE)(node["named"], where.key("named"))
        if not names:
            raise where.key("named").error([], "at least one name")
        return Group(count=len(names), body={}, names=names, at=where)
    if not isinstance(node, dict) or "count" not in node:
        raise where.error(node, f"keys {', '.join(_OWN)}, of which count is required; or the key named")
    for key in node:
        if key not in _OWN:
            raise where.error(key, f"keys {', '.join(_OWN)}; or the key named")
    if "bmi" in node and "mass_kg" in node:
        raise where.key("bmi").error(node["bmi"], "either bmi or mass_kg")
    body = {key: distribution(value, where.key(key)) for key, value in node.items() if key != "count"}
    for key, found in body.items():
        if key == "bmi":
            for end in found.ends:
                if isinstance(end, bool) or not isinstance(end, (int, float)) or not 15 <= end <= 45:
                    raise where.key(key).error(end, "15-45 (kg/m²)")
    count = integer(1, MOST)(node["count"], where.key("count"))
    return Group(count=count, body=body, at=where)


def told(person: Person) -> dict[str, Any]:
    """A person in the form of scenario file and manifest, with all defaults filled in."""
    body = asdict(person)
    shoe = body.pop("shoe_m")
    return body | ({} if shoe is None else {"shoe_mm": float(f"{shoe / _MM:.6g}")})
