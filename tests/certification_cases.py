"""Tables, rows and a scripted executor for the tests of batch certification."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, Self

from setrl.models.example import POLICIES
from setrl.specs.errors import SetrlError
from setrl.specs.manifest import Entry, Manifest, parse_manifest
from setrl.verify.certification.document import (
    Outcome,
    RadiusFound,
    RequirementRow,
    Row,
    Subject,
    ValueRow,
    Why,
)
from setrl.verify.certification.plan import Planned, plan
from setrl.verify.executors.task import Answer, Broken, Refused, Task, TaskOutcome

HEAD = "setrl: 1\ncertify:\n"
PLANT = "states: {z: m, v: m/s}\ninputs: {a: m/s^2}\ndynamics: {z: v, v: a}\n"
SPECIFICATION = """\
setrl: 1
plant: ../plants/mine.yaml
controller: {period: 0.1}
horizon: 0.2
initial: {z: [-0.1, 0.1], v: 0}
perturbation: {observation: 0.01}
requirements: [{stay: {z: [-1, 1]}, name: altitude}]
reward: {weights: {z: 1}, discount: 0.99}
"""


def workshop(folder: Path) -> Path:
    """A folder with two policies, a specification and its plant, each in a folder of its kind."""
    for name, content in {
        "policies/set.onnx": (POLICIES / "quadrotor1d-set.onnx").read_bytes(),
        "policies/point.onnx": (POLICIES / "quadrotor1d-point.onnx").read_bytes(),
        "specs/own.yaml": SPECIFICATION.encode(),
        "plants/mine.yaml": PLANT.encode(),
    }.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


def table(folder: Path, *entries: str, head: str = HEAD) -> Manifest:
    """A manifest in a folder; every entry is the inside of a flow mapping, the first is on line 3."""
    return parse_manifest(head + "".join(f"  - {{{entry}}}\n" for entry in entries), str(folder / "fleet.yaml"))


def planned_of(folder: Path, *entries: str, spread: int = 1) -> tuple[Planned, ...]:
    return plan(table(folder, *entries), spread)


def ahead(
    name: str = "a x b",
    *,
    search: Any = None,
    allow_unknown: bool = False,
    expected: tuple[str, ...] = (),
    value: Fraction | None = None,
    margin: Fraction | None = None,
) -> Planned:
    """A planned row with nothing behind it, for what only reads its demands."""
    entry = Entry(("a",), ("b",), (None,), search, expected, value, margin, allow_unknown, Fraction(300), 4 << 30, None)
    nothing = Subject("", "")
    return Planned(name, "key", entry, nothing, nothing, nothing, None, search, allow_unknown, None)


def row(
    outcome: Outcome = Outcome.VERIFIED,
    *,
    name: str = "a x b",
    key: str = "key",
    value: float | None = None,
    margins: tuple[float | None, ...] = (),
    radius: str | None = "",
    **more: Any,
) -> Row:
    """A row of which little is known; `radius` is "" where the row is no search."""
    subjects = Subject("a", "0" * 64), Subject("b", "1" * 64), Subject("", "")
    found = Row(
        name,
        key,
        *subjects,
        epsilon=None,
        outcome=outcome,
        why=None if outcome is Outcome.VERIFIED else Why("proof", f"it is {outcome.value}"),
        requirements=tuple(
            RequirementRow(f"r{place}", "avoid", outcome is Outcome.VERIFIED, margin, 0.5, place, (margin, None))
            for place, margin in enumerate(margins)
        ),
        value=None if value is None else ValueRow(value, value, 0.99),
        radius=None if radius == "" else RadiusFound(radius, None, "0.001", (("0", "VERIFIED"), ("1", "UNKNOWN"))),
    )
    return replace(found, **more)


Script = Callable[[Task], TaskOutcome | None]


def inline(task: Task) -> TaskOutcome:
    """What a worker process would answer, from this one."""
    module, name = task.function.split(":")
    try:
        return Answer(getattr(importlib.import_module(module), name)(task.argument), 0.125)
    except SetrlError as error:
        return Refused(str(error))
    except AssertionError as error:
        return Broken(f"AssertionError: {error}")


@dataclass
class Scripted:
    """An executor in this process: runs its tasks in order, but for those that a script answers.

    Attributes
    ----------
    script : callable
        An outcome instead of the task's own, or None.
    tasks : list of Task
        All that were submitted.
    most : int
        Largest number of tasks that were held at a time.
    backwards : bool
        Whether the youngest task is done first.
    """

    script: Script = lambda task: None
    backwards: bool = False
    workers: int = 1
    tasks: list[Task] = field(default_factory=list)
    most: int = 0
    left: bool = False
    _queue: list[int] = field(default_factory=list)

    def submit(self, task: Task) -> int:
        self.tasks.append(task)
        self._queue.append(len(self.tasks) - 1)
        self.most = max(self.most, len(self._queue))
        return len(self.tasks) - 1

    def wait(self, seconds: float) -> list[tuple[int, TaskOutcome]]:
        if not self._queue:
            return []
        number = self._queue.pop(-1 if self.backwards else 0)
        return [(number, self.script(self.tasks[number]) or inline(self.tasks[number]))]

    def running(self) -> list[tuple[int, float]]:
        return [(number, 1.0) for number in self._queue[:1]]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: Any) -> None:
        self.left = True

    @property
    def functions(self) -> list[str]:
        """What was called, in the order of submission."""
        return [task.function.rpartition(":")[2] for task in self.tasks]


def names(rows: Sequence[Row | Planned]) -> list[str]:
    return [each.name for each in rows]
