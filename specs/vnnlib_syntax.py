"""VNN-LIB text as lists of tokens that are closed from the inside out; nothing is recursive, everything has a cap."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

from .errors import InputError
from .exact import shown

MOST_BYTES = 16 * 1024 * 1024
MOST_DEPTH = 64

Close: TypeAlias = Callable[[list[Any], bool], Any]
"""What becomes of a closed list: of its items (tokens, and what became of inner lists), and whether it is outermost."""

_TOKEN = re.compile(
    r"(?P<skip>\s+|;[^\n]*)|(?P<token>[()]|\[[0-9,\s]*\]|[^\s()\[\];]+(?:\[[0-9,\s]*\])?)|(?P<other>.)",
    re.ASCII | re.DOTALL,
)


def text_of(content: bytes | str, source: str) -> str:
    """The text of a file.

    Raises
    ------
    InputError
        It is larger than `MOST_BYTES`, or not UTF-8.
    """
    if len(content) > MOST_BYTES:
        raise InputError(f"no query has more than {MOST_BYTES} bytes", where=source, remedy="ask about less at once")
    if isinstance(content, str):
        return content
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError("the file is not UTF-8 text", where=source, remedy="give a VNN-LIB file") from error


def leading_comment(text: str) -> str:
    """The comment before everything else, without its semicolons."""
    lines = []
    for line in text.splitlines():
        if line.strip() and not line.startswith(";"):
            break
        lines.append(line.removeprefix(";").strip())
    return "\n".join(lines).strip()


def close_lists(text: str, source: str, close: Close) -> None:
    """Read a text as a sequence of lists and close every one of them as soon as its parenthesis is.

    Parameters
    ----------
    text : str
    source : str
        Name of the file, for messages.
    close : callable
        Gets a list's items and whether it is outermost; what it returns is an item of the list around.

    Raises
    ------
    InputError
        With the line, for parentheses that do not match, more than `MOST_DEPTH` of them, text outside of lists, and
        whatever `close` complains about.
    """
    stack: list[tuple[int, list[Any]]] = []
    line = 1
    try:
        for token, line in _tokens(text):
            if token == "(":
                if len(stack) == MOST_DEPTH:
                    raise InputError(f"more than {MOST_DEPTH} nested parentheses", remedy="write it flat")
                stack.append((line, []))
            elif not stack:
                found = "a parenthesis too many" if token == ")" else f"{shown(token)} outside of parentheses"
                raise InputError(found, remedy="write (assert ...)")
            elif token == ")":
                _, items = stack.pop()
                value = close(items, not stack)
                if stack:
                    stack[-1][1].append(value)
            else:
                stack[-1][1].append(token)
        if stack:
            line = stack[-1][0]
            raise InputError("a parenthesis is never closed", remedy="is the file complete?")
    except InputError as error:
        raise error.at(f"{source}:{line}") from None


def _tokens(text: str) -> Iterator[tuple[str, int]]:
    """Tokens and their lines."""
    line = 1
    for found in _TOKEN.finditer(text):
        if found.lastgroup == "token":
            yield found[0], line
        elif found.lastgroup == "other":
            yield found[0], line  # a lone bracket: no name and no number, so whoever reads it refuses it
        line += found[0].count("\n")
