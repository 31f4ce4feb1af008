"""What a scene may hold, generated from its models: a JSON schema for editors, and the reference for people."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ..units import UNITS
from . import toml
from .any_scene import AnyScene
from .scene import Scene

DIALECT = "https://json-schema.org/draft/2020-12/schema"
LIMITS = {
    "ge": ("minimum", "≥"),
    "gt": ("exclusiveMinimum", ">"),
    "le": ("maximum", "≤"),
    "lt": ("exclusiveMaximum", "<"),
}

Json = dict[str, Any]


def scene_schema(scene: type[AnyScene] = Scene) -> Json:
    """Return the JSON schema (draft 2020-12) of a scene file, of particle-in-cell if not said otherwise.

    It knows keys, types, units, choices and limits; how values must fit together, the scene itself checks.
    """
    schema = scene.model_json_schema()
    for part in list(_parts(schema)):
        _tidy(part)
        _name_the_choice(part, schema["$defs"])
    return {"$schema": DIALECT, "title": "amrpic scene", **schema}


def _parts(schema: Any) -> Iterator[Json]:
    """Every schema within a schema, innermost first."""
    children = schema.values() if isinstance(schema, dict) else schema if isinstance(schema, list) else ()
    for child in children:
        yield from _parts(child)
    if isinstance(schema, dict):
        yield schema


def _tidy(part: Json) -> None:
    """Write limits as JSON schema does, and leave out null, which TOML cannot hold, and titles made of keys."""
    for key, (keyword, _) in LIMITS.items():
        if key in part and "type" in part:
            part[keyword] = part.pop(key)
    if isinstance(part.get("title"), str):
        del part["title"]
    if "default" in part:
        part["default"] = _without_null(part["default"])
    if part.get("default", ...) is None:
        del part["default"]
    choices = part.get("anyOf", [])
    if {"type": "null"} in choices:
        choices.remove({"type": "null"})
        if len(choices) == 1:
            part.update({**part.pop("anyOf")[0], **part})


def _without_null(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_null(member) for key, member in value.items() if member is not None}
    return value


def _name_the_choice(part: Json, definitions: Json) -> None:
    """Require the key that distinguishes the members of a union; models have it as a default, a file must write it."""
    if "discriminator" not in part:
        return
    key = part["discriminator"]["propertyName"]
    for reference in part["discriminator"]["mapping"].values():
        member = definitions[_name(reference)]
        member["required"] = sorted({key, *member.get("required", [])})


def _name(reference: str) -> str:
    return reference.rpartition("/")[2]


# ---- the reference ----

TYPES = {
    "integer": "whole number",
    "number": "number",
    "string": "text",
    "boolean": "true or false",
    "object": "table",
}

INTRODUCTION = """# {}

Generated from the scene's models by `make docs`; `amrpic schema --markdown` prints it too. A scene is a TOML file.
Keys in bold must be given. A quantity is a number in SI units, or a string with one of these units:

| quantity | units |
|---|---|
"""


def scene_reference(scene: type[AnyScene] = Scene, title: str = "Scene reference") -> str:
    """Return what a scene may hold as Markdown."""
    schema = scene_schema(scene)
    units = "".join(f"| {kind} | {', '.join(table)} |\n" for kind, table in UNITS.items())
    lines = [INTRODUCTION.format(title) + units, "## The scene\n", *_Reference(schema["$defs"]).lines(schema)]
    return "\n".join(lines).rstrip() + "\n"


class _Reference:
    """Writes the tables of a schema's definitions, each definition once."""

    def __init__(self, definitions: Json) -> None:
        self._definitions = definitions
        self._described: set[str] = set()

    def lines(self, schema: Json) -> Iterator[str]:
        """The keys at the top and all sections below them."""
        yield self._table(schema, schema["properties"])
        yield from self._below("", schema["properties"], 2)

    def _below(self, path: str, properties: Json, depth: int) -> Iterator[str]:
        for key, part in properties.items():
            brackets = "[[{}]]" if part.get("type") == "array" else "[{}]"
            for union, chooser in _unions(part):
                names = [name for name in map(_name, union) if name not in self._described]
                members = {name: self._object(name) for name in names if self._object(name)}
                self._described.update(names)
                if members:
                    where = f"{path}.{key}".lstrip(".")
                    yield from self._section(where, brackets.format(where), members, chooser, depth)

    def _section(self, path: str, title: str, members: Json, chooser: str, depth: int) -> Iterator[str]:
        """A section of one kind, or of several: first the keys that they share, then those of each."""
        yield f"{'#' * depth} `{title}`\n"
        if chooser:
            for kinds, keys in _shared(members, chooser).items():
                owner = members[kinds[0]]
                named = [f"`{_kind(members[name], chooser)}`" for name in kinds]
                of = "every kind" if len(kinds) == len(members) else ", ".join(named)
                yield f"Keys of {of}:\n"
                yield self._table(owner, {key: owner["properties"][key] for key in keys})
        shared = _shared(members, chooser) if chooser else {}
        for name, member in members.items():
            if chooser:
                yield f"{'#' * (depth + 1)} `{title}` with `{chooser} = {_kind(member, chooser)}`\n"
            yield member["description"] + "\n"
            common = {chooser}.union(*(keys for kinds, keys in shared.items() if name in kinds))
            own = {key: part for key, part in member["properties"].items() if key not in common}
            if own:
                yield self._table(member, own)
        below: Json = {}
        for member in members.values():
            below |= member["properties"]
        yield from self._below(path, below, depth + 1)

    def _object(self, name: str) -> Json:
        """The table that a definition allows; empty if it is none."""
        definition = self._definitions[name]
        for part in definition.get("anyOf", [definition]):
            if "properties" in part:
                return part
        return {}

    def _table(self, owner: Json, properties: Json) -> str:
        rows = ["| key | value | default | meaning |", "|---|---|---|---|"]
        for key, part in properties.items():
            name = f"**`{key}`**" if key in owner.get("required", []) else f"`{key}`"
            is_table = "$ref" in part and isinstance(part.get("default"), dict)  # its own table shows its defaults
            default = f"`{toml.text(part['default'])}`" if "default" in part and not is_table else ""
            meaning = part.get("description") or self._definition(part).get("description", "")
            cells = name, self._value(part), default, meaning
            rows.append("| " + " | ".join(" ".join(cell.replace("|", "\\|").split()) for cell in cells) + " |")
        return "\n".join(rows) + "\n"

    def _definition(self, part: Json) -> Json:
        return self._definitions[_name(part["$ref"])] if "$ref" in part else {}

    def _value(self, part: Json) -> str:
        """What a key may be set to, in a few words."""
        if "$ref" in part:
            return self._value(self._definition(part))
        if "const" in part:
            return f"`{toml.text(part['const'])}`"
        if "enum" in part:
            return " or ".join(f"`{toml.text(choice)}`" for choice in part["enum"])
        for union in ("anyOf", "oneOf"):
            if union in part:
                return " or ".join(dict.fromkeys(self._value(kind) for kind in part[union]))
        limits = [f"{sign} {part[keyword]}" for keyword, sign in LIMITS.values() if keyword in part]
        return ", ".join([self._type(part), *limits])

    def _type(self, part: Json) -> str:
        if "unit" in part:
            return f"quantity in {part['unit']}"
        match part.get("type"):
            case "array" if part.get("minItems") is not None and part.get("minItems") == part.get("maxItems"):
                return f"list of {part['minItems']}"
            case "array":
                return f"list of {self._value(part['items'])}"
            case None:
                return "anything"
            case str(name):
                return TYPES[name]
            case names:
                return " or ".join(TYPES[name] for name in names)


def _unions(part: Json) -> Iterator[tuple[list[str], str]]:
    """The definitions that a key may hold, by reference, and the key that distinguishes them if there are several."""
    if "$ref" in part:
        yield [part["$ref"]], ""
    elif "discriminator" in part:
        yield [choice["$ref"] for choice in part["oneOf"]], part["discriminator"]["propertyName"]
    else:
        for choice in [*part.get("anyOf", []), *part.get("oneOf", []), *([part["items"]] if "items" in part else [])]:
            yield from _unions(choice)


def _shared(members: Json, chooser: str) -> dict[tuple[str, ...], list[str]]:
    """The keys that mean the same in several members of a union, by these members."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for name, member in members.items():
        for key, part in member["properties"].items():
            same = tuple(other for other, schema in members.items() if schema["properties"].get(key) == part)
            if len(same) > 1 and same[0] == name and key != chooser:
                groups.setdefault(same, []).append(key)
    return groups


def _kind(member: Json, chooser: str) -> str:
    return toml.text(member["properties"][chooser]["const"])
