"""Runs the rows of a plan: cached ones from the journal, the others in an executor's processes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ...specs.exact import decimal_text
from ...specs.files import write_atomically
from ...specs.folders import make_folder
from ...specs.reader import digest
from ..executors.task import Answer, Broken, Executor, Task, TaskOutcome
from ..result import Result
from .document import Evidence, Outcome, Row, Source, Why
from .figures import Figures
from .journal import Journal
from .plan import Planned
from .rows import blank, is_about, keeps, slug, without_answer
from .work import Hard

HARD_LIMIT = 1.5, 30.0
"""A row ends by itself when its time is up; what does not is killed at so many times its limit, plus these seconds."""

CERTIFICATES, WITNESSES = "certificates", "witnesses"
_SUFFIX = {"certificate": (CERTIFICATES, "cert"), "witness": (WITNESSES, "json")}
POLL = 0.5
AHEAD = 64
"""Tasks that wait in the executor beside those that run."""


@dataclass
class Watch:
    """What is told while a batch runs; this one says nothing.

    Methods are called from one thread.
    """

    def begin(self, planned: Sequence[Planned], workers: int) -> None:
        """All rows, before the first one is looked at."""

    def finished(self, row: Row) -> None:
        """A row is decided; a report judges it later."""

    def running(self, names: Sequence[tuple[str, float]]) -> None:
        """Rows that are being worked on, and for how many seconds; now and then."""


@dataclass
class _Spread:
    """A hard row whose parts are being decided."""

    hard: Hard
    results: list[Result | None]


@dataclass
class Batch:
    """One run over a plan.

    Attributes
    ----------
    planned : sequence of Planned
    folder : Path
        Output folder: certificates and witnesses are written below it.
    journal : Journal
        Open.
    executor : Executor
        Open.
    cached : bool
        Whether the journal's word is taken.
    recheck : bool
        Whether evidence that the journal refers to is checked again.
    stop : callable
        Says when to give up; what is finished by then is in the journal.
    watch : Watch
    """

    planned: Sequence[Planned]
    folder: Path
    journal: Journal
    executor: Executor
    cached: bool = True
    recheck: bool = False
    stop: Callable[[], bool] = field(default_factory=lambda: lambda: False)
    watch: Watch = field(default_factory=Watch)
    _rows: dict[str, Row] = field(default_factory=dict)
    _tasks: dict[int, tuple[str, Any]] = field(default_factory=dict)
    _same: dict[str, list[Planned]] = field(default_factory=dict)
    _spread: dict[str, _Spread] = field(default_factory=dict)
    _seconds: dict[str, float] = field(default_factory=dict)
    _remarks: dict[str, str] = field(default_factory=dict)
    _waiting: deque[Callable[[], None]] = field(default_factory=deque)

    def run(self) -> tuple[Row, ...] | None:
        """Every row, in the plan's order and not judged yet; None where it was stopped before."""
        self.watch.begin(self.planned, self.executor.workers)
        for planned in self.planned:
            self._start(planned)
        while self._tasks or self._waiting:
            if self.stop():
                return None
            self._feed()
            for number, outcome in self.executor.wait(POLL):
                self._take(number, outcome)
            names = [
                (self._tasks[number][0], seconds)
                for number, seconds in self.executor.running()
                if number in self._tasks
            ]
            self.watch.running([(self._same[key][0].name, seconds) for key, seconds in names])
        return tuple(self._rows[planned.name] for planned in self.planned)

    def _start(self, planned: Planned) -> None:
        """Answer from the journal, or queue the row's first task."""
        if planned.question is None:
            self._finish(planned, blank(planned, Outcome.ERROR, Why("input", planned.problem)))
            return
        first = planned.key not in self._same
        self._same.setdefault(planned.key, []).append(planned)
        if not first:  # the same question under another name
            decided = self._rows.get(self._same[planned.key][0].name)
            if decided is not None:
                self._finish(planned, decided)
            return
        known = self.journal.rows.get(planned.key) if self.cached else None
        content = None if known is None else self._evidence(known)
        if known is None or not keeps(known) or (known.evidence is not None and content is None):
            self._waiting.append(lambda: self._submit(planned, "decide", planned.question))
        elif self.recheck and content is not None:
            self._waiting.append(lambda: self._look_again(planned, known))
        else:
            self._finish(planned, replace(known, source=Source.JOURNAL))

    def _look_again(self, planned: Planned, known: Row) -> None:
        content = self._evidence(known)
        if content is None:
            self._again(planned, "it is no longer there")
            return
        self._submit(planned, "look_again", (planned.question, content, replace(known, picture=None)))

    def _feed(self) -> None:
        """Give the executor the next tasks, and no more than it soon needs: it holds a copy of all their files."""
        while self._waiting and len(self._tasks) < self.executor.workers + AHEAD:
            self._waiting.popleft()()

    def _evidence(self, row: Row) -> bytes | None:
        """The bytes that the journal's entry is about; None where they are not there."""
        if row.evidence is None:
            return None
        path = self.folder / row.evidence.path
        try:
            content = path.read_bytes() if path.is_file() else b""
        except OSError:  # it cannot be read: the same as if it were not there
            return None
        return content if digest(content) == row.evidence.sha256 else None

    def _submit(self, planned: Planned, function: str, argument: Any, role: Any = None) -> None:
        entry = planned.entry
        factor, more = HARD_LIMIT
        task = Task(
            f"setrl.verify.certification.{'again' if function == 'look_again' else 'work'}:{function}",
            argument,
            factor * float(entry.timeout) + more,
            entry.memory,
            planned.name,
        )
        self._tasks[self.executor.submit(task)] = planned.key, function if role is None else (function, role)

    def _take(self, number: int, outcome: TaskOutcome) -> None:
        key, role = self._tasks.pop(number)
        planned = self._same[key][0]
        self._seconds[key] = self._seconds.get(key, 0.0) + outcome.seconds
        if not isinstance(outcome, Answer):
            if role == "look_again" and not isinstance(outcome, Broken):
                self._again(planned, outcome.sentence)
            elif planned.name not in self._rows:
                self._spread.pop(key, None)
                self._enter(planned, without_answer(planned, outcome))
            return
        value = outcome.value
        if role == "look_again":
            if value == "":
                for each in self._same[key]:
                    self._finish(each, replace(self.journal.rows[key], source=Source.RECHECKED))
            else:
                self._again(planned, value)
        elif isinstance(value, Figures):
            self._enter(planned, self._row(planned, value), value)
        elif isinstance(value, Hard):
            self._scatter(planned, value)
        elif isinstance(role, tuple) and key in self._spread:
            self._gather(planned, role[1], value)

    def _again(self, planned: Planned, why: str) -> None:
        """Old evidence is not accepted: the row is proved again."""
        self._remarks[planned.key] = f"the evidence of an earlier run was not accepted again: {why}"
        self._submit(planned, "decide", planned.question)

    def _scatter(self, planned: Planned, hard: Hard) -> None:
        """A hard row's parts, side by side; together they may use as many cells as the row."""
        if planned.question is None:
            raise AssertionError("a row without a question has no parts")
        count = len(hard.cut.parts)
        self._spread[planned.key] = _Spread(hard, [None] * count)
        splits = max(1, planned.question.numerics().splits // count)
        for position, part in enumerate(hard.cut.parts):
            self._submit(planned, "decide_part", (planned.question, part, splits), position)

    def _gather(self, planned: Planned, position: int, result: Result) -> None:
        spread = self._spread[planned.key]
        spread.results[position] = result
        results = [entry for entry in spread.results if entry is not None]
        if len(results) == len(spread.results):
            del self._spread[planned.key]
            self._submit(planned, "join", (planned.question, spread.hard, results))

    def _row(self, planned: Planned, figures: Figures) -> Row:
        """A row from its figures; the evidence is on the disk before anything refers to it."""
        evidence = None
        if figures.kind and not is_about(figures, planned):
            # a plant's path may be absolute: then it is the worker that reads it, later and maybe elsewhere
            problem = "the plant's file is not the one that the table was made with: it has changed meanwhile"
            return blank(planned, Outcome.ERROR, Why("input", problem, remedy="run setrl certify again"))
        if figures.kind:
            name, suffix = _SUFFIX[figures.kind]
            path = f"{name}/{slug(planned)}-{planned.key[:12]}.{suffix}"
            make_folder(self.folder / name)
            write_atomically(self.folder / path, figures.evidence)
            evidence = Evidence(figures.kind, path, digest(figures.evidence), len(figures.evidence), figures.detail)
        return replace(blank(planned, Outcome.UNKNOWN, None), **figures.row, evidence=evidence)

    def _enter(self, planned: Planned, row: Row, figures: Figures | None = None) -> None:
        """A row is decided: into the journal first."""
        timings = {**row.timings, "total": self._seconds.get(planned.key, 0.0)}
        remark = self._remarks.get(planned.key)
        row = replace(row, timings=timings, notes=(*row.notes, remark) if remark else row.notes)
        self.journal.append(row)
        for each in self._same[planned.key]:
            self._finish(each, row)

    def _finish(self, planned: Planned, row: Row) -> None:
        """The row under its own name: the journal's may have been another one."""
        own = replace(
            row,
            name=planned.name,
            policy=planned.policy,
            specification=planned.specification,
            plant=planned.plant,
            epsilon=None if planned.epsilon is None else decimal_text(planned.epsilon),
        )
        self._rows[planned.name] = own
        self.watch.finished(own)
