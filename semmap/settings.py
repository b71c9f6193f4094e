"""Settings that fail on a misspelt key and name the nearest known one."""

from __future__ import annotations

import difflib
import textwrap
from pathlib import Path
from typing import Any, Self, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from semmap.errors import SemmapError, SettingsError

Model = TypeVar("Model", bound=BaseModel)


class Settings(BaseModel):
    """Base of every settings model: frozen, and unknown keys fail."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @classmethod
    def from_yaml(cls, path: str | Path) -> Self:
        """Read from a YAML file. Raises `SettingsError` that names the key and the nearest known one."""
        return validate(cls, load_yaml(path, SettingsError), file=path, error=SettingsError)

    def to_yaml(self) -> str:
        """All values, defaults included, as YAML text."""
        return yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False)


def load_yaml(path: str | Path, error: type[SemmapError]) -> dict[str, Any]:
    """One YAML mapping from a file; raises ``error`` where there is none."""
    try:
        data = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise error("no such file", file=path, mend="check the path") from None
    except (OSError, UnicodeDecodeError) as reason:
        what = f"cannot be read ({reason})"
        raise error(what, file=path, mend="check the path and its permissions") from None
    except yaml.YAMLError as reason:
        what = f"is not valid YAML ({_yaml_problem(reason)})"
        raise error(what, file=path, mend="check indentation and brackets") from None
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise error("is not a mapping of keys to values", file=path, mend="write `key: value` lines")
    return data


def _yaml_problem(reason: yaml.YAMLError) -> str:
    if isinstance(reason, yaml.MarkedYAMLError) and reason.problem_mark is not None:
        return f"line {reason.problem_mark.line + 1}: {reason.problem}"
    return str(reason).splitlines()[0]


def validate(model: type[Model], data: dict[str, Any], *, file: str | Path | None, error: type[SemmapError]) -> Model:
    """``model`` from plain data; the first problem becomes one ``error`` with file, field and mend."""
    try:
        return model.model_validate(data)
    except ValidationError as reason:
        problem = reason.errors()[0]
        field = ".".join(str(part) for part in problem["loc"])
        if problem["type"] == "extra_forbidden":
            known = _known_keys(model, problem["loc"][:-1])
            near = difflib.get_close_matches(str(problem["loc"][-1]), known, n=1, cutoff=0.4)
            mend = f"did you mean `{near[0]}`?" if near else f"known keys: {', '.join(known)}"
            raise error("unknown key", file=file, field=field, mend=mend) from None
        if problem["type"] == "missing":
            raise error("is missing", file=file, field=field, mend=f"add `{problem['loc'][-1]}`") from None
        what = problem["msg"].removeprefix("Value error, ")
        held = textwrap.shorten(repr(problem["input"]), 80, placeholder=" ...")
        raise error(what, file=file, field=field, mend=f"it holds {held}") from None


def _known_keys(model: type[BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    """Keys the model nested at ``loc`` accepts."""
    for part in loc:
        info = model.model_fields.get(str(part))
        members = _arguments(info.annotation) if info else ()
        nested = [member for member in members if isinstance(member, type) and issubclass(member, BaseModel)]
        if not nested:
            return []
        model = nested[0]
    return sorted(model.model_fields)


def _arguments(annotation: Any) -> tuple[Any, ...]:
    """The members of a union, or the annotation itself."""
    return getattr(annotation, "__args__", None) or (annotation,)
