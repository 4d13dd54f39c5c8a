"""The journal of a batch: whatever a killed process left of it, whole lines count, and nothing else ever does."""

from __future__ import annotations

import json
import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

import pytest
from certification_cases import row
from hypothesis import given, settings
from hypothesis import strategies as st

from setrl.specs.errors import InputError
from setrl.verify.certification import journal as module
from setrl.verify.certification.document import (
    Evidence,
    Outcome,
    Row,
    Subject,
    Why,
)
from setrl.verify.certification.journal import HEADER, Journal

ROWS = (
    row(key="k0", name="policies/a\nb \u2028 \udcff.onnx x b", value=-1.5, margins=(0.25, None)),
    row(Outcome.UNKNOWN, key="k1", why=Why("resource", "ended", source="time limit", verified_until=0.5)),
    row(key="k2", radius="0.25", search=True, evidence=Evidence("certificate", "c/x.cert", "ab", 3, "1 cell")),
)
NEW = row(Outcome.FALSIFIED, key="k3", policy=Subject("another", ""), options={"splits": 1}, timings={"total": 1.0})


@pytest.fixture(autouse=True)
def _no_sync(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody pulls the plug here."""
    monkeypatch.setattr(os, "fsync", lambda file: None)


def write(path: Path, *rows: Row) -> bytes:
    with Journal.read(path) as journal:
        for each in rows:
            journal.append(each)
    return path.read_bytes()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write(tmp_path_factory.mktemp("journal") / "journal.jsonl", *ROWS)


def known(path: Path) -> list[Row]:
    return list(Journal.read(path).rows.values())


def test_rows_come_back_as_they_were_entered(tmp_path: Path) -> None:
    path = tmp_path / "j"
    write(path, *ROWS)
    assert known(path) == list(ROWS)
    assert write(path, NEW).count(b"\n") == 5
    journal = Journal.read(path)
    assert (list(journal.rows), journal.damaged) == (["k0", "k1", "k2", "k3"], 0)
    assert all(key == each.key for key, each in journal.rows.items())


def test_a_journal_that_is_not_there_is_empty_and_is_made_when_it_is_opened(tmp_path: Path) -> None:
    path = tmp_path / "j"
    assert known(path) == [] and not path.exists()
    assert write(path) == HEADER


def test_after_a_kill_in_any_place_the_whole_lines_are_there_and_the_next_ones_follow(
    tmp_path: Path, whole: bytes
) -> None:
    path = tmp_path / "j"
    ends = [position + 1 for position, byte in enumerate(whole) if byte == 10]
    near = {end + step for end in (0, *ends) for step in (-2, -1, 0, 1)}
    for length in sorted({*range(0, len(whole), 41), *near} & set(range(len(whole) + 1))):
        path.write_bytes(whole[:length])
        lines = max(0, sum(1 for end in ends if end <= length) - 1)
        assert known(path) == list(ROWS[:lines])
        with Journal.read(path) as journal:
            assert list(journal.rows.values()) == list(ROWS[:lines])
            journal.append(NEW)
        assert known(path) == [*ROWS[:lines], NEW]
        assert path.read_bytes().startswith(whole[: ends[lines]] if lines else HEADER)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_bytes_that_changed_lose_their_line_only(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("journal") / "j"
    content = bytearray(write(path, *ROWS))
    place = data.draw(st.integers(len(HEADER), len(content) - 1))
    content[place] = data.draw(st.integers(0, 255).filter(lambda byte: byte != content[place]))
    path.write_bytes(content)
    lines = bytes(content).split(b"\n")
    found = known(path)
    untouched = [each for each in ROWS if any(module._line(each)[:-1] == line for line in lines[:-1])]
    assert found == untouched
    assert len(found) >= len(ROWS) - 2  # two where the end of a line is gone


def test_a_line_of_another_program_with_a_right_digest_does_not_count(tmp_path: Path, whole: bytes) -> None:
    path = tmp_path / "j"
    for data in ({"a": 1}, [], 3, {**asdict(NEW), "outcome": "SAFER"}, {**asdict(NEW), "colour": 1}):
        text = json.dumps(data).encode()
        line = module.hashlib.sha256(text).hexdigest().encode() + b" " + text + b"\n"
        path.write_bytes(whole + line)
        journal = Journal.read(path)
        assert (list(journal.rows.values()), journal.damaged) == (list(ROWS), 1)
    nested = b"[" * 100_000
    path.write_bytes(whole + module.hashlib.sha256(nested).hexdigest().encode() + b" " + nested + b"\n")
    assert Journal.read(path).damaged == 1


@pytest.mark.parametrize(
    "content",
    [b"x", b"\n", b"{}\n", b'{"format": "setrl-journal/2"}\n', b"\x00" * 100, b"setrl: 1\n", HEADER[1:], b" " + HEADER],
)
def test_a_file_that_is_no_journal_is_refused_and_not_touched(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "j"
    path.write_bytes(content)
    with pytest.raises(InputError, match="no journal of this version") as caught:
        Journal.read(path)
    assert caught.value.where == str(path) and caught.value.remedy
    assert path.read_bytes() == content


def test_a_folder_in_the_journal_s_place_is_an_error_with_its_path(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        Journal.read(tmp_path)
    assert caught.value.where == str(tmp_path)


@contextmanager
def full_after(size: int) -> Iterator[None]:
    """No file can grow beyond so many bytes: a full disk, as the system reports it."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("room", [0, 1, 100])
def test_a_full_disk_is_an_error_and_costs_no_row_that_was_entered(tmp_path: Path, whole: bytes, room: int) -> None:
    path = tmp_path / "j"
    path.write_bytes(whole)
    with (
        pytest.raises(InputError, match="nothing can be written here") as caught,
        full_after(len(whole) + room),
        Journal.read(path) as journal,
    ):
        journal.append(NEW)
    assert caught.value.where == str(path)
    assert NEW.key not in journal.rows
    assert path.read_bytes()[: len(whole)] == whole
    assert known(path) == list(ROWS)
    write(path, NEW)
    assert known(path) == [*ROWS, NEW]


def test_a_row_is_on_the_disk_when_it_is_entered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "j"
    synced: list[bytes] = []
    monkeypatch.setattr(os, "fsync", lambda file: synced.append(path.read_bytes()))
    with Journal.read(path) as journal:
        journal.append(NEW)
        assert synced[-1] == path.read_bytes()
        assert known(path) == [NEW]


def test_the_newest_row_of_a_key_counts_also_after_the_file_was_rewritten(tmp_path: Path) -> None:
    path = tmp_path / "j"
    long = b"".join(module._line(row(key=f"k{number % 3}", value=float(number))) for number in range(1500))
    path.write_bytes(HEADER + long)
    newest = {"k0": 1497.0, "k1": 1498.0, "k2": 1499.0}

    def values() -> dict[str, float | None]:
        return {key: each.value.discounted for key, each in Journal.read(path).rows.items() if each.value}

    assert values() == newest
    write(path)
    assert path.read_bytes().count(b"\n") == 4
    assert values() == newest
    write(path, row(key="k1", value=2.0))
    assert values() == {**newest, "k1": 2.0}


def test_a_journal_is_not_rewritten_while_most_of_it_counts(tmp_path: Path) -> None:
    path = tmp_path / "j"
    path.write_bytes(HEADER + b"".join(module._line(row(key=f"k{number % 600}")) for number in range(1200)))
    before = path.stat().st_ino
    write(path, NEW)
    assert path.stat().st_ino == before and path.read_bytes().count(b"\n") == 1202
