"""Reads payloads with pydantic into plain dicts, so that a message of a gait makes fewer objects.

`schemas.command` stays the only source: a validator here is a model's core schema with a dict in place of each model.
It accepts the same payloads and reports the same errors, with two exceptions. A value that is no object gets the error
`dict_type` instead of `model_type` (`intake.explain` treats both alike). An unknown name given twice is two errors.
"""

from typing import Any

from pydantic import BaseModel
from pydantic_core import SchemaValidator


def into_dicts(model: type[BaseModel]) -> SchemaValidator:
    """Return a validator of the model's payloads. Its `validate_json` returns dicts, with the defaults filled in.

    The model has neither validating functions nor computed fields.
    """
    return SchemaValidator(_without_models(model.__pydantic_core_schema__))


def _without_models(node: Any) -> Any:
    if isinstance(node, list | tuple):
        return type(node)(map(_without_models, node))
    if not isinstance(node, dict):
        return node
    if node.get("type") != "model":
        return {name: part if name == "metadata" else _without_models(part) for name, part in node.items()}
    schemas = {name: field["schema"] for name, field in node["schema"]["fields"].items()}
    return {
        "type": "typed-dict",
        "fields": {
            name: {
                "type": "typed-dict-field",
                "schema": _without_models(schema),
                "required": schema["type"] != "default",
            }
            for name, schema in schemas.items()
        },
        "config": node["config"],  # it has `strict`, and forbids further fields
        "ref": node["ref"],
    }
