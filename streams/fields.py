"""Fields of configuration files: range, unit and name in the file of a dataclass field, in the terms of pydantic.

A dataclass defines its field once: `riser_m: Annotated[float, float_field(20, 250, key="riser_mm", scale=1e-3)]` is a
number from 20 to 250 under the key `riser_mm` in a file, and metres in the object. Errors and JSON Schemas follow.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationInfo,
)
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from stridetwin.streams.errors import Missing, StrideTwinError

DEG, MM = 0.017453292519943295, 1e-3
TAG = "="
"""First character of the tags of tagged unions; tags are not keys of a file."""


class FileModel(BaseModel):
    """A mapping in a file, without other keys than the model's."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)


def float_field(
    low: float | None = None,
    high: float | None = None,
    *,
    above: float | None = None,
    key: str | None = None,
    scale: float = 1.0,
) -> Any:
    """Field of a finite number: the file has it in its own unit, the attribute holds it times `scale`.

    Args:
        low: Smallest valid value.
        high: Largest valid value.
        above: Bound that a valid value exceeds.
        key: Name in the file; None for that of the attribute.
        scale: Factor from the file's unit to that of the attribute.
    """
    bounds = {name: value for name, value in (("ge", low), ("le", high), ("gt", above)) if value is not None}
    info = _field(key, **bounds, strict=True, allow_inf_nan=False)
    if scale != 1.0:
        info.metadata.append(AfterValidator(lambda value: value * scale))
    return info


def int_field(low: int, high: int, *, key: str | None = None) -> Any:
    """Field of a whole number in [low, high]; `key` is its name in the file, None for that of the attribute."""
    return _field(key, ge=low, le=high, strict=True)


def bool_field(*, key: str | None = None) -> Any:
    """Field of `true` or `false`; `key` is its name in the file, None for that of the attribute."""
    return _field(key, strict=True)


def text_field(*, key: str | None = None) -> Any:
    """Field of a non-empty line of text; each run of white space becomes one blank."""
    info = _field(key, strict=True, pattern=r"\S")
    info.metadata.append(AfterValidator(lambda value: " ".join(value.split())))
    return info


def enum_field(valid: Iterable[str] | Mapping[str, Any], *, key: str | None = None) -> Any:
    """Field of one of the words in `valid`; if `valid` is a mapping, the attribute holds the value of the word."""
    values = dict(valid) if isinstance(valid, Mapping) else {word: word for word in valid}
    info = _field(key)
    info.metadata.append(ReadAs(Literal[tuple(values)], values.__getitem__))
    return info


def _field(key: str | None, **rules: Any) -> FieldInfo:
    field: FieldInfo = Field(alias=key, **rules) if key else Field(**rules)
    return field


def file_field(*, key: str | None = None) -> Any:
    """Field of the path of a file; a relative path starts at the `folder` of the validation context."""
    info = _field(key)
    info.metadata += [ReadAs(Annotated[str, text_field()]), AfterValidator(_resolve_path)]
    return info


def _resolve_path(name: str, info: ValidationInfo) -> Path:
    return context_folder(info) / name


def context_folder(info: ValidationInfo) -> Path:
    """The folder to which paths in a file are relative: `folder` of the validation context."""
    context: Any = info.context
    return Path(context["folder"])


class ReadAs:
    """Annotation: the type of the value in a file, where the attribute has another; `convert` converts it."""

    def __init__(self, kind: Any, convert: Callable[[Any], Any] | None = None) -> None:
        self._kind, self._convert = kind, convert

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """The schema of the type in the file."""
        schema = handler.generate_schema(self._kind)
        return schema if self._convert is None else core_schema.no_info_after_validator_function(self._convert, schema)


class Required:
    """Annotation of a dataclass: these keys must be in the file, though the attributes have defaults."""

    def __init__(self, *keys: str) -> None:
        self._keys = keys

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """The schema of the dataclass, preceded by a check that the required keys are in the file."""
        return core_schema.no_info_before_validator_function(self._check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """The JSON Schema of the dataclass, whose `required` also lists these keys."""
        resolved = handler.resolve_ref_schema(handler(schema))
        resolved["required"] = [
            *resolved.get("required", ()),
            *(k for k in self._keys if k not in resolved.get("required", ())),
        ]
        return resolved

    def _check(self, node: Any) -> Any:
        if isinstance(node, dict):
            for key in self._keys:
                if key not in node:
                    raise field_error(Missing(), "this key", key)
        return node


class OneKey:
    """Annotation: a mapping of exactly one key, which determines the type of its value.

    Args:
        kinds: Type of the value by key.
        build: Builds the result from key and value; None takes the value.
    """

    def __init__(self, kinds: Mapping[str, Any], build: Callable[[str, Any], Any] | None = None) -> None:
        self._kinds, self._build = kinds, build or (lambda key, value: value)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """The schema of a union of mappings of one key each; the key selects the member."""
        return core_schema.tagged_union_schema(
            {TAG + kind: self._mapping(kind, handler.generate_schema(of)) for kind, of in self._kinds.items()},
            discriminator=self._tag,
        )

    def _mapping(self, kind: str, value: CoreSchema) -> CoreSchema:
        only = core_schema.typed_dict_schema(
            {kind: core_schema.typed_dict_field(value, required=True)}, extra_behavior="forbid"
        )
        return core_schema.no_info_after_validator_function(lambda mapping: self._build(kind, mapping[kind]), only)

    def _tag(self, node: Any) -> str | None:
        if not isinstance(node, dict) or len(node) != 1:
            return None
        return TAG + str(next(iter(node)))


class OneKind:
    """Annotation: a mapping whose key `kind` determines the other keys.

    Args:
        kinds: Type of the other keys by kind.
    """

    def __init__(self, kinds: Mapping[str, Any]) -> None:
        self._kinds = kinds

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """The schema of a union of mappings; the value of `kind` selects the member."""
        return core_schema.tagged_union_schema(
            {TAG + kind: handler.generate_schema(Annotated[of, _OfKind(kind)]) for kind, of in self._kinds.items()},
            discriminator=lambda node: f"{TAG}{node['kind']}" if isinstance(node, dict) and "kind" in node else None,
        )


class _OfKind:
    """Annotation of one member of a union by `kind`: the file has the key `kind`, the type has no such attribute."""

    def __init__(self, kind: str) -> None:
        self._kind = kind

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
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


Number = Annotated[float, float_field()]
NotNegative = Annotated[float, float_field(0)]
Positive = Annotated[float, float_field(above=0)]
Count = Annotated[int, int_field(1, 2**31 - 1)]


def check_unique(values: tuple[str, ...]) -> tuple[str, ...]:
    """Validator of a list of names: returns it, or raises the error of the first name that is there twice."""
    for i, value in enumerate(values):
        if value in values[:i]:
            raise field_error(value, "every name once", i)
    return values


def other_file_error(error: StrideTwinError) -> PydanticCustomError:
    """The error to raise in a validator for an error in another file, which the value names."""
    return PydanticCustomError("elsewhere", "{error}", {"error": error})


def field_error(value: object, valid: str, *below: str | int) -> PydanticCustomError:
    """The error to raise in a validator; `validate` reports it as a ConfigError at the field's path.

    Args:
        value: The invalid value.
        valid: Description of valid values.
        below: Keys from the validated value down to the wrong one.
    """
    return PydanticCustomError("refused", "{valid}", {"value": value, "valid": valid, "below": below})
