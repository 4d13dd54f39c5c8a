"""A hard question in parts: boxes that cover the initial set, decided side by side, and their answers as one."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np

from .certificate import join_certificates
from .certified import certified
from .deadline import Deadline
from .evidence_files import evidence_files
from .result import Flowpipe, Reason, RequirementResult, Result, Value, Verdict
from .verifier import Part


@dataclass(frozen=True)
class Cut:
    """How an initial set is cut.

    Attributes
    ----------
    tree : tuple
        In preorder: ``[state, cut]`` before its lower and its upper half, None where a part is.
    parts : tuple of Part
        In the order of the tree.
    """

    tree: tuple[Any, ...]
    parts: tuple[Part, ...]


def cut_like(result: Result, most: int) -> Cut:
    """Cut the initial set as a search has begun to cut it, into so many parts at most.

    Parameters
    ----------
    result : Result
        Its first cuts, the earliest of every branch, are taken over.
    most : int
        Number of parts.

    Returns
    -------
    Cut
        One part where the search has cut nothing.
    """
    root = _nested(iter(result.cover))
    waiting, opened = deque([root]), list[Any]()
    leaves = 1
    while waiting and leaves < most:
        node = waiting.popleft()
        if node.cut is None:
            continue
        opened.append(node)
        leaves += 1
        waiting += node.halves
    tree: list[Any] = []
    parts: list[Part] = []

    def visit(node: _Node, box: Part) -> None:
        if node.cut is None or not any(node is other for other in opened):
            tree.append(None)
            parts.append(box)
            return
        state, text = node.cut
        tree.append([state, text])
        at = Fraction(text)
        low, high = box[state]
        for half, bounds in zip(node.halves, ((low, at), (at, high)), strict=True):
            visit(half, (*box[:state], bounds, *box[state + 1 :]))

    visit(root, tuple(result.loop.initial))
    return Cut(tuple(tree), tuple(parts))


def joined(whole: Result, cut: Cut, results: Sequence[Result], deadline: Deadline) -> Result:
    """The answer about the whole initial set from those about its parts.

    VERIFIED where every part is CLAIMED and the checker accepts the certificate that their certificates make together;
    FALSIFIED where one part is; UNKNOWN otherwise.

    Parameters
    ----------
    whole : Result
        Of the search that was cut: whose question it is.
    cut : Cut
    results : sequence of Result
        One per part, in order; from `verifier.verify_radii` with that part.
    deadline : Deadline
        For the checker.

    Returns
    -------
    Result
    """
    if len(results) != len(cut.parts):
        raise AssertionError("every part needs an answer")
    for part, result in zip(cut.parts, results, strict=True):
        if tuple(result.loop.initial) != part:
            raise AssertionError("an answer is about another part")
    merged = _merged(whole, cut, results)
    refuted = next((result for result in results if result.verdict is Verdict.FALSIFIED), None)
    if refuted is not None:
        found = (refuted.reason, refuted.candidate, refuted.witness)
        return replace(merged, verdict=Verdict.FALSIFIED, reason=found[0], candidate=found[1], witness=found[2])
    if not all(result.verdict is Verdict.CLAIMED and result.certificate is not None for result in results):
        return replace(merged, verdict=Verdict.UNKNOWN, reason=_reason(results, cut, whole))
    files = evidence_files(whole.loop, None)
    if isinstance(files, str):
        raise AssertionError(f"a part had its files, the whole has not: {files}")
    if len({result.semantics for result in results}) > 1:
        reason = Reason("the parts were proved for different arithmetics of the network", remedy="give spread: 1")
        return replace(merged, verdict=Verdict.UNKNOWN, reason=reason)
    content = join_certificates(cut.tree, [result.certificate or b"" for result in results])
    claim = replace(merged, verdict=Verdict.CLAIMED, reason=None, certificate=content)
    return certified(claim, files, deadline, workers=1)


@dataclass(frozen=True, eq=False)
class _Node:
    cut: Any
    halves: tuple[_Node, ...]


def _nested(nodes: Any) -> _Node:
    node = next(nodes)
    return _Node(node, () if node is None else (_nested(nodes), _nested(nodes)))


def _merged(whole: Result, cut: Cut, results: Sequence[Result]) -> Result:
    """What the parts say together, but for the verdict."""
    covers = iter([result.cover for result in results])
    cover: list[Any] = []
    for node in cut.tree:
        cover += next(covers) if node is None else [node]
    values = [result.value for result in results if result.value is not None]
    value = None
    if values:
        least = min(entry.discounted for entry in values), min(entry.undiscounted for entry in values)
        value = Value(*least, values[0].discount)
    pipes = [result.flowpipe for result in results]
    flowpipe = Flowpipe(
        pipes[0].period,
        pipes[0].states,
        *(np.concatenate([getattr(pipe, name) for pipe in pipes]) for name in ("points", "intervals", "margins")),
    )
    phases = dict.fromkeys(phase for result in [whole, *results] for phase in result.timings)
    notes = dict.fromkeys(note for result in results for note in result.notes if not note.startswith("not checked"))
    return replace(
        whole,
        requirements=tuple(_least(entries) for entries in zip(*(r.requirements for r in results), strict=True)),
        value=value,
        flowpipe=flowpipe,
        semantics=results[0].semantics,
        claim=results[0].claim,
        deployed_error=max(result.deployed_error for result in results),
        cells=whole.cells + sum(result.cells for result in results),
        leaves=sum(result.leaves for result in results),
        candidate=None,
        witness=None,
        certificate=None,
        timings={phase: sum(r.timings.get(phase, 0.0) for r in [whole, *results]) for phase in phases},
        notes=(*notes, f"decided in {len(results)} parts"),
        cover=tuple(cover),
    )


def _least(entries: Sequence[RequirementResult]) -> RequirementResult:
    """One requirement over all parts: the smallest margin, and proved where it is everywhere."""
    return replace(min(entries, key=lambda entry: entry.margin), proved=all(entry.proved for entry in entries))


def _reason(results: Sequence[Result], cut: Cut, whole: Result) -> Reason:
    """Why not: the first part that is not proved, and how much is."""
    open_parts = [result for result in results if result.reason is not None]
    first = open_parts[0].reason
    if first is None:
        raise AssertionError("nothing says why a part is not proved")
    share = sum(
        _volume(part, whole) * (1.0 if result.reason is None else result.reason.verified_part)
        for part, result in zip(cut.parts, results, strict=True)
    )
    until = min(result.reason.verified_until for result in open_parts if result.reason is not None)
    return replace(first, verified_part=share, verified_until=until)


def _volume(part: Part, whole: Result) -> float:
    """Share of the initial set's volume, over the states that are not fixed."""
    shares = [
        float((b - a) / (high - low))
        for (a, b), (low, high) in zip(part, whole.loop.initial, strict=True)
        if high > low
    ]
    return float(np.prod(shares))
