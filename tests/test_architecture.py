"""What docs/architecture.md says of the package: its floors, and the files and names on the ways through it."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import guider

PACKAGE = Path(guider.__file__).parent
PAGE = (PACKAGE.parent / "docs" / "architecture.md").read_text()


def floors() -> dict[str, int]:
    """room -> its floor, the lowest 0."""
    (drawn,) = re.findall(r"```\n(.*?)```", PAGE, flags=re.DOTALL)
    rows = [re.findall(r"\w+", row.split("  ")[0]) for row in drawn.strip().splitlines()]
    return {room: floor for floor, rooms in enumerate(reversed(rows)) for room in rooms}


def rooms(path: Path) -> set[str]:
    """Rooms that a file of the package imports from."""
    imported = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "guider":
            inner = (node.module or "").split(".")[1:]
            imported |= {inner[0]} if inner else {name.name for name in node.names}
    return imported


def test_imports_go_one_way():
    """Nothing imports from a floor above its own. What runs a command, and the package itself, stand above all."""
    floor = floors()
    found = {path.relative_to(PACKAGE).parts[0].removesuffix(".py") for path in PACKAGE.glob("**/*.py")}
    assert found - set(floor) == {"__init__", "__main__", "cli"}, "every room has a floor"
    upwards = [
        f"{path.relative_to(PACKAGE)} imports from {room}"
        for path in PACKAGE.glob("*/**/*.py")
        for room in rooms(path)
        if floor[room] > floor[path.relative_to(PACKAGE).parts[0]]
    ]
    assert upwards == []


def test_files_and_names_on_the_way_exist():
    files = re.findall(r"`(\w+/\w+\.py)`", PAGE)
    assert len(files) > 15
    for file in files:
        assert (PACKAGE / file).exists(), file
    text = "".join((PACKAGE / file).read_text() for file in files)
    for name in re.findall(r"`([A-Za-z_]+)`", PAGE):
        assert re.search(rf"(def|class) {name}\b", text) or (PACKAGE / name).is_dir(), name
