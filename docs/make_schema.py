"""The schema of scene files as JSON, for editors.

``python docs/make_schema.py`` writes scenes/scene.schema.json. It describes a file, not a resolved
scene: ``base`` and ``body.recipe`` may supply anything, so nothing is required, and a step's forces
may be given as a table.
"""

from __future__ import annotations

import json

from twin.files import SCENES
from twin.parts.press import BY_AXIS
from twin.parts.scene import Scene

SCHEMA_FILE = SCENES / "scene.schema.json"


def _schema_text() -> str:
    """Return the schema file's text: the JSON schema (draft 2020-12) of a scene file."""
    schema = Scene.model_json_schema()
    for definition in [schema, *schema["$defs"].values()]:
        definition.pop("required", None)
        if "description" in definition:  # Python's examples are not for recipes
            definition["description"] = definition["description"].partition("\n\nExamples\n")[0]
    schema["properties"]["base"] = {
        "type": "string",
        "description": "scene to inherit from, which may have a base itself",
    }
    recipe = {"type": "string", "description": "body recipe of the meshes folder"}
    for name in ("Block", "Dome", "Finger", "Solid"):
        schema["$defs"][name]["properties"]["recipe"] = recipe
    schema["$defs"]["Camera"]["properties"]["intrinsics"] = {
        "type": "string",
        "description": "file of size, focal length, principal point and distortion as OpenCV writes it (YAML, JSON)",
    }
    schema["properties"]["body"] = {"anyOf": schema["properties"]["body"]["oneOf"]}
    axes = {
        "type": "object",
        "additionalProperties": False,
        "properties": {a: {"type": "number"} for a in "xyz"},
    }
    for name, keys in (("Step", BY_AXIS), ("Press", ("force_n", "tilt_deg"))):
        properties = schema["$defs"][name]["properties"]
        properties.update({key: {"anyOf": [axes, properties[key]]} for key in keys})
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "twin scene"}
    return json.dumps({**head, **schema}, indent=1) + "\n"


if __name__ == "__main__":
    SCHEMA_FILE.write_text(_schema_text())
