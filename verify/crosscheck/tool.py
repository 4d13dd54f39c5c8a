"""What a verifier of networks is asked and what it answers; an adapter answers three questions about its tool."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

ANSWERS = ("unsat", "sat", "unknown", "timeout", "error")
"""VNN-COMP's words; `error` is a tool that ended without one of them."""


@dataclass(frozen=True)
class QueryFiles:
    """One query about one network, in both versions of the language.

    Attributes
    ----------
    name : str
        Unique in its table.
    network : Path
        ONNX file.
    version_1, version_2 : Path
        The query as VNN-LIB 1.0 and 2.0; in the latter the network is called N.
    operators : tuple of str
        ONNX operators of the network.
    inputs : int
        Numbers that the network takes.
    """

    name: str
    network: Path
    version_1: Path
    version_2: Path
    operators: tuple[str, ...]
    inputs: int


@dataclass(frozen=True)
class ToolAnswer:
    """What a tool said.

    Attributes
    ----------
    answer : str
        One of `ANSWERS`.
    seconds : float
        Wall time of its process.
    witness : tuple of float
        Of a `sat`: the network's input; empty where the tool printed none.
    detail : str
        Of an `error`, one line.
    """

    answer: str
    seconds: float
    witness: tuple[float, ...] = ()
    detail: str = ""


@dataclass(frozen=True)
class Ended:
    """How a tool's process ended.

    Attributes
    ----------
    code : int or None
        Exit code; None where it was killed at its time limit.
    out, err : str
    seconds : float
    """

    code: int | None
    out: str
    err: str
    seconds: float


class Tool(Protocol):
    """An external verifier."""

    name: str

    def version(self) -> str:
        """Name and version of what is installed.

        Raises
        ------
        UsageError
            It is not installed; says how to install it.
        """

    def accepts(self, query: QueryFiles) -> str:
        """Why the tool cannot read a query; "" where it can."""

    def command(self, query: QueryFiles, seconds: float) -> list[str]:
        """The command line; `seconds` is a soft limit for tools that take one."""

    def interpret(self, ended: Ended, query: QueryFiles) -> ToolAnswer:
        """The answer in what the process wrote."""


def answered(ended: Ended, words: Mapping[str, str]) -> tuple[ToolAnswer, int]:
    """The last line of the output that is one of a tool's words, and its number; -1 where there is none.

    A program that failed after it said `unsat` proved nothing.
    """
    if ended.code is None:
        return ToolAnswer("timeout", ended.seconds), -1
    lines = [line.strip() for line in ended.out.splitlines()]
    places = [number for number, line in enumerate(lines) if line in words]
    if places and not (words[lines[places[-1]]] == "unsat" and ended.code != 0):
        return ToolAnswer(words[lines[places[-1]]], ended.seconds), places[-1]
    said = (ended.err.strip() or ended.out.strip()).splitlines()
    last = said[-1][:200] if said else "it said nothing"
    return ToolAnswer("error", ended.seconds, detail=f"exit {ended.code}: {last}"), -1
