"""YAML source: plain data with lines; everything dangerous or ambiguous is refused, with the line."""

from pathlib import Path

import pytest
from cases import each, refused
from hypothesis import given, settings
from hypothesis import strategies as st

from elastic_strips.errors import InputError, ScenarioError, SceneError
from elastic_strips.io import nodes
from elastic_strips.io.nodes import Source, load_yaml, parse_yaml


def parse(text, path="x.yaml"):
    return parse_yaml(text, Source(Path(path), SceneError))


@each(
    "text, value",
    [
        ("1", 1),
        ("-12", -12),
        ("1e-3", 1e-3),
        ("1E3", 1000.0),
        ("-.5", -0.5),
        ("5.", 5.0),
        ("010", 10),
        ("123456789012345678901234567890", 123456789012345678901234567890.0),
        ("1_000", "1_000"),
        ("0x10", "0x10"),
        ("1:30", "1:30"),
        ("'1'", "1"),
        ('"true"', "true"),
        ("true", True),
        ("False", False),
        ("yes", "yes"),
        ("off", "off"),
        ("null", None),
        ("~", None),
        (".inf", float("inf")),
        ("2020-01-01", "2020-01-01"),
        ("<<", "<<"),
    ],
)
def test_scalars_are_those_of_yaml_1_2(text, value):
    found = parse(f"[{text}]").value[0]
    assert found == value
    assert type(found) is type(value)


def test_nodes_know_their_line_and_key():
    root = parse("a: 1\n\nb:\n  - x\n  - c: [1,\n      2]\n")
    assert root["b"].line == 3
    inner = root["b"].items()[1]["c"]
    assert (inner.line, inner.key) == (5, "b[1].c")
    first, second = inner
    assert (first.line, second.line, second.key) == (5, 6, "b[1].c[1]")
    with refused(SceneError, "x.yaml:6:", "[1]", "wrong"):
        second.fail("wrong")


@each(
    "text, message",
    [
        ("a: 1\nb: 2\na: 3\n", r"x\.yaml:3: key 'a' is given twice \(first in line 1\)"),
        ("a: &x [1]\nb: *x\n", r"x\.yaml:2: alias \*x"),
        ("a: &a [*a]\n", r"x\.yaml:1: alias"),
        ("a: !!python/object/apply:os.system ['true']\n", r"x\.yaml:1: tag"),
        ("!!binary aGk=\n", "tag"),
        ("a: 1\n---\nb: 2\n", "second document"),
        ("", "empty"),
        ("# only a comment\n", "empty"),
        ("a: [1, 2\nb: 3\n", r"x\.yaml:\d: not valid YAML"),
        ("a: b: c\n", r"x\.yaml:1: not valid YAML"),
        ("a: \x07\n", "not valid YAML"),
        ("? [1, 2]\n: 3\n", "key must be a word"),
        ("[" * 40 + "]" * 40, "nested more than 32"),
        ("[" * 100_000, "nested more than 32"),
        ("- " * 100_000, "nested more than 32"),
        ("{a: " * 50_000, "nested more than 32"),
    ],
)
def test_refused(text, message):
    with pytest.raises(SceneError, match=message):
        parse(text)


def test_alias_bomb_is_refused_at_once():
    bomb = "a: &a [x, x, x, x, x, x, x, x, x]\n"
    bomb += "".join(f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True))
    with refused(SceneError, "alias"):
        parse(bomb)


def test_size_is_bounded(tmp_path, monkeypatch):
    path = tmp_path / "big.yaml"
    path.write_text("a: 1\n" + "#" * 200)
    monkeypatch.setattr(nodes, "MAX_YAML_BYTES", 100)
    with refused(SceneError, "100"):
        load_yaml(path)
    monkeypatch.setattr(nodes, "MAX_NODES", 10)
    with refused(SceneError, "10"):
        parse("[" + "1," * 20 + "]")


def test_a_file_that_cannot_be_read_raises_the_asked_error(tmp_path):
    for error in (SceneError, ScenarioError):
        with refused(error, "gone.yaml:"):
            load_yaml(tmp_path / "gone.yaml", error=error)


def test_byte_order_mark_is_skipped(tmp_path):
    path = tmp_path / "bom.yaml"
    path.write_bytes(b"\xef\xbb\xbfa: 1\n")
    assert load_yaml(path).value == {"a": 1}


@settings(max_examples=300, deadline=None)
@given(st.text(alphabet=st.sampled_from("ab01.:-[]{},&*!|>'\"#?% \n\t\\é\x00"), max_size=60))
def test_any_text_is_data_or_a_typed_error(text):
    try:
        parse(text)
    except InputError as problem:
        assert str(problem).startswith("x.yaml")  # noqa: PT017
