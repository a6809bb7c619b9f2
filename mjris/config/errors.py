"""What is wrong with a value, in one sentence for the user."""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

from pydantic import ValidationError

T = TypeVar("T")


class ConfigError(Exception):
    """A parameter has a value that is not allowed; the message is one sentence for the user."""


def plain_errors(section: type[T]) -> type[T]:
    """Let a config dataclass raise `ConfigError`, not pydantic's own, when it is made by hand or from flags."""
    construct = section.__init__

    @functools.wraps(construct)
    def init(self: T, **values: Any) -> None:
        try:
            construct(self, **values)
        except ValidationError as error:
            raise ConfigError(describe(error, section.__name__.lower())) from None

    section.__init__ = init
    return section


def describe(error: ValidationError, section: str = "") -> str:
    """One sentence for a validation error: the field (of a section of the config), its value and what is allowed."""
    first = error.errors()[0]
    field = ".".join(str(part) for part in ((section,) if section not in ("", "config") else ()) + first["loc"])
    message = first["msg"].removeprefix("Value error, ")
    if message.startswith(("world.", "radio.", "task.", "agent.")):
        return message
    if first["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"{field} is not a known field"
    if first["type"] in ("missing", "missing_argument"):
        return f"{field} is missing"
    return f"{field}: {first['input']!r} is not allowed: {message[0].lower()}{message[1:]}"


def validated(build: Callable[[], T], source: str = "config") -> T:
    """The result of `build`, with any pydantic error turned into a one-sentence `ConfigError`."""
    try:
        return build()
    except ValidationError as error:
        raise ConfigError(f"{source}: {describe(error)}") from None
