"""The search: every part of a box is looked at, and what is said of a query is proved of all of its questions."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import pytest
from vnnlib_queries import F, at_most, below, deep, linear, monotone, planar, query_of, smooth

from setrl.models.onnx_reader import read_policy
from setrl.specs.errors import InputError, UsageError
from setrl.specs.queries import Case
from setrl.specs.specification import Bounds
from setrl.verify.deadline import Deadline
from setrl.verify.open_loop import decide as decisions
from setrl.verify.open_loop import search
from setrl.verify.open_loop.decide import decide
from setrl.verify.open_loop.question import questions_of
from setrl.verify.open_loop.search import Outcome

SATISFIABLE = [planar(seed, F(1, 1000)) for seed in range(4)] + [linear(seed, F(1, 1000)) for seed in range(3)]


@pytest.mark.parametrize("cells", [1, 3, 512])
def test_no_part_of_a_box_is_forgotten(cells: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nobody looks for counterexamples, cells that violate stay open for ever."""
    monkeypatch.setattr(search, "MOST_CELLS", cells)
    monkeypatch.setattr(search.Search, "attack", lambda self: None)
    monkeypatch.setattr(search.Search, "try_cells", lambda self, *_: None)
    for known in SATISFIABLE:
        answer = decide(read_policy(known.content), known.query, splits=120)
        assert answer.word == "unknown" and 120 - cells < answer.cells <= 120


def test_a_point_that_violates_is_not_refuted_because_it_has_no_halves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search.Search, "attack", lambda self: None)
    monkeypatch.setattr(search.Search, "try_cells", lambda self, *_: None)
    known = SATISFIABLE[0]
    box = (Bounds(F(1, 2), F(1, 2)), Bounds(F(1, 4), F(1, 4)))
    answer = decide(read_policy(known.content), query_of(2, 2, [Case(box, (at_most(F(1000), [F(1), F(0)]),))]))
    assert (answer.word, answer.semantics) == ("unknown", ())
    assert "too small to be halved" in answer.reason


def test_a_point_beside_a_box_is_told_from_it() -> None:
    known = SATISFIABLE[0]
    policy = read_policy(known.content)
    (question,) = questions_of(known.query)
    running = search.Search(policy, policy, question, search.Budget(Deadline(None), 10))
    every = np.ones((2, 1), dtype=bool)
    cells = search.Cells(np.array([[0.5, 0.5], [0.0, 0.0]]), np.array([[0.5, 0.5], [1.0, 1.0]]), every, every)
    waiting: deque[search.Cells] = deque()
    assert not running.split(cells, running.bound(cells), every[:, 0], every, waiting)
    (halves,) = waiting
    assert len(halves.low) == 2


def test_a_violation_that_is_not_proved_in_exact_arithmetic_is_not_claimed_there() -> None:
    """One that misses by less than any enclosure in float64 can tell."""
    claimed = 0
    for seed in range(6):
        known = monotone(seed, F(1, 1000))
        point = tuple(Bounds(F(1, 2 + i), F(1, 2 + i)) for i in (0, 2, 6))
        policy = read_policy(known.content)
        value = below(smooth(policy.layers, [bounds.lower for bounds in point])[0])
        for margin in (F(1, 10**20), F(-1, 1000)):
            answer = decide(policy, query_of(3, 1, [Case(point, (at_most(-value - margin, [F(-1)]),))]))
            assert ("real" in answer.semantics and answer.word == "sat") == (margin < 0), answer
            claimed += margin < 0
    assert claimed == 6


def test_the_size_of_batches_changes_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    queries = [planar(seed, F(-1, 1000)) for seed in range(3)] + [deep(0, False)]
    monkeypatch.setattr(search, "MOST_CELLS", 2)
    for known in queries:
        assert decide(read_policy(known.content), known.query, splits=3000).word == "unsat"


REFUTED, REALLY, OPEN = Outcome(None, True, True), Outcome(None, True, False), Outcome(None, False, False)


@pytest.mark.parametrize(
    ("outcomes", "word", "semantics"),
    [
        ((REFUTED, REFUTED), "unsat", ("real", "float32")),
        ((REFUTED, REALLY), "unsat", ("real",)),
        ((REALLY, REFUTED), "unsat", ("real",)),
        ((REFUTED, OPEN), "unknown", ()),
        ((OPEN, REFUTED), "unknown", ()),
        ((REALLY, OPEN), "unknown", ()),
    ],
)
def test_only_what_is_proved_of_every_question_is_said_of_the_query(
    outcomes: Any, word: str, semantics: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(decisions, "search_all", lambda *_: iter(outcomes))
    known = deep(0, False)
    answer = decide(read_policy(known.content), known.query)
    assert (answer.word, answer.semantics) == (word, semantics)


@pytest.mark.parametrize(("interrupted", "word"), [(False, "timeout"), (True, "unknown")])
def test_a_search_that_is_stopped_says_why(interrupted: bool, word: str) -> None:
    known = planar(0, F(-1, 1000))
    deadline = Deadline(None, interrupted=True) if interrupted else Deadline.after(0.0)
    answer = decide(read_policy(known.content), known.query, deadline=deadline)
    assert (answer.word, answer.semantics, answer.cells) == (word, (), 0)


def test_wrong_arguments_are_errors() -> None:
    known, other = deep(0, False), planar(0, F(1))
    with pytest.raises(UsageError):
        decide(read_policy(known.content), known.query, splits=0)
    with pytest.raises(InputError, match="a network with 2 inputs, this one has 3"):
        decide(read_policy(known.content), other.query)
