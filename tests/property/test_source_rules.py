"""Rules that the source keeps: tangents instead of subtracted configurations, no printing, meshcat in one room."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from cases import each

import elastic_strips

PACKAGE = Path(elastic_strips.__file__).parent if elastic_strips.__file__ else Path()
SOURCES = sorted(PACKAGE.rglob("*.py"))
CONFIGURATION = re.compile(r"^(q|qs|q_?\w{0,12}|\w+_q)$")
"""Names that by the house's rules hold Pinocchio configurations; coordinates have other names."""


def room(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0]


@cache
def walk(path: Path) -> list[ast.AST]:
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"), filename=str(path))))


def bare_name(node: ast.AST) -> str:
    """The last name of ``a.b.q[1:]``: ``q``; empty where one entry of a configuration is meant."""
    if isinstance(node, ast.Subscript):
        index = node.slice
        whole = isinstance(index, (ast.Slice, ast.Name)) or (
            isinstance(index, ast.UnaryOp) or (isinstance(index, ast.Constant) and isinstance(index.value, int))
        )
        return bare_name(node.value) if whole else ""
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""


def subtracted_configurations(path: Path) -> list[str]:
    found = []
    for node in walk(path):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Sub):
            pair = node.left, node.right
        elif isinstance(node, ast.Call) and bare_name(node.func) == "subtract" and len(node.args) >= 2:
            pair = node.args[0], node.args[1]
        elif isinstance(node, ast.Call) and bare_name(node.func) == "diff" and node.args:
            pair = node.args[0], node.args[0]
        else:
            continue
        if all(CONFIGURATION.match(bare_name(n)) and bare_name(n).lower().startswith("q") for n in pair):
            found.append(f"{path.name}:{node.lineno}: {ast.unparse(node)}")
    return found


def test_the_package_was_found():
    assert len(SOURCES) > 40
    assert {"robot", "collision", "strip", "planning"} <= {room(p) for p in SOURCES}


def test_no_configurations_are_subtracted():
    """``q_b - q_a`` is wrong on (x, y, cos, sin): only the configuration space knows differences."""
    found = [
        hit
        for p in SOURCES
        if p.relative_to(PACKAGE).as_posix() != "robot/space.py"
        for hit in subtracted_configurations(p)
    ]
    assert found == []


@each(
    "line, wrong",
    [
        ("v = q_b - q_a", True),
        ("v = strip.q[1:] - strip.q[:-1]", True),
        ("v = np.diff(self.q, axis=0)", True),
        ("v = np.subtract(q1, q0)", True),
        ("v = q[i] - q[j]", True),
        ("v = coordinates[1:] - coordinates[:-1]", False),
        ("x = queries - asked", False),
        ("x = p - q_goal_distance_of_something_else", False),
    ],
)
def test_the_rule_about_configurations_bites(tmp_path, line, wrong):
    path = tmp_path / "sample.py"
    path.write_text(line + "\n")
    assert bool(subtracted_configurations(path)) is wrong


def test_the_library_never_prints():
    for path in SOURCES:
        if room(path) in ("cli", "cli.py", "proof_checker.py"):  # programs
            continue
        for node in walk(path):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in ("print", "pprint", "input"), f"{path}:{node.lineno}"
            if path.name == "server.py":
                continue  # the viewer's own process tells its parent the port by standard output
            if isinstance(node, ast.Attribute) and node.attr == "write" and isinstance(node.value, ast.Attribute):
                assert node.value.attr not in ("stdout", "stderr"), f"{path}:{node.lineno}"


def imported(path: Path) -> Iterator[tuple[int, str]]:
    """Line and name of every import, also inside functions and by ``importlib``."""
    for node in walk(path):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.lineno, node.module or ""
        elif isinstance(node, ast.Call) and bare_name(node.func) in ("import_module", "__import__", "find_spec"):
            for argument in node.args[:1]:
                if isinstance(argument, ast.Constant) and isinstance(argument.value, str):
                    yield node.lineno, argument.value


def test_only_the_viewer_knows_meshcat():
    users = {room(p) for p in SOURCES for _, name in imported(p) if name.split(".")[0] == "meshcat"}
    assert users <= {"viewer"}


def test_no_global_random_numbers():
    """Randomness comes from generators that the caller seeds."""
    for path in SOURCES:
        for node in walk(path):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Attribute):
                owner = ast.unparse(node.value)
                if owner in ("np.random", "numpy.random"):
                    assert node.attr in ("Generator", "default_rng", "SeedSequence"), f"{path}:{node.lineno}"
        assert not any(name == "random" for _, name in imported(path)), path


def test_nothing_is_negated_into_a_given_array():
    """``np.negative(x, out=y)`` gives wrong values in NumPy 2.2 to 2.4 where x's stride is eight numbers."""
    for path in SOURCES:
        for node in walk(path):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in ("np.negative", "numpy.negative"):
                assert not any(k.arg == "out" for k in node.keywords), f"{path}:{node.lineno}: write y[...] = -x"


def test_no_assertions_guard_input():
    """``assert`` vanishes under ``python -O``: it may narrow a type, it may not check what users hand in."""
    allowed = re.compile(r"is not None|isinstance")
    for path in SOURCES:
        for node in walk(path):
            if isinstance(node, ast.Assert):
                assert allowed.search(ast.unparse(node.test)), f"{path}:{node.lineno}: {ast.unparse(node)}"
