"""An export's queries put to external verifiers, side by side."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ...specs.errors import InputError
from ..executors.task import Answer, Broken, Executor, Task
from .ask import MORE_SECONDS, Asked
from .table import Agreement, Entry
from .tool import QueryFiles

POLL = 0.5
START_SECONDS = 60.0
"""What a worker gets beyond the tool's own limits, to start and to replay."""


def read_queries(folder: Path) -> list[QueryFiles]:
    """The queries of an export, in its order; every file is the one that its ``claims.json`` states.

    Parameters
    ----------
    folder : Path
        What `setrl export` wrote.

    Returns
    -------
    list of QueryFiles

    Raises
    ------
    InputError
        It is no export, or a file is missing or was changed.
    """
    place = folder / "claims.json"
    try:
        data = json.loads(place.read_bytes())
        networks = {entry["onnx"]: entry for entry in data["networks"]}
        queries: list[dict[str, Any]] = data["queries"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(
            f"this is no export of setrl: {error}", where=str(place), remedy="write one: setrl export POLICY --out DIR"
        ) from None
    described: dict[str, tuple[tuple[str, ...], int]] = {}
    for name, entry in networks.items():
        described[name] = _described(_content(folder, name, entry["sha256"]), name)
    found = []
    for entry in queries:
        for key in ("vnnlib", "vnnlib2"):
            _content(folder, entry[key], entry[f"{key}_sha256"])
        operators, inputs = described[entry["onnx"]]
        files = (folder / entry["onnx"], folder / entry["vnnlib"], folder / entry["vnnlib2"])
        found.append(QueryFiles(entry["query"], *files, operators, inputs))
    return found


def _content(folder: Path, name: str, digest: str) -> bytes:
    path = folder / name
    content = path.read_bytes() if path.is_file() else b""
    if hashlib.sha256(content).hexdigest() != digest:
        raise InputError("the file is not the one that was exported", where=str(path), remedy="write the export again")
    return content


def _described(content: bytes, name: str) -> tuple[tuple[str, ...], int]:
    """Operators and number of inputs of a network."""
    import onnx

    graph = onnx.load_model_from_string(content).graph
    given = {tensor.name for tensor in graph.initializer}
    shapes = [entry.type.tensor_type.shape.dim for entry in graph.input if entry.name not in given]
    if len(shapes) != 1:
        raise InputError(f"a network of one input is needed, this one has {len(shapes)}", where=name)
    size = 1
    for dimension in shapes[0]:
        size *= max(1, dimension.dim_value)
    return tuple(sorted({node.op_type for node in graph.node})), size


def crosscheck(
    queries: Sequence[QueryFiles],
    tools: Sequence[str],
    executor: Executor,
    *,
    seconds: float,
    memory: int,
    stop: Callable[[], bool] = lambda: False,
    watch: Callable[[Entry], None] = lambda entry: None,
) -> list[Entry] | None:
    """Ask every tool every query.

    Parameters
    ----------
    queries : sequence of QueryFiles
    tools : sequence of str
        Names of `ask.TOOLS`.
    executor : Executor
        Not entered yet.
    seconds : float
        Limit of a query; a tool that does not keep it is killed.
    memory : int
        Bytes that a tool may hold.
    stop : callable, optional
        Says when to give up.
    watch : callable, optional
        Called with every entry as it comes in.

    Returns
    -------
    list of Entry or None
        In the order of the tools, then of the queries; None where it was stopped.
    """
    wanted = [Asked(tool, query, seconds, memory) for tool in tools for query in queries]
    entries: dict[int, Entry] = {}
    with executor:
        for asked in wanted:
            limit = seconds + MORE_SECONDS + START_SECONDS
            executor.submit(Task("setrl.verify.crosscheck.ask:ask", asked, limit, None, asked.query.name))
        while len(entries) < len(wanted):
            if stop():
                return None
            for number, outcome in executor.wait(POLL):
                asked = wanted[number]
                if isinstance(outcome, Broken):
                    raise AssertionError(f"{outcome.sentence}\n{outcome.traceback}")
                if isinstance(outcome, Answer):
                    entry: Entry = outcome.value
                else:
                    lost = Agreement.UNDECIDED
                    entry = Entry(asked.query.name, asked.tool, "error", lost, outcome.seconds, outcome.sentence)
                entries[number] = entry
                watch(entry)
    return [entries[number] for number in range(len(wanted))]
