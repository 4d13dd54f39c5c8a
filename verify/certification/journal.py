"""Finished rows, one line each, only ever appended to: what a killed run had finished is still there.

A line is whole or it does not count: it carries the sha256 of its own text. What a killed process left of a line is
cut off when the journal is opened again.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from ...specs.errors import InputError
from ...specs.files import write_atomically
from ...specs.folders import unwritable
from ..report import json_data
from .document import Row, row_from_json

FORMAT = "setrl-journal/1"
HEADER = json.dumps({"format": FORMAT}).encode() + b"\n"
KEPT = 2
"""The file is rewritten where it has so many times more lines than there are rows."""


@dataclass
class Journal:
    """Rows by key.

    Attributes
    ----------
    path : Path
    rows : dict of key to Row
        The newest of every key.
    damaged : int
        Lines that do not count.
    """

    path: Path
    rows: dict[str, Row] = field(default_factory=dict)
    damaged: int = 0
    _lines: int = 0
    _file: IO[bytes] | None = None

    @classmethod
    def read(cls, path: Path) -> Journal:
        """Read a journal; one that is not there is empty.

        Raises
        ------
        InputError
            The file is there and is no journal: it is not touched.
        """
        journal = cls(path)
        try:
            content = path.read_bytes() if path.exists() else b""
        except OSError as error:
            raise unwritable(path, error) from None
        if content and not content.startswith(HEADER) and not HEADER.startswith(content):
            raise InputError(
                f"the file is no journal of this version ({FORMAT}): it is not replaced",
                where=str(path),
                remedy="choose another folder with --out, or move the file away",
            )
        # what follows the last line's end was not finished: it will be cut off, so it does not count here either
        for line in content[len(HEADER) :].split(b"\n")[:-1]:
            journal._take(line)
        return journal

    def _take(self, line: bytes) -> None:
        self._lines += 1
        digest, _, text = line.partition(b" ")
        if hashlib.sha256(text).hexdigest().encode() != digest:
            self.damaged += 1
            return
        try:
            row = row_from_json(json.loads(text))
        except (InputError, ValueError, RecursionError):  # whole, but written by a program with other rows
            self.damaged += 1
            return
        self.rows[row.key] = row

    def __enter__(self) -> Self:
        """Open for appending; a last line that was not finished is cut off."""
        try:
            if self._lines > 1000 and self._lines > KEPT * len(self.rows):
                write_atomically(self.path, HEADER + b"".join(_line(row) for row in self.rows.values()))
                self._lines = len(self.rows)
            self._file = open(self.path, "a+b")
            self._file.seek(0)
            content = self._file.read()
            whole = content.rfind(b"\n") + 1
            self._file.truncate(whole)
            if not whole:
                self._file.write(HEADER)
            self._sync()
        except OSError as error:
            raise unwritable(self.path, error) from None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file."""
        if self._file is not None:
            try:
                self._file.close()
            except OSError as reason:  # of a line that `append` could not write and has reported, if there is one
                if error is None:
                    raise unwritable(self.path, reason) from None
            finally:
                self._file = None

    def append(self, row: Row) -> None:
        """Enter a row; it is on the disk when this returns."""
        if self._file is None:
            raise AssertionError("the journal is not open")
        try:
            self._file.write(_line(row))
            self._sync()
        except OSError as error:
            raise unwritable(self.path, error) from None
        self.rows[row.key] = row
        self._lines += 1

    def _sync(self) -> None:
        if self._file is not None:
            self._file.flush()
            os.fsync(self._file.fileno())


def _line(row: Row) -> bytes:
    data: Any = json_data(asdict(row))
    text = json.dumps(data, ensure_ascii=True, separators=(",", ":"), allow_nan=False).encode()
    return hashlib.sha256(text).hexdigest().encode() + b" " + text + b"\n"
