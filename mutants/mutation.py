"""What a mutation is."""

from __future__ import annotations

from dataclasses import dataclass

Table = dict[str, list[tuple[str, str, str]]]
"""File from the root -> its mutations: the text as it stands, the text that takes its place, and the tests that must
fail."""


@dataclass(frozen=True)
class Mutation:
    """file: from the root; tests: arguments to pytest, from tests/."""

    file: str
    old: str
    new: str
    tests: str

    def __str__(self) -> str:
        return f"{self.file}: {' '.join(self.old.split())} -> {' '.join(self.new.split())}"
