"""What TensorBoard shows: scalars per seed, written as the package `tensorboard` writes them, without torch's writer.

That one starts a thread per file and imports all of TensorBoard. Here a record is appended where it arises, and the
file's name says nothing about the machine.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from ..specs.errors import InputError
from ..specs.folders import make_folder


class EventWriter:
    """Appends scalars ``<name>/<seed>`` to one event file.

    Parameters
    ----------
    folder : path
        Of the run's event files; made where it is missing. TensorBoard reads all of them as one.
    seeds : sequence of int
    completed : int
        Where a run is resumed: what older files say about later steps is no longer shown.

    Raises
    ------
    InputError
        Nothing can be written there.
    """

    def __init__(self, folder: str | os.PathLike[str], seeds: Sequence[int], *, completed: int = 0) -> None:
        from tensorboard.compat.proto import event_pb2, summary_pb2
        from tensorboard.summary.writer.record_writer import RecordWriter

        self.seeds = tuple(seeds)
        self._event, self._summary = event_pb2.Event, summary_pb2.Summary
        place = Path(folder)
        make_folder(place)
        try:
            # in the order of time, which is the order of reading
            path = place / f"events.out.tfevents.{time.time_ns():020d}.setrl"
            self._file = path.open("xb")
        except OSError as error:
            raise _unwritable(place, error) from None
        self.path = path
        self._records = RecordWriter(self._file)
        self._write(self._event(file_version="brain.Event:2"))
        if completed:
            start = event_pb2.SessionLog(status=event_pb2.SessionLog.START)
            self._write(self._event(step=completed + 1, session_log=start))
        self.flush()

    def add(self, step: int, values: Mapping[str, Any]) -> None:
        """Append the numbers of one step.

        Parameters
        ----------
        step : int
            Episode, or step of the second phase.
        values : mapping of name to array (S,)
            A NaN is left out.

        Raises
        ------
        InputError
            The file cannot be written.
        """
        scalars = [
            self._summary.Value(tag=f"{name}/{seed}", simple_value=number)
            for name, column in values.items()
            for seed, number in zip(self.seeds, np.asarray(column, dtype=np.float64).tolist(), strict=True)
            if number == number
        ]
        if scalars:
            self._write(self._event(step=step, summary=self._summary(value=scalars)))

    def flush(self) -> None:
        """Hand everything to the system, so that TensorBoard sees it.

        Raises
        ------
        InputError
            The file cannot be written.
        """
        try:
            self._file.flush()
        except OSError as error:
            raise _unwritable(self.path, error) from None

    def close(self) -> None:
        """Flush, and end; the file is closed even where that fails."""
        if not self._file.closed:
            try:
                self.flush()
            finally:
                with suppress(OSError):  # which the flush has reported
                    self._file.close()

    def _write(self, event: Any) -> None:
        event.wall_time = time.time()
        try:
            self._records.write(event.SerializeToString())
        except OSError as error:
            raise _unwritable(self.path, error) from None


def _unwritable(place: Path, error: OSError) -> InputError:
    reason = error.strerror or str(error)
    return InputError(
        f"cannot write the events: {reason}", where=str(place), remedy="make room on the disk, or choose another folder"
    )
