"""Packages that not everybody needs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from guider.errors import GuiderError


@contextmanager
def extra(name: str, what: str) -> Iterator[None]:
    """Imports in this context are of the extra `name`; GuiderError says how to install it where `what` lacks them."""
    try:
        yield
    except ImportError:
        raise GuiderError(f'{what} is not installed: pip install "guider-rl[{name}]"') from None
