"""One sentence per mistake in a scene: what is wrong, where, the value found, and what to do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

# What pydantic puts into the place of an error for the chosen member of a union; no key has such a name.
_UNION_TAGS = {
    *("gaussian", "sphere", "lattice", "arrays"),
    *("charge-density", "field-strength", "static"),
    *("none", "leapfrog", "random-walk"),
}


def close_match(word: str, known: Iterable[str]) -> str:
    """Return the remedy for a word that is not among the known ones."""
    choices = list(known)
    close = difflib.get_close_matches(word, choices, n=1, cutoff=0.6)
    return f'did you mean "{close[0]}"?' if close else f"use one of {', '.join(choices)}"


def sentences(refused: ValidationError, source: str) -> list[str]:
    """Return a sentence for each error; `source` names the file or object that holds the scene."""
    return [_sentence(error, source) for error in refused.errors(include_url=False)]


def _sentence(error: ErrorDetails, source: str) -> str:
    context = error.get("ctx") or {}
    path = ".".join([str(part) for part in error["loc"] if part not in _UNION_TAGS] + [context.get("path", "")]).strip(
        "."
    )
    found = context.get("found") if error["type"] == "amrpic" else None
    found = error["input"] if found is None else found
    if error["type"] == "amrpic":
        what, remedy = context["what"], context["remedy"]
    else:
        what, remedy, found = _pydantic(error, path, found)
    value = "" if found == "" else f" ({_brief(found)})"
    return f"{source}: {path or 'the scene'}{value} {what}; {remedy}"


def _pydantic(error: ErrorDetails, path: str, found: Any) -> tuple[str, str, Any]:
    """Return what is wrong, the remedy and the value to show for an error of pydantic's own."""
    kind, context = error["type"], error.get("ctx") or {}
    key = path.rpartition(".")[2]
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
        return "is not one of the choices", close_match(str(found), choices), found
    message = error["msg"][0].lower() + error["msg"][1:]
    for opening in ("input should be ", "value should be "):
        if message.startswith(opening):
            return f"is not {message.removeprefix(opening)}", f"change {key}", found
    return f"is refused: {message}", f"change {key}", found


def _brief(value: Any) -> str:
    text = str(value) if isinstance(value, (int, float)) else repr(value)
    return text if len(text) <= 60 else text[:57] + "…"
