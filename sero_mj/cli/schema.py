"""JSON schemas of robot, group, scene and scenario files, for editors: `check --schema`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from .listing import field_rows, scenario_tables, scene_tables

if TYPE_CHECKING:
    from ..base.declaration import Declaration

KINDS = ("robot", "group", "scene", "scenario")
Schema = dict[str, Any]


def schema_text(kind: str) -> str:
    """Returns the JSON schema of a kind of file as text."""
    return json.dumps(schema_of(kind), indent=1) + "\n"


def schema_of(kind: str) -> Schema:
    """Returns the JSON schema of a kind of file, which is one of `KINDS`."""
    definitions = _Definitions()
    sections = {
        "robot": lambda: definitions.fields("SerialRobot"),
        "group": lambda: _group_sections(definitions),
        "scene": lambda: _scene_sections(definitions),
        "scenario": lambda: _scene_sections(definitions) | _scenario_sections(definitions),
    }[kind]()
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": f"sero-mj {kind}",
        "type": "object",
        "additionalProperties": False,
        "properties": sections,
        "definitions": definitions.schemas,
    }


class _Definitions:
    """The JSON schemas of all declarations by class name, with descriptions of the fields."""

    def __init__(self) -> None:
        from pydantic.json_schema import models_json_schema

        tables = {**scene_tables(), **scenario_tables()}
        classes = {declaration.__name__: declaration for declaration in tables.values()}
        models: Any = [(each, "validation") for each in classes.values()]
        _, found = models_json_schema(
            models, schema_generator=_generator(), ref_template="#/definitions/{model}"
        )
        self.schemas: dict[str, Schema] = found["$defs"]
        for name, schema in self.schemas.items():
            schema.pop("description", None)
            declaration = classes.get(name)
            if declaration is None:
                continue
            names = {key: field.alias or key for key, field in declaration.model_fields.items()}
            for key, _, about in field_rows(declaration):
                if about:
                    schema["properties"][names[key]]["description"] = about

    def fields(self, name: str, /, **changed: Schema | None) -> dict[str, Schema]:
        """Returns the schemas of a declaration's fields.

        `changed` contains additional schemas, and None for fields to omit.
        """
        fields = {**self.schemas[name]["properties"], **changed}
        return {key: schema for key, schema in fields.items() if schema is not None}

    def table(self, name: str, /, **changed: Schema | None) -> Schema:
        fields = self.fields(name, **changed)
        return {"type": "object", "additionalProperties": False, "properties": fields}

    def of_kind(self, kinds: Mapping[str, type[Declaration]]) -> Schema:
        choices = []
        for kind, declaration in kinds.items():
            schema = self.table(declaration.__name__, name=None, kind={"const": kind})
            choices.append({**schema, "title": kind, "required": ["kind"]})
        return {"type": "object", "oneOf": choices}


def _sources() -> dict[str, type[Declaration]]:
    from ..base.plugins import SOURCES, load_plugin, plugins

    return {kind: load_plugin(SOURCES, kind) for kind in plugins(SOURCES)}


def _each(schema: Schema, of: str) -> Schema:
    about = f"tables [{of}.NAME]"
    return {"type": "object", "additionalProperties": schema, "description": about}


_TEXT: Schema = {"type": "string"}
_MODEL: Schema = {"type": "string", "description": "included name, folder or file"}
_ARGUMENTS: Schema = {"type": "object", "description": "xacro arguments of the model by name"}


def _group_sections(definitions: _Definitions) -> dict[str, Schema]:
    table = definitions.table
    # Nested groups override fields of their members in nested tables.
    members: Schema = {"type": "object"}
    group = table("Group", name=None, model=_MODEL, groups=members, objects=members)
    group["properties"]["robots"] = {"type": ["array", "object"]}
    group["properties"]["base_frame"] = definitions.fields("SerialRobot")["base_frame"]
    group["properties"] |= {
        key: definitions.fields("SerialRobot")[key] for key in ("mount", "mirrored")
    }
    sections = {
        "robots": _each(
            table("SerialRobot", name=None, model=_MODEL, arguments=_ARGUMENTS), "robots"
        ),
        "groups": _each(group, "groups"),
        "objects": _each(table("Object", name=None), "objects"),
    }
    defaults = definitions.fields("Group", name=None, robots=None)
    return {
        "description": _TEXT,
        "members": {
            "type": "array",
            "items": _TEXT,
            "description": "robots in the order of the group",
        },
        **defaults,
        **sections,
    }


def _scene_sections(definitions: _Definitions) -> dict[str, Schema]:
    table, group = definitions.table, _group_sections(definitions)
    route = {"type": ["string", "object"], "description": "SOURCE.EVENT or a table with `from`"}
    return {
        "name": _TEXT,
        "description": _TEXT,
        "note": {**_TEXT, "description": "a note about the data, shown with the legend"},
        "floor": {"enum": [True, False, "below"]},
        "robots": group["robots"],
        "groups": group["groups"],
        "sources": _each(definitions.of_kind(_sources()), "sources"),
        "routes": {"type": "object", "additionalProperties": route,
                   "description": '"ROBOT.INPUT" = "SOURCE.EVENT"'},
        "doubles": _each(table("Double", name=None), "doubles"),
        "arrows": _each(table("SmartArrow", name=None), "arrows"),
        "frames": _each(table("ReceivedFrame", name=None), "frames"),
        "objects": group["objects"],
        "cameras": _each(table("Camera"), "cameras"),
        "lights": _each(table("Light"), "lights"),
        "view": table("View"),
        "toggles": table("SceneToggles"),
        "decor": _each({"type": "object", "properties": {"show": {"type": "boolean"}}}, "decor"),
    }  # fmt: skip


def _scenario_sections(definitions: _Definitions) -> dict[str, Schema]:
    from ..simulate.control.make_controller import controller_kinds
    from ..simulate.control.plan import target_motion_kinds
    from ..simulate.disturbances import DISTURBANCES, FAULTS
    from ..simulate.sensors import SIGNALS

    table, of_kind = definitions.table, definitions.of_kind
    motions = of_kind(target_motion_kinds())
    for motion in motions["oneOf"]:
        if motion["title"] == "recorded":  # scenarios name a recording instead of values
            motion["properties"] |= {"file": _TEXT, "of": _TEXT}
    sensor = table("SensorErrors")
    sensors = {"type": "object", "additionalProperties": False,
               "properties": dict.fromkeys(SIGNALS, sensor)}  # fmt: skip
    return {
        "scene": {**_TEXT, "description": "scene of another file: file or included name"},
        "extends": {**_TEXT, "description": "scenario to extend: file or included name"},
        "set": {
            "type": "object",
            "description": "overrides of the extended scenario by dotted key",
        },
        "run": table("Run"),
        "controllers": _each(of_kind(controller_kinds()), "controllers"),
        "targets": _each(motions, "targets"),
        "sensors": _each(sensors, "sensors"),
        "disturbances": _each(of_kind(DISTURBANCES), "disturbances"),
        "faults": _each(of_kind(FAULTS), "faults"),
        "monitor": table("Monitor"),
        "expect": _each(table("Expect"), "expect"),
    }


def _generator() -> Any:
    import numpy as np
    from pydantic.json_schema import GenerateJsonSchema

    class Generator(GenerateJsonSchema):
        ignored_warning_kinds = {"skipped-choice", "non-serializable-default"}

        def is_instance_schema(self, schema: Any) -> Schema:
            if schema["cls"] is np.ndarray:
                return {"type": ["number", "array"]}
            return {"type": "object"}

    return Generator
