"""One query put to one tool, in a worker process: the tool's answer, and its counterexample looked at again."""

from __future__ import annotations

from dataclasses import dataclass

from ...specs.vnnlib_reader import parse_vnnlib
from .marabou import Marabou
from .process import run_limited
from .replay import Replay, replay
from .table import Agreement, Entry
from .tool import QueryFiles, Tool, ToolAnswer
from .vibecheck import Vibecheck

TOOLS: dict[str, type[Tool]] = {"vibecheck": Vibecheck, "marabou": Marabou}
"""Adapters by name."""

MORE_SECONDS = 10.0
"""What a tool gets beyond the limit that it is told, before it is killed: to start, and to say that its time is up."""


@dataclass(frozen=True)
class Asked:
    """A query for a tool.

    Attributes
    ----------
    tool : str
    query : QueryFiles
    seconds : float
    memory : int
        Bytes.
    """

    tool: str
    query: QueryFiles
    seconds: float
    memory: int


def ask(asked: Asked) -> Entry:
    """Put one query to one tool."""
    tool, query = TOOLS[asked.tool](), asked.query
    objection = tool.accepts(query)
    if objection:
        return Entry(query.name, tool.name, "", Agreement.NOT_ASKED, 0.0, objection)
    ended = run_limited(tool.command(query, asked.seconds), asked.seconds + MORE_SECONDS, asked.memory)
    said = tool.interpret(ended, query)
    if said.answer != "sat":
        agreement = Agreement.CONFIRMED if said.answer == "unsat" else Agreement.UNDECIDED
        return Entry(query.name, tool.name, said.answer, agreement, said.seconds, said.detail)
    text = query.version_1.read_bytes()
    found = replay(query.network.read_bytes(), parse_vnnlib(text, query.version_1.name), said.witness)
    return judged(query, tool.name, said, found)


def judged(query: QueryFiles, tool: str, said: ToolAnswer, found: Replay) -> Entry:
    """What a `sat` means once its counterexample was looked at."""
    agreement = {True: Agreement.CONTRADICTED, False: Agreement.MISTAKEN, None: Agreement.UNDECIDED}[found.violates]
    return Entry(query.name, tool, said.answer, agreement, said.seconds, found.sentence)
