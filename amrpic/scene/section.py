"""The base of all sections of a scene: frozen, strict about keys, with plain messages about mistakes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, Self, cast

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, ValidationError, model_validator
from pydantic_core import CoreSchema

from .complaints import close_match, complaint, refusal

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)


def _number(value: Any) -> Any:
    if isinstance(value, str | bool):
        raise complaint("is not a number", "write one, without quotes and without a unit")
    return value


REFUSAL = {"type": "no-info", "function": _number}


def _without_coercion(schema: Any) -> Any:
    """Return a validation schema in which "3" and true are no numbers, as for every JSON schema and editor."""
    if isinstance(schema, list):
        return [_without_coercion(member) for member in schema]
    if not isinstance(schema, dict) or schema.get("function") == REFUSAL:
        return schema
    if schema.get("type") in ("int", "float"):
        return {"type": "function-before", "function": REFUSAL, "schema": schema}
    return {key: _without_coercion(member) for key, member in schema.items()}


class _Sentences(ModelMetaclass):
    """What Python gives a section is refused by the same sentences as what a file has."""

    def __call__(cls, *arguments: Any, **named: Any) -> Any:
        try:
            return super().__call__(*arguments, **named)
        except ValidationError as refused:
            raise refusal(refused, cls.__name__, cast(type[BaseModel], cls)) from None


class Section(BaseModel, metaclass=_Sentences):
    """A part of the scene: frozen, and strict about its keys. Raises SceneError for a value that it cannot have."""

    foreign: ClassVar[Mapping[str, str]] = {}  # keys that belong elsewhere, and what to do about them

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True, defer_build=True
    )

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return _without_coercion(handler(source))

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        if isinstance(data, Mapping):
            for key in data:
                if key not in cls.model_fields:
                    remedy = cls.foreign.get(key) or close_match(str(key), cls.model_fields)
                    raise complaint("is an unknown key", remedy, path=str(key), found=data[key])
        return data

    def replace(self, **changes: Any) -> Self:
        """Return the same with other values of some keys. Raises SceneError as when it is made."""
        settings = {name: getattr(self, name) for name in self.model_fields_set}
        return type(self)(**{**settings, **changes})

    def refuse(self, path: str, problem: str, remedy: str, found: Any = None) -> NoReturn:
        """Raise the validation error of the value at a path: what is wrong with it, and what to do about it.

        The value is part of the sentence, or `found` in its place, if that is not empty.
        """
        if found is None:
            value: Any = self
            for key in path.split("."):
                holds_by_key = isinstance(value, Mapping | list | tuple)
                value = value[int(key) if key.isdigit() else key] if holds_by_key else getattr(value, key)
            found = "nothing" if value is None else list(value) if isinstance(value, tuple) else value
        raise complaint(problem, remedy, path=path, found=found)

    def given(self, *keys: str) -> list[str]:
        """Return those of some keys that have a value."""
        return [key for key in keys if getattr(self, key) is not None]

    def require_at_most_one(self, *keys: str) -> None:
        """Refuse keys of which each stands in place of the others, if several are given."""
        if len(given := self.given(*keys)) > 1:
            self.refuse(given[0], f"is given as well as {given[1]}", "keep one of the two", found="")

    def require_one(self, *keys: str, remedy: str = "") -> None:
        """Refuse keys of which each stands in place of the others, unless exactly one is given; `remedy` is for none."""
        self.require_at_most_one(*keys)
        if not self.given(*keys):
            first, *others = keys
            problem = f"is missing, as {'is' if len(others) == 1 else 'are'} {' and '.join(others)}"
            self.refuse(first, problem, remedy or f"give {', '.join(keys[:-1])} or {keys[-1]}", found="")


def refuse_negative(path: str, value: float, unit: str) -> None:
    if value < 0:
        raise complaint("is negative", f"give 0 or more {unit}", path=path, found=value)
