"""JSON Schemas of dataclasses, with descriptions of their keys."""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from typing import Annotated, Any, TypeAlias, get_args, get_origin

from imucal.arrays import FloatArray, IntArray
from imucal.report.typed_json import Key, choices_of, hints_of, is_optional, without_none

__all__ = ["Schema", "SchemaWriter", "chosen"]

Schema: TypeAlias = dict[str, Any]


@dataclass(frozen=True)
class SchemaWriter:
    """Writes schemas of dataclasses.

    `parts` are dataclasses with a definition of their own, by name. `descriptions` are those of keys, by the
    name of a part, or by the class of an object in a part.
    """

    parts: Mapping[str, Any]
    descriptions: Mapping[str, Mapping[str, str]]

    @classmethod
    def of(cls, parts: Mapping[str, Any], *, file_name: str) -> "SchemaWriter":
        """Return the writer with the descriptions of a TOML file next to this one."""
        text = Path(__file__).with_name(file_name).read_text(encoding="utf-8")
        return cls(parts, tomllib.loads(text))

    def definitions(self) -> dict[str, Schema]:
        """Return the schema of each part."""
        return {name: self.object_schema(kind, name) for name, kind in self.parts.items()}

    def object_schema(self, kind: Any, name: str) -> Schema:  # noqa: ANN401 - any dataclass
        """Return the schema of a dataclass with the descriptions below `name`."""
        descriptions = self.descriptions.get(name, {})
        hints = hints_of(kind)
        if unknown := set(descriptions) - set(hints):
            raise ValueError(f"the descriptions of {name} have {', '.join(unknown)}, which is no key of it")
        properties = {}
        for key, hint in hints.items():
            description = {"description": descriptions[key]} if key in descriptions else {}
            properties[key] = description | self._schema(hint)
        return {"type": "object", "required": list(properties), "properties": properties}

    def _schema(self, hint: Any, key: Key = Key()) -> Schema:  # noqa: ANN401, B008 - any type; a key is immutable
        if get_origin(hint) is Annotated:
            return self._schema(hint.__origin__, hint.__metadata__[0])
        if is_optional(hint):
            return _or_null(self._schema(without_none(hint), Key(null=None)))
        for name, kind in self.parts.items():
            if kind is hint:
                return {"$ref": f"#/$defs/{name}"}
        if is_dataclass(hint):
            return self.object_schema(hint, hint.__name__)  # type: ignore[union-attr]
        if get_origin(hint) in {tuple, Mapping}:
            return self._container(hint)
        return _simple(hint, key)

    def _container(self, hint: object) -> Schema:
        inner = get_args(hint)
        if get_origin(hint) is Mapping:
            items: Schema = {} if inner[1] is object else {"additionalProperties": self._schema(inner[1])}
            return {"type": "object"} | items
        sizes = {} if inner[-1] is ... else {"minItems": len(inner), "maxItems": len(inner)}
        return {"type": "array", "items": self._schema(inner[0])} | sizes


def chosen(properties: Schema, names: list[str]) -> Schema:
    """Return some properties, all of them required."""
    return {"required": names, "properties": {name: properties[name] for name in names}}


def _or_null(schema: Schema) -> Schema:
    if "type" in schema:
        return schema | {"type": [schema["type"], "null"]}
    return {"anyOf": [schema, {"type": "null"}]}


def _simple(hint: Any, key: Key) -> Schema:  # noqa: ANN401 - any type
    if hint in (FloatArray, IntArray):
        return {"type": "array", "items": _simple(float if hint == FloatArray else int, key)}
    if hint in (float, int):
        number: Schema = {"type": "number" if hint is float else "integer"}
        limits = {"exclusiveMinimum": key.above, "exclusiveMaximum": key.below, "minimum": key.least}
        number |= {name: limit for name, limit in limits.items() if math.isfinite(limit)}
        return _or_null(number) if hint is float and key.null is not None else number
    choices = choices_of(hint, key)
    return {"enum": list(choices)} if choices else {"type": "string"}
