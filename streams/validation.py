"""Validates data of a file against a pydantic type: all errors at once, one per line, with the expected values.

The expected values come from the type's JSON Schema, the only description of fields, ranges and words.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from stridetwin.streams.errors import ConfigError, ConfigFileError, Missing, StrideTwinError
from stridetwin.streams.fields import TAG
from stridetwin.streams.json_schema import schema_of

T = TypeVar("T")
_MISSING = ("missing", "missing_keyword_only_argument", "missing_argument")
"""pydantic's kinds of an error about a key that is missing."""
_UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument", "invalid_key")
"""pydantic's kinds of an error about a key that is not known."""
_COUNTED = {2: "two", 3: "three", 4: "four"}  # numbers of items as words; others stay digits
_Schema = Mapping[str, Any]
"""A JSON Schema, or a part of one."""
_Step = str | int
"""A key, the tag of a union's member, or the index of an item: one step from a value in a file to one inside it."""


def validate(
    kind: type[T], data: object, source: object, *, at: str = "", context: Mapping[str, object] | None = None
) -> T:
    """Builds an object of a type from the plain data of a file, and reports all invalid values at once.

    Args:
        kind: Dataclass, pydantic model or other type.
        data: Data of a file.
        source: File, for errors.
        at: Path of the data inside the file.
        context: Further input of validators, such as the `folder` that paths in the file are relative to.

    Raises:
        ConfigError: One line for each error (`ConfigFileError` if there are several).
    """
    try:
        return type_adapter(kind).validate_python(data, context=context)
    except ValidationError as error:
        root = schema_of(kind)
        errors = (_to_error(entry, root, data, source, at) for entry in error.errors(include_url=False))
        raise combine_errors(e for e in errors if e is not None) from None  # None: it only repeats another error


def type_adapter(kind: type[T]) -> TypeAdapter[T]:
    """The validator of a type, built once."""
    adapter: TypeAdapter[T] = _build_adapter(kind)  # type: ignore[arg-type]  # classes are hashable
    return adapter


@cache
def _build_adapter(kind: Any) -> TypeAdapter[Any]:
    """Builds the validator of a type; the cache keeps it for the next call."""
    return TypeAdapter(kind)


def combine_errors(errors: Iterable[StrideTwinError]) -> StrideTwinError:
    """One error from several (at least one): the only one, or a `ConfigFileError` without repeated messages."""
    unique = list({str(e): e for e in errors}.values())
    return unique[0] if len(unique) == 1 else ConfigFileError(unique)


def suggest(value: object, names: Iterable[str]) -> str:
    """The valid names, separated by commas; a name similar to `value` is suggested after `did you mean`."""
    names = list(names)
    near = difflib.get_close_matches(str(value), names, n=1)
    return ", ".join(names) + (f" (did you mean {near[0]!r}?)" if near else "")


def _to_error(entry: ErrorDetails, root: _Schema, data: object, source: object, at: str) -> StrideTwinError | None:
    """The error of one entry of a pydantic error.

    Args:
        entry: Kind of error, location (keys, indices and tags from the top), invalid value and context.
        root: JSON Schema of the whole file.
        data: Data of the file.
        source: File, for the message.
        at: Path of the data inside the file.

    Returns:
        The error; None if the entry only repeats others, as that of a list whose items have failed.
    """
    kind, steps, value, context = entry["type"], list(entry["loc"]), entry["input"], entry.get("ctx", {})
    if kind == "elsewhere":  # an error in another file, of `fields.other_file_error`
        error: StrideTwinError = context["error"]
        return error
    if kind == "too_short" and value:  # a list that counts as too short because its items have failed
        return None
    key = steps.pop() if kind in _MISSING + _UNKNOWN else None  # the missing or unknown key, or a surplus index
    # the steps that exist in the data, each with the value there; `below` are further ones from `fields.field_error`
    nodes = list(_walk_data(data, [*steps, *context.get("below", ())]))
    path = _join_path(at, *(step for step, _ in nodes))
    schemas = _schemas_at(root, steps)  # alternatives for the value that the entry is about
    if kind == "refused":  # by a validator, with `fields.field_error`
        # a missing key is not in the data, hence not in the path: it is the last of `below`
        absent = context["below"][-1:] if isinstance(context["value"], Missing) else ()
        return ConfigError(source, _join_path(path, *absent), context["value"], context["valid"])
    if isinstance(key, int):  # an item too few or too many in a list of fixed length
        return ConfigError(source, path, nodes[-1][1] if nodes else data, _describe_expected(schemas, root))
    if key is not None and kind in _MISSING:
        expected = _describe_expected(_schemas_at(root, [*steps, key]), root)
        return ConfigError(source, _join_path(path, key), Missing(), expected)
    if key is not None:  # an unknown key
        return ConfigError(source, path, key, f"keys {suggest(key, _keys(schemas))}")
    if kind == "union_tag_invalid":  # a `fields.OneKind` of an unknown kind, or a `fields.OneKey` of an unknown key
        if kinds := [s["properties"]["kind"]["const"] for s in schemas if "kind" in s.get("properties", {})]:
            return ConfigError(source, _join_path(path, "kind"), value["kind"], suggest(value["kind"], kinds))
        value = next(iter(value))  # a mapping of one key: the key is invalid
    return ConfigError(source, path, value, _describe_expected(schemas, root, value))


def _join_path(path: str, *steps: _Step) -> str:
    """`path` extended by keys (`path.step`) and indices (`path[step]`)."""
    for step in steps:
        if isinstance(step, int):
            path = f"{path}[{step}]"
        elif path:
            path = f"{path}.{step}"
        else:
            path = step
    return path


def _walk_data(data: Any, steps: Iterable[_Step]) -> Iterator[tuple[_Step, object]]:
    """Yields each step that the data have, with what is there, on the way down from `data`.

    Steps that the data do not have are passed over: tags, and keys that a file in a short form leaves out.
    """
    for step in steps:
        is_key = isinstance(data, dict) and step in data
        is_index = isinstance(data, list) and step in range(len(data))
        if is_key or is_index:
            data = data[step]
            yield step, data


def _schemas_at(root: _Schema, steps: Iterable[_Step]) -> list[_Schema]:
    """The alternative schemas of the data at a location, found by walking from `root` along keys, indices and tags.

    A step that none of the schemas knows is passed over.
    """
    schemas = _alternatives(root, root)
    for step in steps:
        if isinstance(step, str) and step.startswith(TAG):  # a tag selects among the alternatives
            below = [schema for schema in schemas if _is_tagged(schema, step[len(TAG) :])]
        else:
            children = [child for schema in schemas for child in _children(schema, step)]
            below = [alternative for child in children for alternative in _alternatives(child, root)]
        schemas = below or schemas
    return schemas


def _is_tagged(schema: _Schema, tag: str) -> bool:
    """Whether a tag of a union means this schema: by its `kind`, or by a key that no other has."""
    properties = schema.get("properties", {})
    return tag in properties or properties.get("kind", {}).get("const") == tag


def _children(schema: _Schema, step: _Step) -> Sequence[_Schema]:
    """The schema of the item or value at one step, in a list; empty if the schema has no such place."""
    match schema:
        case {"prefixItems": items} if step in range(len(items)):  # a list with a schema for each place
            return [items[step]]
        case {"items": dict(every_item)} if isinstance(step, int):
            return [every_item]
        case {"properties": properties} if step in properties:  # a mapping with a schema for each key
            return [properties[step]]
        case {"additionalProperties": dict(every_value)} if isinstance(step, str):
            return [every_value]
    return []


def _alternatives(schema: _Schema, root: _Schema) -> list[_Schema]:
    """The alternatives of a schema: `$ref` is followed, `anyOf` and `oneOf` are flattened; else the schema alone."""
    match schema:
        case {"$ref": name}:  # `#/$defs/NAME`
            return _alternatives(root["$defs"][name.rpartition("/")[2]], root)
        case {"anyOf": forms} | {"oneOf": forms}:
            return [alternative for form in forms for alternative in _alternatives(form, root)]
    return [schema]


def _keys(schemas: Iterable[_Schema]) -> list[str]:
    """The keys that any of the schemas allows, each once."""
    return list(dict.fromkeys(key for schema in schemas for key in schema.get("properties", {})))


def _describe_expected(schemas: Sequence[_Schema], root: _Schema, value: object = None) -> str:
    """Description of valid values: words, then types with ranges, then keys, as far as the schemas have them.

    Args:
        schemas: Alternative schemas of the value.
        root: Schema of the whole file, which has the definitions.
        value: The present value; a similar word or key is suggested.
    """
    choices: list[str] = []  # the valid words of all schemas
    for schema in schemas:
        choices += [schema["const"]] if "const" in schema else schema.get("enum", [])
    alternatives = [suggest(value, dict.fromkeys(choices))] if choices else []
    alternatives += [description for schema in schemas if (description := _describe_type(schema, root))]
    if keys := _keys(schemas):
        # mappings of one key each (`fields.OneKey`): one of the keys is valid, not all together
        has_one_key = all(len(s["properties"]) == 1 for s in schemas if "properties" in s) and len(keys) > 1
        alternatives.append(f"one of the keys {suggest(value, keys)}" if has_one_key else f"keys {', '.join(keys)}")
    return ", or ".join(dict.fromkeys(alternatives))


def _describe_type(schema: _Schema, root: _Schema) -> str:
    """Description of a number, a list, a text or a truth value; "" for a schema with words or keys, and for null."""
    match schema:
        case {"const": _} | {"enum": _} | {"properties": _} | {"type": "null"}:
            return ""
        case {"type": "integer"}:
            return f"a whole number, {_describe_range(schema)}"
        case {"type": "number"}:
            return _describe_range(schema)
        case {"type": "array"}:
            return _describe_list(schema, root)
    names = {"boolean": "true, false", "string": "text", "object": "keys with values"}
    return names.get(str(schema.get("type")), "a value")


def _describe_list(schema: _Schema, root: _Schema) -> str:
    """Description of a list: its length if it is fixed, or else the least one if there is any; and its items."""
    # schemas of the items: one for all, or one for each place, or one that allows anything
    item_schemas = [schema["items"]] if schema.get("items") else schema.get("prefixItems") or [{}]
    items = [_describe_expected(_alternatives(item_schema, root), root) for item_schema in item_schemas]
    match schema:
        case {"minItems": least, "maxItems": most} if least == most:  # of fixed length
            contents = f", each {items[0]}" if len(set(items)) == 1 else f": {', '.join(items)}"
            return f"a list of {_COUNTED.get(least, least)} items{contents}"
        case {"minItems": least}:
            count = "one item" if least == 1 else f"{_COUNTED.get(least, least)} items"
            return f"a list with at least {count}, each {items[0]}"
    return f"a list of {items[0]}"


def _describe_range(schema: _Schema) -> str:
    """Description of a number by its least and largest value."""
    match schema:
        case {"minimum": low, "maximum": high}:
            least, most = (str(n) if isinstance(n, int) else f"{n:g}" for n in (low, high))
            return f"{least} to {most}" if least.startswith("-") else f"{least}-{most}"  # no hyphen after a minus sign
        case {"exclusiveMinimum": low}:
            return f"a number above {low:g}"
        case {"minimum": low}:
            return f"a number of at least {low:g}"
    return "a number"
