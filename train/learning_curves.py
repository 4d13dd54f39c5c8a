"""Learning curves: a row per episode and seed, appended while the run goes on, without a gap or a repetition on resume.

The rows of a run that was killed and resumed are those of a run that was not: text that is not covered by the
checkpoint is cut off before the first new row.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..specs.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

EPISODE_COLUMNS = ("episode", "seed", "return", "steps", "critic_loss", "actor_loss", "value")
"""Of the first phase; "value" is V(s0) at the validation radius, empty where it was not computed."""

_SMOOTHED = 0.01
"""Share of the run over which a drawn return is averaged."""


class LearningCurves:
    """Writer of one file of rows.

    Flush before a checkpoint is saved: rows that a checkpoint counts must be on the disk.

    Parameters
    ----------
    path : path
    seeds : sequence of int
        Every number has a row per seed, in this order.
    completed : int
        Episodes that are done: 0 for a new run, the checkpoint's where one is resumed. Rows after it are cut off.
    columns : tuple of str
        The first two are the counter (1, 2, ...) and the seed.

    Raises
    ------
    InputError
        The file cannot be written, or it is not this run's or lacks rows up to `completed`.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        seeds: Sequence[int],
        *,
        completed: int = 0,
        columns: tuple[str, ...] = EPISODE_COLUMNS,
    ) -> None:
        self.path = Path(path)
        self.seeds = tuple(seeds)
        self.completed = completed
        self.columns = columns
        header = ",".join(columns) + "\n"
        with _reported(self.path):
            content = self.path.read_bytes() if self.path.exists() else b""
            if completed == 0 or not content:
                content = header.encode()
                self.path.write_bytes(content)
            else:
                content = content[: self._covered(content, header.encode())]
                os.truncate(self.path, len(content))
            self._file = self.path.open("a", encoding="ascii", newline="")
        self.flush()

    def add(self, number: int, values: Mapping[str, Any]) -> None:
        """Append the rows of one episode.

        Parameters
        ----------
        number : int
            The one after the last.
        values : mapping of column to array (S,)
            A column that is missing, and a NaN, stay empty.

        Raises
        ------
        InputError
            The file cannot be written.
        """
        if number != self.completed + 1 or not set(values) <= set(self.columns[2:]):
            raise AssertionError(f"row {number} with {sorted(values)} after row {self.completed} of {self.columns}")
        empty = [""] * len(self.seeds)
        texts = [_texts(values[name], len(self.seeds)) if name in values else empty for name in self.columns[2:]]
        rows = zip(self.seeds, *texts, strict=True)
        with _reported(self.path):
            self._file.write("".join(f"{number},{seed},{','.join(row)}\n" for seed, *row in rows))
            self._file.flush()
        self.completed = number

    def flush(self) -> None:
        """Wait until every row is on the disk.

        Raises
        ------
        InputError
            The file cannot be written.
        """
        with _reported(self.path):
            self._file.flush()
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Flush, and end; the file is closed even where that fails."""
        if not self._file.closed:
            try:
                self.flush()
            finally:
                with suppress(OSError):  # which the flush has reported
                    self._file.close()

    def _covered(self, content: bytes, header: bytes) -> int:
        """Length of the text up to the last row of `completed`; every row before it is as it should be."""
        lines = content.splitlines(keepends=True)
        if lines[0] != header:
            raise _wrong(self.path, "the file has other columns than the run's learning curves")
        try:
            number = int(lines[1].split(b",", 1)[0]) if len(lines) > 1 else 1
        except ValueError:
            number = 1
        length, place = len(header), 1
        while number <= self.completed:
            for seed in self.seeds:
                start, line = f"{number},{seed},".encode(), lines[place] if place < len(lines) else b""
                if not (line.startswith(start) and line.endswith(b"\n") and line.count(b",") == len(self.columns) - 1):
                    raise _wrong(self.path, f"the row of {self.columns[0]} {number}, seed {seed} is missing")
                length += len(line)
                place += 1
            number += 1
        return length


@dataclass(frozen=True)
class Curves:
    """Learning curves as they were written.

    Attributes
    ----------
    numbers : array (E,)
        Episodes.
    seeds : tuple of int
    columns : mapping of str to array (E, S)
        NaN where a field is empty.
    """

    numbers: Array
    seeds: tuple[int, ...]
    columns: Mapping[str, Array]


def read_curves(path: str | os.PathLike[str]) -> Curves:
    """Read a file of `LearningCurves`; a last row that is not whole is left out.

    Parameters
    ----------
    path : path

    Returns
    -------
    Curves

    Raises
    ------
    InputError
        It cannot be read, or it holds something else.
    """
    try:
        text = Path(path).read_text(encoding="ascii")
        header, *lines = text[: text.rfind("\n") + 1].splitlines()
        names = header.split(",")
        rows = np.array([[float(field or "nan") for field in line.split(",")] for line in lines])
        rows = rows.reshape(len(lines), len(names))
    except OSError as error:
        raise InputError(f"cannot read the file: {error.strerror or error}", where=str(path)) from None
    except ValueError:
        raise _wrong(Path(path), "these are no learning curves") from None
    if len(names) < 3 or names[1] != "seed":
        raise _wrong(Path(path), "these are no learning curves")
    seeds = tuple(dict.fromkeys(rows[:, 1].astype(int).tolist()))
    whole = len(rows) // max(1, len(seeds))
    table = rows[: whole * len(seeds)].reshape(whole, len(seeds), len(names))
    if not ((table[:, :, 0] == table[:, :1, 0]).all() and (table[:, :, 1] == np.array(seeds, dtype=float)).all()):
        raise _wrong(Path(path), "its rows are not in order")
    return Curves(
        table[:, 0, 0] if seeds else np.zeros(0),
        seeds,
        {name: table[:, :, place] for place, name in enumerate(names) if place > 1},
    )


def plot_curves(curves: Curves, path: str | os.PathLike[str] | None, title: str, subtitle: str = "") -> Figure:
    """Draw returns and verified performance: every seed thin, their median thick, V as markers.

    Parameters
    ----------
    curves : Curves
        Of `EPISODE_COLUMNS`.
    path : path or None
        A .png, .pdf or .svg file.
    title, subtitle : str

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        The file cannot be written.
    """
    from ..verify.plot_style import PIPE, START, add_title, new_figure, written

    figure = new_figure(7.0, 4.2)
    axes = figure.add_subplot()
    window = max(1, round(_SMOOTHED * len(curves.numbers)))
    returns = _moving_mean(curves.columns["return"], window)
    label = f"return, mean of {window} episodes" if window > 1 else "return"
    axes.plot(curves.numbers, returns, color=PIPE, linewidth=0.6, alpha=0.45)
    values = curves.columns["value"]
    middle = np.median(values, 1) if values.size else np.zeros(0)
    bounded, some = np.isfinite(middle), np.isfinite(values)  # a seed without a bound has -inf, and takes part
    places = np.broadcast_to(curves.numbers[:, None], values.shape)[some]
    axes.plot(places, values[some], ".", color=START, markersize=3.5, alpha=0.5)
    if returns.size:
        axes.plot(curves.numbers, np.median(returns, 1), color=PIPE, linewidth=2.2, label=f"{label}: median")
        axes.plot([], [], color=PIPE, linewidth=0.6, label="a seed's")
    if bounded.any():
        style: dict[str, Any] = {"color": START, "markersize": 4, "linewidth": 1.0, "label": "V: median"}
        axes.plot(curves.numbers[bounded], middle[bounded], "D-", **style)
    if some.any():
        axes.plot([], [], ".", color=START, markersize=3.5, alpha=0.5, label="a seed's V")
    shown = np.concatenate([returns[np.isfinite(returns)], values[some]])
    if shown.size:
        # a few episodes of the untrained network would take the whole height
        low, high = float(np.percentile(shown, 2)), float(shown.max())
        margin = 0.05 * (high - low) or 1.0
        axes.set_ylim(low - margin, high + margin)
    axes.set_xlabel("episode")
    axes.set_ylabel("return, V(s0)")
    axes.grid(alpha=0.25)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8, loc="lower right")
    add_title(figure, title, subtitle)
    return written(figure, None if path is None else os.fspath(path))


def _moving_mean(values: Array, window: int) -> Array:
    """Mean of the last `window` rows, of fewer at the beginning; (E, S)."""
    # not from cumulative sums: a seed that diverged has a NaN, which would be in every later one
    return np.array([values[max(0, end - window) : end].mean(0) for end in range(1, len(values) + 1)])


def _texts(column: Any, count: int) -> list[str]:
    """Numbers as text that reads back as the same number: nine digits do for float32."""
    array = np.asarray(column).reshape(count)
    if array.dtype == np.float32:
        return ["" if number != number else f"{number:.9g}" for number in array.tolist()]
    return ["" if number != number else repr(number) for number in array.tolist()]


def _wrong(path: Path, message: str) -> InputError:
    return InputError(message, where=str(path), remedy="put the file back, or delete it to go on without its rows")


@contextmanager
def _reported(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(
            f"cannot write the file: {reason}",
            where=str(path),
            remedy="make room on the disk, then go on with --resume",
        ) from None
