"""Marabou: simplex with case splits; VNN-LIB 1.0; without Sin, Cos and Slice. BSD."""

from __future__ import annotations

import re
from dataclasses import replace

from .installed import package_version, program
from .tool import Ended, QueryFiles, ToolAnswer, answered

OPERATORS = frozenset({"Gemm", "MatMul", "Add", "Sub", "Relu", "LeakyRelu", "Sigmoid", "Tanh", "Flatten", "Concat"})
_WORDS = {"unsat": "unsat", "sat": "sat", "UNKNOWN": "unknown", "unknown": "unknown", "TIMEOUT": "timeout"}
_INPUT = re.compile(r"^\s*x([0-9]+) = (\S+)$", re.MULTILINE | re.ASCII)


class Marabou:
    """The adapter of maraboupy."""

    name = "marabou"

    def version(self) -> str:
        """As of the package."""
        return package_version("maraboupy")

    def accepts(self, query: QueryFiles) -> str:
        """All its operators are known."""
        unknown = sorted(set(query.operators) - OPERATORS)
        return f"does not take {', '.join(unknown)}" if unknown else ""

    def command(self, query: QueryFiles, seconds: float) -> list[str]:
        """Network and property; its time limit is in whole seconds."""
        path = str(program("Marabou", "maraboupy"))
        files = [str(query.network.absolute()), str(query.version_1.absolute())]
        return [path, *files, "--timeout", str(max(1, round(seconds)))]

    def interpret(self, ended: Ended, query: QueryFiles) -> ToolAnswer:
        """The verdict is a line of its own, an assignment of few digits follows it."""
        said, _ = answered(ended, _WORDS)
        if said.answer != "sat":
            return said
        values = tuple(float(text) for _, text in _INPUT.findall(ended.out))
        return replace(said, witness=values if len(values) == query.inputs else ())
