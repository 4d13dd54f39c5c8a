"""An answer to a query about a network, with the arithmetic for which it holds."""

from __future__ import annotations

import time
from dataclasses import dataclass
from math import prod
from typing import Any, Literal

from ...models.onnx_runtime import deployed_runner
from ...models.policy import Policy
from ...specs.errors import InputError, UsageError
from ...specs.queries import Query
from ..deadline import Deadline
from ..runtime_error import runtime_name
from .question import questions_of
from .replay import Counterexample
from .search import Budget, Outcome, search_all

SPLITS = 100_000
"""Default of the most cells."""

Word = Literal["unsat", "sat", "unknown", "timeout"]


@dataclass(frozen=True)
class Answer:
    """Result of `decide`.

    Attributes
    ----------
    word : {"unsat", "sat", "unknown", "timeout"}
    semantics : tuple of str
        Arithmetics for which the word holds: "real" is exact real arithmetic on the file's numbers; "float32" or
        "float64" is the network as the runtime runs it. Empty for "unknown" and "timeout".
    reason : str
        One sentence.
    counterexample : Counterexample or None
    cells : int
        Boxes that were bounded.
    seconds : float
    runtime : str
        Name and version of the runtime that is meant.
    """

    word: Word
    semantics: tuple[str, ...]
    reason: str
    counterexample: Counterexample | None
    cells: int
    seconds: float
    runtime: str

    def to_json(self) -> dict[str, Any]:
        """Plain data; a counterexample's inputs are exact, as text."""
        found = self.counterexample
        return {
            "answer": self.word,
            "semantics": list(self.semantics),
            "reason": self.reason,
            "counterexample": None
            if found is None
            else {"inputs": [str(x) for x in found.inputs], "outputs": list(found.outputs)},
            "cells": self.cells,
            "seconds": round(self.seconds, 3),
            "runtime": self.runtime,
        }


def decide(policy: Policy, query: Query, *, splits: int = SPLITS, deadline: Deadline | None = None) -> Answer:
    """Answer a query: `unsat` is a proof, `sat` has a counterexample that was replayed.

    Parameters
    ----------
    policy : Policy
        With the bytes it was read from.
    query : Query
    splits : int
        Most boxes that are bounded.
    deadline : Deadline, optional

    Returns
    -------
    Answer

    Raises
    ------
    InputError
        The query is about a network of other sizes, or too large.
    UsageError
        `splits` is not positive.
    """
    if splits < 1:
        raise UsageError(f"received {splits}", where="splits", remedy="use a positive whole number")
    for what, asked, given in (
        ("inputs", query.inputs, policy.inputs),
        ("outputs", query.outputs, policy.outputs),
    ):
        if prod(asked) != given:
            message = f"the query is about a network with {prod(asked)} {what}, this one has {given}"
            raise InputError(message, where=policy.name or None, remedy="give the network that the query is about")
    start = time.monotonic()
    budget = Budget(Deadline(None) if deadline is None else deadline, splits)
    questions = questions_of(query)
    runner = deployed_runner(policy)
    outcomes = list(search_all(policy, runner, questions, budget))
    word, semantics, reason = _conclusion(outcomes, budget, policy.precision)
    found = outcomes[-1].counterexample if outcomes else None
    return Answer(word, semantics, reason, found, budget.used, time.monotonic() - start, runtime_name())


def _conclusion(outcomes: list[Outcome], budget: Budget, precision: str) -> tuple[Word, tuple[str, ...], str]:
    """The word, for which arithmetics, and why; only what is proved of every question is said of the query."""
    if not outcomes:
        return "unsat", ("real", precision), "no input satisfies the bounds of any case"
    found = outcomes[-1].counterexample
    if found is not None:
        return "sat", found.semantics, f"the counterexample violates in {' and in '.join(found.semantics)} arithmetic"
    if all(outcome.real for outcome in outcomes):
        if all(outcome.deployed for outcome in outcomes):
            return "unsat", ("real", precision), f"no input violates, in real or in {precision} arithmetic"
        reason = f"no input violates in real arithmetic; the margin is less than what {precision} may be off"
        return "unsat", ("real",), reason
    if budget.deadline.expired:
        return ("unknown" if budget.deadline.interrupted else "timeout"), (), budget.deadline.word
    if budget.cells <= 0:
        return "unknown", (), "the cells were used up; allow more splits"
    return "unknown", (), "a cell too small to be halved is neither refuted nor violated"
