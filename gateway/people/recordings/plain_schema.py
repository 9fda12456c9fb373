"""JSON Schemas that viewers understand, from those of pydantic.

Foxglove and Lichtblick read no `$ref`, no `anyOf` and no null: a channel whose schema has any of them is not shown.
So references are resolved, what may be null is left out of the message where it is null (`without_nulls`) and is
optional in the schema, and a choice becomes what its alternatives have in common.
"""

from collections.abc import Mapping
from typing import Any, Final

from pydantic import TypeAdapter

Schema = dict[str, Any]

_CHOICES: Final = ("anyOf", "oneOf", "allOf")
_UNREAD: Final = frozenset({"$defs", "default", "discriminator", "prefixItems", "propertyNames", *_CHOICES})


def plain_schema(adapter: TypeAdapter[Any], title: str) -> Schema:
    """The schema of a payload, with each type named by one word."""
    schema = adapter.json_schema(mode="validation")
    return {**_plain(schema, schema.get("$defs", {})), "title": title}


def without_nulls(value: Any) -> Any:
    """A JSON value without the members of objects that are null."""
    if isinstance(value, dict):
        return {name: without_nulls(member) for name, member in value.items() if member is not None}
    if isinstance(value, list):
        return [without_nulls(member) for member in value]
    return value


def _plain(schema: Schema, named: Mapping[str, Schema]) -> Schema:
    reference = schema.get("$ref")
    if reference is not None:
        schema = {**named[reference.rpartition("/")[2]], **schema}
    found = {name: value for name, value in schema.items() if name not in _UNREAD and name != "$ref"}
    for choice in _CHOICES:
        if choice in schema:
            found = {**_common([_plain(each, named) for each in schema[choice]]), **found}
    if "prefixItems" in schema:
        found["items"] = _common([_plain(each, named) for each in schema["prefixItems"]])
    elif "items" in schema:
        found["items"] = _plain(schema["items"], named)
    if found.get("type") == "object":
        members = schema.get("properties", found.get("properties", {}))
        found["properties"] = {name: _plain(member, named) for name, member in members.items()}
        found["required"] = [
            name for name in found.get("required", ()) if not (name in members and _may_be_null(members[name]))
        ]
        if isinstance(found.get("additionalProperties"), dict):
            found["additionalProperties"] = _plain(found["additionalProperties"], named)
    return found


def _may_be_null(schema: Schema) -> bool:
    return any(each.get("type") == "null" for choice in _CHOICES for each in schema.get(choice, ()))


def _common(alternatives: list[Schema]) -> Schema:
    """What all alternatives but null allow, and no less than any of them."""
    some = [each for each in alternatives if each.get("type") != "null"]
    if all(each == some[0] for each in some):
        return some[0]
    types = {each.get("type") for each in some}
    if types == {"object"}:
        members = {name: _common(_members(some, name)) for each in some for name in each["properties"]}
        required = set.intersection(*(set(each["required"]) for each in some))
        return {"type": "object", "properties": members, "required": sorted(required)}
    if types <= {"integer", "number"}:
        return {"type": "number"}
    if len(types) == 1:
        return {"type": types.pop()}
    raise ValueError(f"viewers cannot be told of a choice between {sorted(map(str, types))}")


def _members(objects: list[Schema], name: str) -> list[Schema]:
    return [each["properties"][name] for each in objects if name in each["properties"]]
