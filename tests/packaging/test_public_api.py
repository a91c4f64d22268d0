"""The public surface: few names at the top, packages that export what users need, and no ``Any`` in what they call."""

from __future__ import annotations

import ast
import importlib
import inspect
from collections.abc import Iterator
from pathlib import Path

from cases import each

import elastic_strips as es

PACKAGE = Path(es.__file__ or "").parent
ROOMS = sorted(
    ".".join(("elastic_strips", *path.parent.relative_to(PACKAGE).parts))
    for path in PACKAGE.rglob("__init__.py")
    if path.parent != PACKAGE
)


def exported(room: str) -> list[str]:
    return list(getattr(importlib.import_module(room), "__all__", ()))


def test_the_top_has_about_30_names_and_dir_shows_them_alone():
    assert len(es.__all__) <= 33
    assert dir(es) == sorted(es.__all__)
    assert not [name for name in es.__all__ if inspect.ismodule(getattr(es, name))]


@each("name", [name for name in es.__all__ if name != "__version__"])
def test_every_name_at_the_top_is_explained(name):
    assert len((inspect.getdoc(getattr(es, name)) or "").split()) >= 4


def test_packages_export_at_most_250_names():
    assert sum(len(exported(room)) for room in ROOMS) <= 250


@each("room", ROOMS)
def test_what_a_package_exports_is_there_and_is_explained(room):
    package = importlib.import_module(room)
    assert package.__doc__
    for name in exported(room):
        value = getattr(package, name)
        assert not inspect.ismodule(value), name
        if inspect.isclass(value) or inspect.isfunction(value):
            assert inspect.getdoc(value), name


def public_functions(path: Path) -> Iterator[tuple[str, ast.FunctionDef]]:
    """Functions and methods of a module that callers may call."""

    def within(body: list[ast.stmt], prefix: str) -> Iterator[tuple[str, ast.FunctionDef]]:
        for node in body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                yield from within(node.body, f"{prefix}{node.name}.")
            elif isinstance(node, ast.FunctionDef) and (not node.name.startswith("_") or node.name == "__init__"):
                yield prefix + node.name, node

    yield from within(ast.parse(path.read_text(encoding="utf-8")).body, "")


def annotations(function: ast.FunctionDef) -> Iterator[ast.expr]:
    a = function.args
    for argument in (*a.posonlyargs, *a.args, *a.kwonlyargs, a.vararg, a.kwarg):
        if argument is not None and argument.annotation is not None:
            yield argument.annotation
    if function.returns is not None:
        yield function.returns


def says_any(annotation: ast.expr) -> bool:
    return any(
        (isinstance(node, ast.Name) and node.id == "Any")
        or (isinstance(node, ast.Attribute) and node.attr == "Any")
        or (isinstance(node, ast.Constant) and isinstance(node.value, str) and "Any" in node.value.split("[")[0])
        for node in ast.walk(annotation)
    )


def test_no_public_signature_says_any():
    found = [
        f"{path.relative_to(PACKAGE)}: {name}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for name, function in public_functions(path)
        if any(says_any(annotation) for annotation in annotations(function))
    ]
    assert found == []


def test_the_check_finds_any():
    function = ast.parse("def f(a: int, *rest: dict[str, Any]) -> None: ...").body[0]
    assert isinstance(function, ast.FunctionDef)
    assert [says_any(annotation) for annotation in annotations(function)] == [False, True, False]
