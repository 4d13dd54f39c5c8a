"""vibecheck-nn: CROWN-style bounds with branch and bound; VNN-LIB 2.0. GPL-3, hence only ever a subprocess."""

from __future__ import annotations

import re
from dataclasses import replace

from .installed import package_version, program
from .tool import Ended, QueryFiles, ToolAnswer, answered

OPERATORS = frozenset(
    {"Gemm", "MatMul", "Add", "Sub", "Mul", "Relu", "Tanh", "Sigmoid", "Sin", "Cos", "Concat", "Slice", "Flatten"}
)
_WORDS = {"unsat": "unsat", "sat": "sat", "unknown": "unknown", "timed-out": "timeout", "timeout": "timeout"}
_NUMBER = re.compile(r"-?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?", re.ASCII)


class Vibecheck:
    """The adapter of vibecheck-nn."""

    name = "vibecheck"

    def version(self) -> str:
        """As of the package."""
        return package_version("vibecheck-nn")

    def accepts(self, query: QueryFiles) -> str:
        """All its operators are known."""
        unknown = sorted(set(query.operators) - OPERATORS)
        return f"does not take {', '.join(unknown)}" if unknown else ""

    def command(self, query: QueryFiles, seconds: float) -> list[str]:
        """The command line of the VNN-LIB standard."""
        path = str(program("vibecheck", "vibecheck-nn"))
        network = f"N={query.network.absolute()}"
        soft = str(max(1, round(seconds)))
        return [
            path,
            "verify",
            str(query.version_2.absolute()),
            "--network",
            network,
            "--timeout",
            soft,
            "--device",
            "cpu",
        ]

    def interpret(self, ended: Ended, query: QueryFiles) -> ToolAnswer:
        """The verdict is a line of its own, an assignment follows it."""
        said, line = answered(ended, _WORDS)
        if said.answer != "sat":
            return said
        return replace(said, witness=_assignment(ended.out.splitlines()[line + 1 :], query.inputs))


def _assignment(said: list[str], inputs: int) -> tuple[float, ...]:
    """Values of X in either form: ``X real [1,4]`` with a number per line, or ``((X_0 v) ...``."""
    lines = [line.strip() for line in said]
    old = re.findall(r"\(X_[0-9]+ ([^()\s]+)\)", " ".join(lines), re.ASCII)
    if old:
        return tuple(map(float, old)) if len(old) == inputs else ()
    start = next((number for number, line in enumerate(lines) if line.startswith("X ")), None)
    if start is None:
        return ()
    values = [float(line) for line in lines[start + 1 : start + 1 + inputs] if _NUMBER.fullmatch(line)]
    return tuple(values) if len(values) == inputs else ()
