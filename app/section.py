"""A table of a configuration file, and the error messages for its values."""

from __future__ import annotations

from difflib import get_close_matches
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError, ValidationInfo, field_validator
from pydantic_core import ErrorDetails

from sidelong.app.errors import InputError

_SHOWN_CHARACTERS = 80  # of a wrong value

Model = TypeVar("Model", bound=BaseModel)


class Section(BaseModel):
    """A table of a file: no key but its own, no value that is not finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _is_no_switch(cls, value: Any, info: ValidationInfo) -> Any:
        kind = cls.model_fields[info.field_name or ""].annotation
        if isinstance(value, bool) and bool not in (kind, *get_args(kind)):
            raise ValueError(f"{str(value).lower()} is not allowed here; true and false are for switches")
        return value


def validated(kind: type[Model], values: Any, name: str) -> Model:
    """Return the model of plain values. Raises InputError that begins with ``name`` and names the field."""
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        raise InputError(f"{name}: {_sentence(error, kind)}") from error


def _sentence(error: ValidationError, kind: type[BaseModel]) -> str:
    """Return the first problem as one sentence that names the field, what is wrong, and the nearest that is right."""
    problem = error.errors()[0]
    where = ".".join(f"{part!s:.40}" for part in problem["loc"])
    if problem["type"] == "extra_forbidden":
        known = _known_keys(kind, problem["loc"])
        return f"unknown key {where}; known there: {', '.join(known)}{_meant(kind, str(problem['loc'][-1]), known)}."
    if problem["type"] == "value_error":
        return f"{where + ': ' if where else ''}{_cut(str(problem['ctx']['error']))}."
    if problem["type"] == "missing":
        return f"{where} is missing; give it."
    given = f"{where} = {_cut(repr(problem['input']), _SHOWN_CHARACTERS)}"
    if problem["type"] in ("model_type", "dict_type"):
        return f"{given}: a table belongs there; write [{where}], and its keys below."
    message = problem["msg"][0].lower() + problem["msg"][1:]
    return f"{given}: {message}{_nearest(problem)}."


def _meant(kind: type[BaseModel], key: str, known: list[str]) -> str:
    """Return which key is probably meant by an unknown one, '' if none is like it."""
    tables = [name for name in kind.model_fields if key in _known_keys(kind, (name, key))]
    alike = get_close_matches(key, known, n=1)
    if tables:
        return f"; {key} belongs to [{tables[0]}]"
    return f"; the nearest is {alike[0]}" if alike else ""


def _cut(text: str, longest: int = 400) -> str:
    return text if len(text) <= longest else text[:longest] + "..."


def _nearest(problem: ErrorDetails) -> str:
    """Return the nearest valid value in words, '' where there is no such thing."""
    bounds = problem.get("ctx", {})
    for bound in ("ge", "le"):
        if bound in bounds:
            return f"; the nearest valid value is {bounds[bound]:g}"
    if problem["type"] == "literal_error":
        choices = [choice.strip("' ") for choice in bounds["expected"].replace(" or ", ",").split(",")]
        alike = get_close_matches(str(problem["input"]), choices, n=1)
        return f"; the nearest is {alike[0]!r}" if alike else ""
    return ""


def _known_keys(kind: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    model: Any = kind
    for part in location[:-1]:
        found = model.model_fields[part].annotation if isinstance(part, str) else model
        of_many = get_args(found)  # a list of sections, or a section that may be missing
        model = of_many[0] if of_many else found
    return list(getattr(model, "model_fields", ()))
