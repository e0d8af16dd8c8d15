"""Paths as people type them."""

from __future__ import annotations

import os
from pathlib import Path

from guider.errors import GuiderError


def user_path(typed: str | Path) -> Path:
    """The path, with ~ for the home directory. Raises GuiderError for what can be no path."""
    text = os.fspath(typed)
    if not text or "\0" in text:
        raise GuiderError(f"{text!r} is no path")
    try:
        return Path(text).expanduser()
    except RuntimeError:
        raise GuiderError(f"{text}: there is no home directory that ~ could stand for (HOME is not set)") from None
