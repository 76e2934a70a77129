"""The part of JSON Schema that config/json_topics.json uses; other keywords are an error."""

import json
from functools import cache
from pathlib import Path

FILE = Path(__file__).parents[2] / "config" / "json_topics.json"
_TYPES = {"object": dict, "array": list, "string": str, "boolean": bool, "null": type(None),
          "integer": int, "number": (int, float)}  # fmt: skip
_KNOWN = {"$ref", "additionalProperties", "anyOf", "description", "enum", "items", "maxItems",
          "maximum", "minItems", "minimum", "properties", "required", "type"}  # fmt: skip


@cache
def topics():
    """Schemas by the end of a topic's name."""
    return json.loads(FILE.read_text())["properties"]


def check(topic, text):
    """Check a message on a topic. AssertionError: its schema does not allow it; topics without a
    schema carry no JSON."""
    for end, schema in topics().items():
        if f"/{topic}".endswith(f"/{end}"):
            found = list(faults(json.loads(text), schema))
            assert not found, f"{topic}: {found}"


def faults(value, schema, where="it"):
    """Violations of a schema, one line each."""
    assert schema.keys() <= _KNOWN, schema.keys() - _KNOWN
    if "$ref" in schema:
        yield from faults(value, _defined()[schema["$ref"].rpartition("/")[2]], where)
    kinds = schema.get("type", [])
    kinds = [kinds] if isinstance(kinds, str) else kinds
    if kinds and not any(_is(value, kind) for kind in kinds):
        yield f"{where} is {value!r:.60}, expected {kinds}"
        return
    if "enum" in schema and value not in schema["enum"]:
        yield f"{where} is {value!r:.60}, expected one of {schema['enum']}"
    if "anyOf" in schema and all([*faults(value, one, where)] for one in schema["anyOf"]):
        yield f"{where} is none of {len(schema['anyOf'])}"
    if isinstance(value, (int, float)) and (
        not schema.get("minimum", value) <= value <= schema.get("maximum", value)
    ):
        yield f"{where} is {value}"
    if isinstance(value, list):
        if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value)):
            yield f"{where} has {len(value)} items"
        for k, item in enumerate(value):
            yield from faults(item, schema.get("items", {}), f"{where}[{k}]")
    if isinstance(value, dict):
        lacking = [name for name in schema.get("required", ()) if name not in value]
        yield from (f"{where} lacks {name}" for name in lacking)
        own, others = schema.get("properties", {}), schema.get("additionalProperties", {})
        for name, item in value.items():
            if name not in own and others is False:
                yield f"{where} has {name}"
            else:
                yield from faults(item, own.get(name, others or {}), f"{where}.{name}")


def _is(value, kind):
    return isinstance(value, _TYPES[kind]) and (kind == "boolean" or not isinstance(value, bool))


@cache
def _defined():
    return json.loads(FILE.read_text())["$defs"]
