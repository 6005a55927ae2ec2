"""Validates data of a file against a pydantic type: all errors at once, one per line, with the expected values.

The expected values come from the type's JSON Schema, the only description of fields, ranges and words.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from stridetwin.streams.errors import ConfigError, ConfigFileError, Missing, StrideTwinError
from stridetwin.streams.fields import TAG
from stridetwin.streams.json_schema import schema_of

T = TypeVar("T")
_ROOT = ""
_MISSING = ("missing", "missing_keyword_only_argument", "missing_argument")
_UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")
_COUNTED = {2: "two", 3: "three", 4: "four"}
Schema = Mapping[str, Any]


def validate(kind: type[T], data: object, source: object, *, at: str = _ROOT, context: Any = None) -> T:
    """Builds an object of a type from the plain data of a file, and reports all invalid values at once.

    Args:
        kind: Dataclass, pydantic model or other type.
        data: Data of a file.
        source: File, for errors.
        at: Path of the data inside the file.
        context: Further input of validators.

    Raises:
        ConfigError: One line for each error (`ConfigFileError` if there are several).
    """
    try:
        instance: T = type_adapter(kind).validate_python(data, context=context)  # type: ignore[arg-type]
        return instance
    except ValidationError as error:
        raise config_error(error, kind, data, source, at) from None


@cache
def type_adapter(kind: Any) -> TypeAdapter[Any]:
    """The validator of a type, built once."""
    return TypeAdapter(kind)


def config_error(error: ValidationError, kind: Any, data: object, source: object, at: str = _ROOT) -> StrideTwinError:
    """Converts a pydantic error to a ConfigError, or to a `ConfigFileError` if several values are invalid.

    Args:
        error: Error that pydantic raised.
        kind: Type that the data were validated against.
        data: Data of the file.
        source: File, for the messages.
        at: Path of the data inside the file.
    """
    root = schema_of(kind)
    every = [_to_error(entry, root, data, source, at) for entry in error.errors(include_url=False)]
    return combine_errors([e for e in every if e is not None])


def combine_errors(errors: Iterable[StrideTwinError]) -> StrideTwinError:
    """One error from several (at least one): the only one, or a `ConfigFileError` without repeated messages."""
    unique = list({str(e): e for e in errors}.values())
    return unique[0] if len(unique) == 1 else ConfigFileError(unique)


def suggest(value: object, names: Iterable[str]) -> str:
    """The valid names, separated by commas; a name similar to `value` is suggested after `did you mean`."""
    names = list(names)
    near = difflib.get_close_matches(str(value), names, n=1)
    return ", ".join(names) + (f" (did you mean {near[0]!r}?)" if near else "")


def _to_error(entry: Any, root: Schema, data: object, source: object, at: str) -> StrideTwinError | None:
    """The error of one entry of a pydantic error; None if the entry only repeats others (a list whose items failed)."""
    kind, steps, context = entry["type"], list(entry["loc"]), entry.get("ctx", {})
    if kind == "elsewhere":
        return context["error"]
    last = steps.pop() if kind in _MISSING + _UNKNOWN else None
    path, value = _path_in_data(data, [*steps, *context.get("below", ())], at), entry["input"]
    schemas = _schemas_at(root, steps)
    if kind == "refused":
        absent = context["below"][-1] if isinstance(context["value"], Missing) else None
        return ConfigError(source, _join_path(path, absent), context["value"], context["valid"])
    if isinstance(last, int):  # an item of a list of fixed length
        value = [data, *(inner for _, inner in _walk_data(data, steps))][-1]
    if kind == "too_short" and value:  # items of it are wrong
        return None
    if isinstance(last, int) or not (last or isinstance(value, dict)):
        return ConfigError(source, path, value, describe_expected(schemas, root, value))
    if kind in _MISSING:
        return ConfigError(
            source, _join_path(path, last), Missing(), describe_expected(_schemas_at(root, [*steps, last]), root)
        )
    if kind in _UNKNOWN or kind == "invalid_key":
        return ConfigError(source, path, last, f"keys {suggest(last, _keys(schemas))}")
    if kind == "union_tag_invalid":
        if kinds := [s["properties"]["kind"]["const"] for s in schemas if "kind" in s.get("properties", {})]:
            return ConfigError(source, f"{path}.kind" if path else "kind", value["kind"], suggest(value["kind"], kinds))
        value = next(iter(value))
    return ConfigError(source, path, value, describe_expected(schemas, root, value))


def _path_in_data(data: object, steps: Iterable[Any], at: str) -> str:
    """The path of a location in the data; steps missing in the data, such as those of short forms, are left out."""
    for step, _ in _walk_data(data, steps):
        at = _join_path(at, step)
    return at


def _join_path(path: str, step: Any) -> str:
    """`path` extended by a key (`path.step`) or an index (`path[step]`); unchanged if `step` is None."""
    if step is None:
        return path
    return f"{path}[{step}]" if isinstance(step, int) else f"{path}.{step}" if path else step


def _walk_data(data: Any, steps: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
    for step in steps:
        if (
            step in data
            if isinstance(data, dict)
            else isinstance(step, int) and isinstance(data, list) and step < len(data)
        ):
            data = data[step]
            yield step, data


def _schemas_at(root: Schema, steps: list[Any]) -> list[Schema]:
    """The alternative schemas of the data at a location, found by walking from `root` along keys, indices and tags."""
    schemas = _resolve_alternatives(root, root)
    for step in steps:
        if isinstance(step, str) and step.startswith(TAG):
            schemas = [schema for schema in schemas if _is_tagged(schema, step[len(TAG) :])] or schemas
            continue
        inner = [child for schema in schemas for child in _child_schemas(schema, step)]
        schemas = [form for child in inner for form in _resolve_alternatives(child, root)] or schemas
    return schemas


def _is_tagged(schema: Schema, tag: str) -> bool:
    """Whether a tag of a union means this schema: by its `kind`, or by a key that no other has."""
    named = schema.get("properties", {})
    return tag in named or named.get("kind", {}).get("const") == tag


def _child_schemas(schema: Schema, step: str | int) -> list[Schema]:
    if isinstance(step, int):
        ahead = schema.get("prefixItems", [])
        return [ahead[step]] if step < len(ahead) else [schema["items"]] if schema.get("items") else []
    named = schema.get("properties", {})
    additional = schema.get("additionalProperties")
    return [named[step]] if step in named else [additional] if isinstance(additional, dict) else []


def _resolve_alternatives(schema: Schema, root: Schema) -> list[Schema]:
    """The alternatives of a schema: `$ref` is followed, `anyOf` and `oneOf` are flattened; else the schema alone."""
    if "$ref" in schema:
        return _resolve_alternatives(root["$defs"][schema["$ref"].rpartition("/")[2]], root)
    either = schema.get("anyOf") or schema.get("oneOf")
    return [form for one in either for form in _resolve_alternatives(one, root)] if either else [schema]


def _keys(schemas: list[Schema]) -> list[str]:
    return list(dict.fromkeys(key for schema in schemas for key in schema.get("properties", {})))


def describe_expected(schemas: list[Schema], root: Schema, value: object = None) -> str:
    """Description of valid values at a location.

    Args:
        schemas: Its alternative schemas.
        root: The schema with the definitions.
        value: The present value; a similar valid word is suggested.
    """
    names = list(dict.fromkeys(word for schema in schemas for word in _enum_values(schema)))
    alternatives = [suggest(value, names)] if names else []
    alternatives += [description for schema in schemas if (description := _describe_type(schema, root))]
    if keys := _keys(schemas):
        one = all(len(s["properties"]) == 1 for s in schemas if "properties" in s) and len(keys) > 1
        alternatives.append(f"one of the keys {suggest(value, keys)}" if one else f"keys {', '.join(keys)}")
    return ", or ".join(dict.fromkeys(alternatives))


def _enum_values(schema: Schema) -> list[str]:
    return [schema["const"]] if "const" in schema else list(schema.get("enum", ()))


def _describe_type(schema: Schema, root: Schema) -> str:
    """Description of a number, a list, a text or a truth value; empty for a schema with words or keys."""
    kind = schema.get("type")
    if _enum_values(schema) or "properties" in schema or kind == "null":
        return ""
    if kind in ("number", "integer"):
        return ("a whole number, " if kind == "integer" else "") + _describe_range(schema)
    if kind == "array":
        each = [schema["items"]] if schema.get("items") else schema.get("prefixItems") or [{}]
        items = [describe_expected(_resolve_alternatives(one, root), root) for one in each]
        least, alike = schema.get("minItems", 0), len(set(items)) == 1
        if least and least == schema.get("maxItems"):
            contents = f", each {items[0]}" if alike else f": {', '.join(items)}"
            return f"a list of {_COUNTED.get(least, least)} items{contents}"
        return f"a list with at least one item, each {items[0]}" if least else f"a list of {items[0]}"
    return {"boolean": "true, false", "string": "text", "object": "keys with values"}.get(str(kind), "a value")


def _describe_range(schema: Schema) -> str:
    low, high = schema.get("minimum"), schema.get("maximum")
    if low is not None and high is not None:
        low, high = (str(n) if isinstance(n, int) else f"{n:g}" for n in (low, high))
        return f"{low} to {high}" if low.startswith("-") else f"{low}-{high}"
    if "exclusiveMinimum" in schema:
        return f"a number above {schema['exclusiveMinimum']:g}"
    return f"a number of at least {low:g}" if low is not None else "a number"
