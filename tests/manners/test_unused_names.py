"""A module's own names, which begin with an underscore, are used in it: what stayed behind when code moved on goes."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]


def unused_names(source: str) -> set[str]:
    """Names with one leading underscore that a module makes at its top level, and that nothing in it reads."""
    made: set[str] = set()
    for node in ast.parse(source).body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            made.add(node.name)
        elif isinstance(node, (ast.Assign, ast.AnnAssign)):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            made |= {part.id for target in targets for part in ast.walk(target) if isinstance(part, ast.Name)}
    nodes = list(ast.walk(ast.parse(source)))
    read = {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)}
    read |= {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}  # of types
    return {name for name in made if name.startswith("_") and not name.startswith("__") and name not in read}


def test_modules_keep_no_names_that_they_do_not_use():
    files = [*(ROOT / "src").rglob("*.py"), *(ROOT / "workshop").rglob("*.py")]
    assert len(files) > 200
    found = {str(file.relative_to(ROOT)): unused_names(file.read_text(encoding="utf-8")) for file in files}
    assert {file: names for file, names in found.items() if names} == {}


def test_an_unused_name_is_found():
    assert unused_names("_A = 1\n_B: int = 2\ndef _c(): return _B\ndef d(): _e = _c()") == {"_A"}
