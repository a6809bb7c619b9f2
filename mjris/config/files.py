"""Configs from files and plain values."""

from pathlib import Path
from typing import Any

from mjris.config.errors import ConfigError, validated
from mjris.config.schema import ADAPTER, Config


def from_dict(data: dict[str, Any], source: str = "config") -> Config:
    """Config from nested dicts; missing fields take their defaults. Raises `ConfigError`."""
    return validated(lambda: ADAPTER.validate_python(data), source)


def load(path: Path) -> Config:
    """Config from a JSON file. Raises `ConfigError` for a missing file, bad JSON or bad values."""
    try:
        text = path.read_text()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    return validated(lambda: ADAPTER.validate_json(text), str(path))
