"""From a manifest to a report: the front door of batch certification."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

from ...specs.folders import locked, make_folder
from ...specs.manifest import Manifest
from ..executors.task import Executor
from .baseline import TOLERANCE, baseline_of, change_of, read_baseline
from .batch import Batch, Watch
from .document import Report, Row, Subject
from .gate import judged, worst
from .journal import Journal
from .plan import Planned, current_versions, plan

JOURNAL = "journal.jsonl"


def certify(
    manifest: Manifest,
    folder: Path,
    executor: Executor,
    *,
    spread: int = 1,
    cached: bool = True,
    recheck: bool = False,
    baseline: Path | None = None,
    tolerance: Fraction = TOLERANCE,
    stop: Callable[[], bool] = lambda: False,
    watch: Watch | None = None,
) -> Report | None:
    """Decide every row of a manifest and judge it.

    Parameters
    ----------
    manifest : Manifest
    folder : Path
        Output folder: certificates, witnesses and the journal; made where it is missing.
    executor : Executor
        Not entered yet.
    spread : int
        Parts of a hard row where the manifest says nothing.
    cached : bool
        Whether rows that have not changed keep their verdict on the word of the journal.
    recheck : bool
        Whether their certificates and witnesses are checked again.
    baseline : Path, optional
        Report of an earlier run.
    tolerance : Fraction
        By how much V(s0), margin or certified radius may fall below the baseline's.
    stop : callable, optional
        Says when to give up.
    watch : Watch, optional

    Returns
    -------
    Report or None
        None where it was stopped; what was finished is in the journal.

    Raises
    ------
    SetrlError
        The manifest names what is not there, or an output place or the baseline cannot be used.
    """
    started = time.monotonic()
    planned = plan(manifest, spread)
    earlier = None if baseline is None else read_baseline(baseline)
    make_folder(folder)
    with locked(folder, "certification"), Journal.read(folder / JOURNAL) as journal, executor:
        batch = Batch(planned, folder, journal, executor, cached, recheck, stop, watch or Watch())
        rows = batch.run()
    if rows is None:
        return None
    before = {} if earlier is None else {row.name: row for row in earlier[0].rows}
    compared = tuple(_judged(row, ahead, before, tolerance) for row, ahead in zip(rows, planned, strict=True))
    return Report(
        Subject(Path(manifest.source).name, manifest.digest),
        current_versions(),
        compared,
        worst(row.exit_code for row in compared),
        None
        if baseline is None or earlier is None
        else baseline_of(earlier[0], baseline.name, earlier[1], compared, tolerance),
        time.monotonic() - started,
    )


def _judged(row: Row, planned: Planned, before: dict[str, Row], tolerance: Fraction) -> Row:
    """A row before the gate: with what the baseline says about it, and without an earlier run's judgement."""
    earlier = before.get(row.name)
    plain = replace(row, change=None, objections=())
    return judged(plain, planned, None if earlier is None else change_of(earlier, plain, tolerance))
