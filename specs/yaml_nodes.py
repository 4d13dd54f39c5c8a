"""YAML text to a tree in which every value knows its line and every scalar is still text.

Only the plain part of YAML is read: one document, mappings with text keys, sequences, scalars. Anchors, aliases, tags
and duplicate keys are errors, because each of them lets a file say something else than it seems to say.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NoReturn, TypeAlias

import yaml

from .errors import SpecificationError
from .exact import shown

MAX_BYTES = 1 << 20
MAX_DEPTH = 32
MAX_NODES = 20_000
MAX_KEY_LENGTH = 200
_TOO_LARGE = "a specification is a short text; is this the right file?"


@dataclass(frozen=True)
class ScalarNode:
    """Text as written; `quoted` tells ``"1"`` from ``1``."""

    text: str
    line: int
    quoted: bool


@dataclass(frozen=True)
class SequenceNode:
    """A list."""

    items: list[Node]
    line: int


@dataclass(frozen=True)
class MappingNode:
    """A mapping in file order; `key_lines` has the line of every key."""

    entries: dict[str, Node]
    line: int
    key_lines: dict[str, int] = field(default_factory=dict)


Node: TypeAlias = ScalarNode | SequenceNode | MappingNode


class Quoted(str):
    """The text of a quoted scalar: never a number, a boolean or null."""


def load_nodes(content: bytes | str, source: str) -> MappingNode:
    """Read one YAML document whose top level is a mapping.

    Parameters
    ----------
    content : bytes or str
        At most 1 MiB of UTF-8.
    source : str
        Name of the file, for messages.

    Returns
    -------
    MappingNode

    Raises
    ------
    SpecificationError
        With ``where="source:line"`` and a remedy.
    """
    text = _decode(content, source)
    builder = _Builder(source)
    try:
        for event in _events(text):
            builder.take(event)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        _fail(source, mark.line + 1 if mark else 1, f"not valid YAML: {_problem(error)}", _syntax_remedy(error))
    except (yaml.YAMLError, ValueError, OverflowError):
        # yaml.reader.ReaderError has no line; ValueError comes from escapes such as "\UFFFFFFFF".
        _fail(source, builder.line, "not valid YAML: a character that cannot be read", "remove it")
    if builder.root is None:
        _fail(source, 1, "the file is empty", "start from one of the shipped files")
    if not isinstance(builder.root, MappingNode):
        _fail(source, builder.root.line, "expected a mapping at the top level", "write key: value lines")
    return builder.root


def _events(text: str) -> Iterator[yaml.Event]:
    yield from yaml.parse(text, Loader=yaml.SafeLoader)


def _fail(source: str, line: int, message: str, remedy: str) -> NoReturn:
    raise SpecificationError(message, where=f"{source}:{line}", remedy=remedy) from None


def _decode(content: bytes | str, source: str) -> str:
    size = len(content)
    if size > MAX_BYTES:
        _fail(
            source,
            1,
            f"expected at most {MAX_BYTES} bytes, found {size}",
            "a specification is a short text; is this the right file?",
        )
    if isinstance(content, bytes):
        if b"\x00" in content:
            _fail(source, 1, "the file is binary", "give a YAML file; a policy is given separately")
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            line = error.object[: error.start].count(b"\n") + 1
            _fail(source, line, "the file is not UTF-8", "save it as UTF-8")
    else:
        text = content.removeprefix("\ufeff")
    if not text.strip():
        _fail(source, 1, "the file is empty", "start from one of the shipped files")
    for number, row in enumerate(text.split("\n"), start=1):
        for character in row:
            if unicodedata.category(character) in ("Cc", "Cs") and character not in "\t\r\x85":
                _fail(source, number, f"found the control character {shown(character)}", "remove it")
    return text


def _problem(error: yaml.MarkedYAMLError) -> str:
    return " ".join(part for part in (error.context, error.problem) if part)


def _syntax_remedy(error: yaml.MarkedYAMLError) -> str:
    problem = _problem(error)
    if "\\t" in problem or "tab" in problem:
        return "indent with spaces"
    if "mapping values are not allowed" in problem:
        return "check the indentation, and quote text that contains ': '"
    if "flow" in problem:
        return "close every [ and {, and separate entries with commas"
    return "check the indentation, brackets and quotes at this line"


@dataclass
class _Open:
    node: SequenceNode | MappingNode
    key: str | None = None


class _Builder:
    """Builds the tree from parse events with a stack of its own, so that depth is ours to bound."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.root: Node | None = None
        self.stack: list[_Open] = []
        self.line = 1
        self.count = 0

    def fail(self, message: str, remedy: str) -> NoReturn:
        _fail(self.source, self.line, message, remedy)

    def take(self, event: yaml.Event) -> None:
        if event.start_mark is not None:
            self.line = event.start_mark.line + 1
        match event:
            case yaml.DocumentStartEvent():
                if self.root is not None:
                    self.fail("found a second document", "one file holds one document; remove the '---'")
                if event.tags:
                    self.fail("found a %TAG directive", "remove it; tags are not used")
            case yaml.AliasEvent():
                self.fail(f"found the alias {shown(f'*{event.anchor}')}", "write the value out; aliases are not read")
            case yaml.ScalarEvent():
                self.check(event)
                self.add_scalar(event)
            case yaml.SequenceStartEvent():
                self.check(event)
                self.open(SequenceNode([], self.line))
            case yaml.MappingStartEvent():
                self.check(event)
                self.open(MappingNode({}, self.line))
            case yaml.SequenceEndEvent() | yaml.MappingEndEvent():
                self.stack.pop()

    def check(self, event: yaml.NodeEvent) -> None:
        self.count += 1
        if self.count > MAX_NODES:
            self.fail(f"more than {MAX_NODES} values", _TOO_LARGE)
        if event.anchor is not None:
            self.fail(f"found the anchor {shown(f'&{event.anchor}')}", "write the value out; anchors are not read")
        tag = getattr(event, "tag", None)
        if tag is not None:
            self.fail(f"found the tag {shown(str(tag))}", "remove it; tags are not used")

    def add_scalar(self, event: yaml.ScalarEvent) -> None:
        text = event.value
        for character in text:
            if unicodedata.category(character) in ("Cc", "Cs") and character not in "\t\n":
                self.fail(f"found the control character {shown(character)}", "remove it")
        top = self.stack[-1] if self.stack else None
        if top is not None and isinstance(top.node, MappingNode) and top.key is None:
            self.start_entry(top, top.node, text)
        else:
            self.add(ScalarNode(text, self.line, event.style is not None))

    def start_entry(self, top: _Open, node: MappingNode, key: str) -> None:
        if not key:
            self.fail("found an empty key", "name it")
        if len(key) > MAX_KEY_LENGTH:
            self.fail(f"found a key of {len(key)} characters", f"keys have at most {MAX_KEY_LENGTH}")
        if key in node.entries:
            first = node.key_lines[key]
            self.fail(f"the key {shown(key)} appears a second time (first at line {first})", "keep one of them")
        node.key_lines[key] = self.line
        top.key = key

    def open(self, node: SequenceNode | MappingNode) -> None:
        if len(self.stack) >= MAX_DEPTH:
            self.fail(f"nested more than {MAX_DEPTH} deep", "no key of the language needs this depth")
        self.add(node)
        self.stack.append(_Open(node))

    def add(self, node: Node) -> None:
        if not self.stack:
            self.root = node
            return
        top = self.stack[-1]
        if isinstance(top.node, SequenceNode):
            top.node.items.append(node)
        elif top.key is None:
            self.fail("found a key that is not text", "keys are names")
        else:
            top.node.entries[top.key] = node
            top.key = None


def plain_data(node: Node) -> object:
    """The tree as dictionaries, lists, text and None; a quoted scalar becomes `Quoted`."""
    match node:
        case ScalarNode(text, _, True):
            return Quoted(text)
        case ScalarNode(text, _, False):
            return None if text in ("", "~", "null") else text
        case SequenceNode(items):
            return [plain_data(item) for item in items]
        case MappingNode(entries):
            return {key: plain_data(value) for key, value in entries.items()}
    raise AssertionError(f"unknown node {node!r}")


def line_table(root: MappingNode) -> dict[str, int]:
    """Line of every key, by dotted path: ``initial.x``, ``requirements.0.avoid``; list items count from 0."""
    table: dict[str, int] = {}

    def visit(node: Node, prefix: str) -> None:
        if isinstance(node, MappingNode):
            for key, child in node.entries.items():
                table[prefix + key] = node.key_lines[key]
                visit(child, f"{prefix}{key}.")
        elif isinstance(node, SequenceNode):
            for index, child in enumerate(node.items):
                table[f"{prefix}{index}"] = child.line
                visit(child, f"{prefix}{index}.")

    visit(root, "")
    return table
