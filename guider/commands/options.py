"""Options that several commands take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from guider.errors import GuiderError

Json = Annotated[bool, tyro.conf.arg(name="json", help="Print one JSON document instead of text.")]
TaskName = tyro.conf.Positional[str]
RunDirectory = tyro.conf.Positional[Path]


def assignments(texts: tuple[str, ...]) -> dict[str, str]:
    for text in texts:
        if "=" not in text:
            raise GuiderError(f"--set takes NAME=VALUE pairs, got {text!r}")
    pairs = [text.split("=", 1) for text in texts]
    names = [name for name, _ in pairs]
    if twice := [name for name in names if names.count(name) > 1]:
        raise GuiderError(f"--set gives {twice[0]} twice; say it once")
    return {name: value for name, value in pairs}
