"""One sentence per mistake in a scene: what is wrong, where, the value found, and what to do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from ..errors import SceneError

ModelT = TypeVar("ModelT", bound=BaseModel)


class RefusedScene(SceneError):
    """A scene, or a part of one, with mistakes: the message names the first, `problems` has a sentence for each."""

    def __init__(self, message: str, problems: Sequence[str] = ()) -> None:
        super().__init__(message)
        self.problems = list(problems) or [message]


def refusal(refused: ValidationError, source: str, model: type[BaseModel]) -> RefusedScene:
    """Return the error that says why a model refused what `source` gave it."""
    problems = sentences(refused, source, model)
    hint = f" (and {len(problems) - 1} more: see `amrpic check`)" if len(problems) > 1 else ""
    return RefusedScene(problems[0] + hint, problems)


def close_match(word: str, words: Iterable[str]) -> str:
    """Return the remedy for a word that is not among the known ones."""
    choices = list(words)
    close = difflib.get_close_matches(word, choices, n=1, cutoff=0.6)
    return f'did you mean "{close[0]}"?' if close else f"use one of {', '.join(choices)}"


class Mistake(NamedTuple):
    """What is wrong with one value of a model, and what to do about it."""

    path: str
    found: Any  # "" where there is nothing to show
    what: str
    remedy: str


def settings(model: type[ModelT], values: Mapping[str, Any], error: type[Exception]) -> ModelT:
    """Return values of keys as the model that checks them; `error` names the first mistake of arguments that are wrong."""
    try:
        return model.model_validate(values)
    except ValidationError as refused:
        mistake = _mistakes(refused, model)[0]
        raise error(f"{mistake.path} is {mistake.found!r}, which {mistake.what}; {mistake.remedy}") from None


def _mistakes(refused: ValidationError, model: type[BaseModel]) -> list[Mistake]:
    """Return the mistakes that made a model refuse its input."""
    schema = model.model_json_schema()
    return [_mistake(error, schema) for error in refused.errors(include_url=False)]


def sentences(refused: ValidationError, source: str, model: type[BaseModel]) -> list[str]:
    """Return a sentence for each error of a model; `source` names the file or object that was to be read."""
    return [_sentence(source, *mistake) for mistake in _mistakes(refused, model)]


def _sentence(source: str, path: str, found: Any, what: str, remedy: str) -> str:
    value = "" if found == "" else f" ({_brief(found)})"
    return f"{source}: {path or 'the scene'}{value} {what}; {remedy}"


def _mistake(error: ErrorDetails, schema: dict[str, Any]) -> Mistake:
    context = error.get("ctx") or {}
    path = ".".join([*_keys(error["loc"], schema), context.get("path", "")]).strip(".")
    value = context.get("found") if error["type"] == "amrpic" else None
    value = error["input"] if value is None else value
    if error["type"] == "amrpic":
        return Mistake(path, value, context["what"], context["remedy"])
    what, remedy, value = _pydantic(error, path, value)
    return Mistake(path, value, what, remedy)


def _keys(place: tuple[str | int, ...], schema: dict[str, Any]) -> Iterator[str]:
    """Yield the keys of a place as users wrote them: without the names of union members that pydantic puts in between."""
    node: dict[str, Any] = schema
    for part in place:
        nodes = list(_resolved(node, schema))
        members = [schema_["discriminator"]["mapping"].get(part) for schema_ in nodes if "discriminator" in schema_]
        if any(members):
            node = {"$ref": next(filter(None, members))}
            continue
        yield str(part)
        below = (schema_.get("items") if isinstance(part, int) else _member(schema_, part) for schema_ in nodes)
        node = next(filter(None, below), {})


def _member(node: dict[str, Any], key: str) -> dict[str, Any]:
    """The part of a schema for a key of a table; keys may be any names."""
    additional = node.get("additionalProperties")
    member: dict[str, Any] = node.get("properties", {}).get(key) or (additional if isinstance(additional, dict) else {})
    return member


def _resolved(node: dict[str, Any], schema: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a part of a schema, or those that it names, references followed."""
    if "$ref" in node:
        node = schema["$defs"][node["$ref"].removeprefix("#/$defs/")]
    yield node
    for part in [*node.get("anyOf", []), *node.get("allOf", [])]:
        yield from _resolved(part, schema)


def _pydantic(error: ErrorDetails, path: str, value: Any) -> tuple[str, str, Any]:
    """Return what is wrong, the remedy and the value to show for an error of pydantic's own."""
    kind, context = error["type"], error.get("ctx") or {}
    key = next((part for part in reversed(path.split(".")) if not part.isdigit()), path)  # rather than an index
    if kind == "missing":
        return "is missing", f"add {key} = …", ""
    if kind == "union_tag_not_found":
        chooser = str(context["discriminator"]).strip("'")
        return f"has no {chooser}", f'add {chooser} = "…" to it', ""
    if kind == "union_tag_invalid":
        chooser = str(context["discriminator"]).strip("'")
        tags = [tag.strip("' ") for tag in str(context["expected_tags"]).split(",")]
        return f"has an unknown {chooser}", close_match(str(context["tag"]), tags), context["tag"]
    if kind == "literal_error":
        choices = [choice.strip("' ") for choice in str(context["expected"]).replace(" or ", ",").split(",")]
        return "is not one of the choices", close_match(str(value), choices), value
    if kind in ("tuple_type", "list_type"):
        return "is no list", f"write {key} = […, …]", value
    message = error["msg"][0].lower() + error["msg"][1:]
    for opening in ("input should be ", "value should be "):
        if message.startswith(opening):
            return f"is not {message.removeprefix(opening)}", f"change {key}", value
    return f"is refused: {message}", f"change {key}", value


def _brief(value: Any) -> str:
    text = str(value) if isinstance(value, (int, float)) else repr(value)
    return text if len(text) <= 60 else text[:57] + "…"


def complaint_of(refused: Exception) -> PydanticCustomError:
    """Return the validation error that an exception's sentence makes: what is wrong; what to do about it."""
    what, _, remedy = str(refused).partition("; ")
    return complaint(f"is refused: {what}", remedy, found="")


def complaint(what: str, remedy: str, *, path: str = "", found: Any = None) -> PydanticCustomError:
    """Return a validation error that already knows its wording: what is wrong, and what to do about it.

    `path` is relative to the section that is being validated; `found` replaces the value that pydantic would report.
    """
    # Braces in the message would be read as placeholders by pydantic, so the words travel as context.
    return PydanticCustomError(
        "amrpic", "{what}; {remedy}", {"what": what, "remedy": remedy, "path": path, "found": found}
    )
