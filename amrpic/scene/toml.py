"""TOML beyond what the standard library does: writing it, and overriding single values."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any

from ..errors import SceneError


def dumps(data: Mapping[str, Any]) -> str:
    """Return `data` as TOML that reads back equal; mappings in lists become [[tables]]."""
    lines: list[str] = []
    _table(data, (), lines)
    return "\n".join(lines).strip() + "\n"


def override(data: dict[str, Any], assignments: Iterable[str]) -> None:
    """Set values in nested mappings and lists in place: each assignment is `a.b.0.c=value`, its value in TOML.

    A value that is not TOML is taken as a string, so that quotes are not needed on a command line.
    """
    for assignment in assignments:
        path, equals, text = assignment.partition("=")
        keys = [key for key in re.split(r"[.\[\]]+", path.strip()) if key]
        if not equals or not keys:
            raise SceneError(f"--set {assignment}: is no assignment; write it as --set solver.tolerance=1e-8")
        holder = data
        for key, following in pairwise(keys):
            holder = _enter(holder, key, [] if following.isdigit() else {}, assignment)
        holder[_key(holder, keys[-1], assignment)] = _value(text)


def _enter(holder: Any, key: str, default: Any, assignment: str) -> Any:
    """Return the member `key` of a mapping or a list; the mapping gets a default one if it has none."""
    if isinstance(holder, dict):
        return holder.setdefault(key, default)
    return holder[_key(holder, key, assignment)]


def _key(holder: Any, key: str, assignment: str) -> Any:
    if isinstance(holder, dict):
        return key
    if not isinstance(holder, list):
        raise SceneError(f"--set {assignment}: {key} lies below {holder!r}, which has no members; shorten the path")
    if not key.isdigit() or int(key) >= len(holder):
        raise SceneError(f"--set {assignment}: {key} is no member of a list of {len(holder)}; count from 0")
    return int(key)


def _value(written: str) -> Any:
    try:
        return tomllib.loads(f"value = {written}")["value"]
    except tomllib.TOMLDecodeError:
        return written.strip()


def _table(data: Mapping[str, Any], path: tuple[str, ...], lines: list[str]) -> None:
    plain = {key: value for key, value in data.items() if not _is_section(value)}
    if path and (plain or not data):
        lines += ["", f"[{'.'.join(path)}]"]
    lines += [f"{_bare(key)} = {text(value)}" for key, value in plain.items()]
    for key, value in data.items():
        if isinstance(value, Mapping):
            _table(value, (*path, _bare(key)), lines)
        elif _is_section(value):
            for member in value:
                lines += ["", f"[[{'.'.join((*path, _bare(key)))}]]"]
                lines += [f"{_bare(k)} = {text(v)}" for k, v in member.items()]


def _is_section(value: Any) -> bool:
    return isinstance(value, Mapping) or (isinstance(value, list) and bool(value) and isinstance(value[0], Mapping))


def _bare(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key)


def text(value: Any) -> str:
    """Return a value as TOML writes it on one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_bare(key)} = {text(member)}" for key, member in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(text(member) for member in value) + "]"
    return repr(value)
