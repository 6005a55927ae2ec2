"""Types of fields in configuration files that pydantic lacks: numbers with a unit, words, and mappings told by a key.

Ranges, names in the file and lists are pydantic's own: `Annotated[Number, Field(ge=20, le=250, alias="riser_mm"),
MILLIMETRES]` is a number from 20 to 250 under the key `riser_mm` in a file, and metres in the object.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Generic, Literal, TypeVar

from pydantic import (
    AfterValidator,
    AllowInfNan,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    Strict,
    StrictInt,
    ValidationInfo,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from stridetwin.streams.errors import Missing, StrideTwinError

DEG, MM = 0.017453292519943295, 1e-3
"""One degree in rad, and one millimetre in m."""
TAG = "="
"""First character of the tags of tagged unions; tags are not keys of a file.

pydantic selects the member of a tagged union by a text, its tag, and names that text in the location of an error.
"""
V = TypeVar("V")


class FileModel(BaseModel):
    """A mapping in a file, without other keys than the model's."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)


class ReadAs:
    """Annotation: the type of the value in a file, where the attribute has another; `convert` converts it."""

    def __init__(self, file_type: object, convert: Callable[[V], object] | None = None) -> None:
        self._file_type = file_type if convert is None else Annotated[file_type, AfterValidator(convert)]

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """The schema of the type in the file, in place of that of the annotated type `source`."""
        return handler.generate_schema(self._file_type)


class OneOf(ReadAs):
    """Annotation: one of the words in `valid`; if `valid` is a mapping, the attribute holds the value of the word."""

    def __init__(self, valid: Iterable[str] | Mapping[str, object]) -> None:
        values = dict(valid) if isinstance(valid, Mapping) else {word: word for word in valid}
        super().__init__(Literal[tuple(values)], values.__getitem__)  # a file has the word, the attribute its value


class Unit:
    """Annotation, after the range: the file has a number in a unit of `factor` SI units, the attribute in SI units."""

    def __init__(self, factor: float) -> None:
        self._factor = factor

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """The schema of the number in the file, followed by its conversion to SI; None stays None."""
        return core_schema.no_info_after_validator_function(
            lambda value: None if value is None else value * self._factor, handler(source)
        )


def context_folder(info: ValidationInfo) -> Path:
    """The folder to which paths in a file are relative: `folder` of the validation context."""
    context: Mapping[str, Path] = info.context or {}
    return Path(context["folder"])


DEGREES, MILLIMETRES, MILLISECONDS, PERCENT = Unit(DEG), Unit(MM), Unit(1e-3), Unit(0.01)
Number = Annotated[float, Strict(), AllowInfNan(False)]
"""A finite number."""
NotNegative = Annotated[Number, Field(ge=0)]
Positive = Annotated[Number, Field(gt=0)]
Count = Annotated[StrictInt, Field(ge=1, le=2**31 - 1)]
Text = Annotated[str, Field(strict=True, pattern=r"\S"), AfterValidator(lambda text: " ".join(text.split()))]
"""A line that is not empty; each run of white space becomes one blank."""
InputFile = Annotated[Path, ReadAs(Text), AfterValidator(lambda name, info: context_folder(info) / name)]
"""The path of a file; a relative one starts at the `folder` of the validation context."""


class Required:
    """Annotation of a dataclass: these keys must be in the file, though the attributes have defaults."""

    def __init__(self, *keys: str) -> None:
        self._keys = keys

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """The schema of the dataclass, preceded by a check that the required keys are in the file."""
        return core_schema.no_info_before_validator_function(self._check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """The JSON Schema of the dataclass, whose `required` also lists these keys, each once."""
        resolved = handler.resolve_ref_schema(handler(schema))
        resolved["required"] = list(dict.fromkeys([*resolved.get("required", ()), *self._keys]))
        return resolved

    def _check(self, node: object) -> object:
        """The value as it is in the file, or an error if it is a mapping without one of the required keys.

        Anything but a mapping passes: the dataclass refuses it itself.
        """
        if isinstance(node, dict) and (missing := [key for key in self._keys if key not in node]):
            raise field_error(Missing(), "this key", missing[0])
        return node


class OneKey(Generic[V]):
    """Annotation: a mapping of exactly one key, which determines the type of its value.

    Args:
        kinds: Type of the value by key.
        build: Builds the result from key and value; None takes the value.
    """

    def __init__(self, kinds: Mapping[str, type[V]], build: Callable[[str, V], object] | None = None) -> None:
        self._kinds, self._build = kinds, build or (lambda key, value: value)

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """The schema of a union of mappings of one key each, not that of `source`; the key selects the member."""

        def find_tag(node: object) -> str | None:
            """Tag of the member for a mapping of one key; None, which pydantic refuses, for anything else."""
            return f"{TAG}{next(iter(node))}" if isinstance(node, dict) and len(node) == 1 else None

        members = {
            TAG + kind: self._make_mapping_schema(kind, handler.generate_schema(of)) for kind, of in self._kinds.items()
        }
        return core_schema.tagged_union_schema(members, discriminator=find_tag)

    def _make_mapping_schema(self, kind: str, value: CoreSchema) -> CoreSchema:
        """The schema of a mapping of one key, from which `build` then makes the result.

        Args:
            kind: The key.
            value: Schema of its value.
        """
        one_field = core_schema.typed_dict_schema(
            {kind: core_schema.typed_dict_field(value, required=True)}, extra_behavior="forbid"
        )
        return core_schema.no_info_after_validator_function(lambda node: self._build(kind, node[kind]), one_field)


class OneKind:
    """Annotation: a mapping whose key `kind`, which the type has no attribute for, determines the other keys.

    Args:
        kinds: Type of the other keys by kind.
    """

    def __init__(self, kinds: Mapping[str, object]) -> None:
        self._kinds = kinds

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """The schema of a union of mappings, in place of that of `source`; the value of `kind` selects the member."""

        def find_tag(node: object) -> str | None:
            """Tag of the member for a mapping with the key `kind`; None, which pydantic refuses, for anything else."""
            return f"{TAG}{node['kind']}" if isinstance(node, dict) and "kind" in node else None

        members = {
            TAG + kind: handler.generate_schema(Annotated[of, _OfKind(kind)]) for kind, of in self._kinds.items()
        }
        return core_schema.tagged_union_schema(members, discriminator=find_tag)


class _OfKind:
    """Annotation of one member of a union by `kind`: the type has no such attribute, but the file has the key."""

    def __init__(self, kind: str) -> None:
        self._kind = kind

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """The schema of the type, preceded by the removal of the key `kind`."""
        return core_schema.no_info_before_validator_function(
            lambda node: {k: v for k, v in node.items() if k != "kind"}, handler(source)
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """The JSON Schema of the type with the constant, required property `kind`."""
        resolved = handler.resolve_ref_schema(handler(schema))
        resolved["properties"] = {"kind": {"const": self._kind}, **resolved["properties"]}
        resolved["required"] = list(dict.fromkeys(["kind", *resolved.get("required", ())]))
        return resolved


def check_unique(values: tuple[str, ...]) -> tuple[str, ...]:
    """Validator of a list of names: returns it, or raises the error of the first name that is there twice."""
    for i, value in enumerate(values):
        if value in values[:i]:
            raise field_error(value, "every name once", i)
    return values


def other_file_error(error: StrideTwinError) -> PydanticCustomError:
    """The error to raise in a validator for an error in another file, which the value names.

    `validate` reports it as it is, without the location of the value.
    """
    return PydanticCustomError("elsewhere", "{error}", {"error": error})


def field_error(value: object, valid: str, *below: str | int) -> PydanticCustomError:
    """The error to raise in a validator; `validate` reports it as a ConfigError at the field's path.

    Args:
        value: The invalid value.
        valid: Description of valid values.
        below: Keys from the validated value down to the wrong one.
    """
    return PydanticCustomError("refused", "{valid}", {"value": value, "valid": valid, "below": below})
