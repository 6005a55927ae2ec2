"""JSON Schemas of configuration types; a property is described by the line of its class' docstring."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from functools import cache
from typing import Any

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

_ENTRY = re.compile(r"^    (\w[\w, ]*): (.*(?:\n     +.*)*)", re.MULTILINE)
"""An entry of `Attributes` in a docstring: one or more names, and a text whose further lines are indented more."""


def schema_of(kind: object) -> JsonSchemaValue:
    """The JSON Schema of a type's data in files (dataclass, pydantic model or other)."""
    return _build_schema(kind)


@cache
def _build_schema(kind: Any) -> JsonSchemaValue:
    """Builds the JSON Schema of a type; the cache keeps it for the next call."""
    return TypeAdapter(kind).json_schema(schema_generator=_DescribingGenerator)


def schema_file(kind: object) -> JsonSchemaValue:
    """The JSON Schema of a type's data, as the content of a schema file."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema"} | schema_of(kind)


def attribute_descriptions(kind: type) -> Mapping[str, str]:
    """Description of each attribute, from the `Attributes` in the docstrings of a class and its base classes."""
    descriptions: dict[str, str] = {}
    for base in reversed(kind.__mro__):  # the class itself comes last, so that its descriptions count
        section = (inspect.cleandoc(base.__dict__.get("__doc__") or "")).partition("Attributes:\n")[2]
        for names, text in _ENTRY.findall(section):
            descriptions |= {name.strip(): " ".join(text.split()) for name in names.split(",")}
    return descriptions


class _DescribingGenerator(GenerateJsonSchema):
    """Generates schemas with a description for each property, and the first line of a docstring for each class."""

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        """The JSON Schema of a pydantic model, with descriptions of its fields."""
        return self._add_descriptions(super().model_schema(schema), schema["cls"], schema["schema"])

    def dataclass_schema(self, schema: core_schema.DataclassSchema) -> JsonSchemaValue:
        """The JSON Schema of a dataclass, with descriptions of its fields."""
        return self._add_descriptions(super().dataclass_schema(schema), schema["cls"], schema["schema"])

    def _add_descriptions(self, schema: JsonSchemaValue, kind: type, inner: Any) -> JsonSchemaValue:
        """Adds the first paragraph of a class's docstring, and the description of each attribute, to its schema.

        Defaults that a file could not have, as they are in another unit or no word of the file, are removed.

        Args:
            schema: The schema that pydantic has made.
            kind: The class.
            inner: Pydantic's schema of the class, which has the names of its fields and keys.
        """
        doc = inspect.cleandoc(kind.__dict__.get("__doc__") or "")
        schema.pop("description", None)
        if doc and not doc.startswith(f"{kind.__name__}("):  # not the one that `dataclass` makes of the signature
            schema["description"] = " ".join(doc.split("\n\n")[0].split())
        descriptions = attribute_descriptions(kind)
        for name, key in _keys(inner):
            prop = schema.get("properties", {}).get(key)
            if isinstance(prop, dict):
                prop.pop("title", None)
                # a key of another name, such as `riser_mm`, has another unit than the attribute
                has_other_unit = key != name
                # where a file has words, a default that is none of them is the value that a word stands for
                default = prop.get("default")
                is_no_word = default not in prop.get("enum", [default])
                if has_other_unit or is_no_word:
                    prop.pop("default", None)
                if name in descriptions:
                    prop["description"] = descriptions[name]
        return schema


def _keys(schema: Any) -> list[tuple[str, str]]:
    """Attribute and key in the file of each field of a class.

    Args:
        schema: Pydantic's schema of the class. The fields are in it or in a schema inside it: as a mapping by attribute
            for a model, as a list of fields with names for a dataclass.
    """
    while "fields" not in schema and "schema" in schema:
        schema = schema["schema"]
    fields = schema.get("fields", [])
    by_name = fields.items() if isinstance(fields, dict) else [(f["name"], f) for f in fields]
    return [(name, str(f.get("validation_alias") or name)) for name, f in by_name]
