"""Plain YAML with lines; everything that could make a file say something else than it seems to is refused."""

from __future__ import annotations

import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from setrl.specs.errors import SpecificationError
from setrl.specs.yaml_nodes import MappingNode, Quoted, line_table, load_nodes, plain_data

REFUSED: list[tuple[str | bytes, int, str]] = [
    # content, line, part of the message with its remedy
    (b"", 1, "empty"),
    (b"\n  \n# only a comment\n", 1, "empty"),
    (b"\x7fELF\x00\x01", 1, "binary"),
    (b"a: 1\nb: \xff", 2, "save it as UTF-8"),
    ("a: &x 1", 1, "anchors are not read"),
    ("a: 1\nb: *a", 2, "aliases are not read"),
    ("a: &x [*x]", 1, "anchors are not read"),
    ("a: !!str 1", 1, "tags are not used"),
    ("a: !!python/object/apply:os.system [ls]", 1, "tags are not used"),
    ("a: ! 1", 1, "tags are not used"),
    ("!x {a: 1}", 1, "tags are not used"),
    ("%TAG ! tag:x,2000:\n---\na: 1", 1, "tags are not used"),
    ("a: 1\nb: 2\na: 3", 3, "first at line 1"),
    ("a: {b: 1, 'b': 2}", 1, "keep one of them"),
    ("a: 1\n---\nb: 2", 2, "one file holds one document"),
    ("- 1", 1, "expected a mapping"),
    ("word", 1, "expected a mapping"),
    ("? [a]\n: 1", 1, "keys are names"),
    ("a: {? {b: 1} : 2}", 1, "keys are names"),
    ("'': 1", 1, "empty key"),
    ("k" * 201 + ": 1", 1, "at most 200"),
    ("a:\n\tb: 1", 2, "indent with spaces"),
    ("a: b: c", 1, "quote text"),
    ("a: [1, 2\nb: 3", 2, "close every ["),
    ("a: 'x", 1, "not valid YAML"),
    ('a: 1\nb: "\\UFFFFFFFF"', 2, "not valid YAML"),
    ('a: "\\uD800"', 1, "control character"),
    ('a: "\\e[31m"', 1, "control character"),
    ("a: 1\nb: \x1b[31m", 2, "control character"),
    ("%YAML 1." + "9" * 5000 + "\n---\na: 1", 1, "not valid YAML"),
    ("%YAML 3.0\n---\na: 1", 1, "not valid YAML"),
    ("a: " + "[" * 33 + "]" * 33, 1, "nested more than 32"),
    ("a: " + "[" * 100_000, 1, "nested more than 32"),
    ("{a: " * 100_000, 1, "nested more than 32"),
    (b"a: 1\n" * 300_000, 1, "at most 1048576 bytes"),
    ("a: [" + "1," * 200_000 + "]", 1, "more than 20000 values"),
]


@pytest.mark.parametrize(("content", "line", "part"), REFUSED, ids=range(len(REFUSED)))
def test_refused_file_names_line_and_remedy(content: str | bytes, line: int, part: str) -> None:
    started = time.perf_counter()
    with pytest.raises(SpecificationError) as caught:
        load_nodes(content, "some.yaml")
    assert str(caught.value).startswith(f"some.yaml:{line}: ")
    assert caught.value.remedy
    assert part in str(caught.value)
    assert time.perf_counter() - started < 10


def test_scalars_stay_text_and_quotes_are_known() -> None:
    root = load_nodes("a: 1e-3\nb: 017\nc: no\nd: '1'\ne: null\nf: ~\ng:\nh: 'null'\ni: 2020-01-01", "f")
    data = plain_data(root)
    assert data == {
        "a": "1e-3", "b": "017", "c": "no", "d": "1", "e": None, "f": None, "g": None, "h": "null", "i": "2020-01-01",
    }  # fmt: skip
    assert isinstance(data, dict)
    assert isinstance(data["d"], Quoted) and not isinstance(data["a"], Quoted)


def test_line_table_has_every_key() -> None:
    root = load_nodes("a: {b: [1, 2]}\n\nc:\n  - d: 1\n    e: [x,\n      y]\n", "f")
    assert line_table(root) == {
        "a": 1, "a.b": 1, "a.b.0": 1, "a.b.1": 1, "c": 3, "c.0": 4, "c.0.d": 4, "c.0.e": 5, "c.0.e.0": 5, "c.0.e.1": 6,
    }  # fmt: skip


def test_byte_order_mark_and_windows_lines_are_read() -> None:
    for content in (b"\xef\xbb\xbfa: 1\r\nb: 2\r\n", "\ufeffa: 1\r\nb: 2\r\n"):
        assert plain_data(load_nodes(content, "f")) == {"a": "1", "b": "2"}


@settings(derandomize=True, deadline=None, max_examples=300)
@given(st.text(alphabet="ab01 :-[]{},&*!|>'\"\n\t#%@`?\\~.", max_size=80) | st.binary(max_size=40))
def test_any_content_gives_a_tree_or_a_specification_error(content: str | bytes) -> None:
    try:
        root = load_nodes(content, "f.yaml")
    except SpecificationError as error:
        assert error.remedy and str(error).startswith("f.yaml:")
    else:
        assert isinstance(root, MappingNode)
        line_table(root)
