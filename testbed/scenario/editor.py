"""The page described for editors."""

from __future__ import annotations

from typing import Any

from testbed.scenario.pattern import Pattern
from testbed.scenario.schema import Scenario


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of a page, for completion and hints in an editor.

    A page that extends another may leave out whatever the other says, so nothing is marked as
    required except the tags that tell kinds apart; reading the page is what decides.
    """
    schema: dict[str, Any] = _relaxed(Scenario.model_json_schema(by_alias=True))
    pattern = _relaxed(Pattern.model_json_schema(by_alias=True))
    schema["$defs"] |= {**pattern.pop("$defs"), "Pattern": pattern}
    listed = schema["properties"]["fleet"]
    schema["properties"]["fleet"] = {
        **{key: listed.pop(key) for key in ("title", "description")},
        "anyOf": [listed, {"$ref": "#/$defs/Pattern"}],
    }
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "Testbed scenario"
    schema["properties"] = {
        "extends": {
            "type": "string",
            "title": "Extends",
            "description": "Name or path of a scenario that this page changes: maps merge, "
            "lists and scalars replace, null takes a key away; question, expectation and published "
            "numbers are not had under another name.",
        },
        **schema["properties"],
    }
    return schema


def _relaxed(schema: Any) -> Any:  # noqa: ANN401 - nested plain data
    if isinstance(schema, list):
        return [_relaxed(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    relaxed = {key: _relaxed(value) for key, value in schema.items() if key != "required"}
    tags = [key for key in schema.get("required", ()) if key in ("kind", "example")]
    return {**relaxed, "required": tags} if tags else relaxed
