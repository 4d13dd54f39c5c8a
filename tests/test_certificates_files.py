"""Files that are no certificates, or damaged ones, are refused: with a sentence, at once, in little memory."""

from __future__ import annotations

import hashlib
import io
import json
import struct
import time
import tracemalloc
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import pytest
from certificate_bombs import BOMBS, ENTRIES
from certificate_streams import header_of, opened, reading_once, sealed
from certificates import case_of

from setrl.specs.errors import InputError
from setrl.verify.checker.certificate import Accepted, check
from setrl.verify.checker.certificate_file import MAGIC

LIMIT, MEMORY = 1.0, 32 << 20
"""CPU seconds and bytes for one file."""
CASE = case_of(2, periods=2)


@pytest.fixture(autouse=True)
def _files_are_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    reading_once(monkeypatch)


@lru_cache(maxsize=1)
def good() -> bytes:
    return CASE.certificate


def judged(content: bytes) -> Accepted | str:
    """The checker's answer; a refusal is a sentence, whatever way it comes."""
    for attempt in (1, 2):  # the second one, where a collection of this process's garbage fell into the first
        started = time.process_time()
        try:
            answer = check(content, CASE.policy, CASE.specification, workers=1)
        except InputError as error:
            answer = str(error)
        if time.process_time() - started < LIMIT:
            break
        assert attempt == 1, "too slow"
    return answer


def refused(content: bytes) -> str:
    answer = judged(content)
    assert isinstance(answer, str), "accepted"
    assert 10 < len(answer) < 400 and "\n" not in answer, answer
    return answer


def with_text(text: bytes, payload: bytes = b"") -> bytes:
    """A file with any header, padded as it should be."""
    text += b" " * (-(len(MAGIC) + 8 + len(text)) % 8)
    return MAGIC + struct.pack("<Q", len(text)) + text + payload


def payload_of(content: bytes) -> bytes:
    (size,) = struct.unpack_from("<Q", content, len(MAGIC))
    return content[len(MAGIC) + 8 + size :]


def with_header(**given: Any) -> bytes:
    """The good file with other entries of its header; numbers and digest as they are."""
    header = {**header_of(good()), **given}
    text = json.dumps(header, sort_keys=True, separators=(",", ":")).encode()
    return with_text(text, payload_of(good()))


def test_the_file_itself_is_accepted() -> None:
    assert isinstance(judged(good()), Accepted)
    assert with_header() == good()


# Cut off, too long, tampered ----------------------------------------------------------------------------------------


def lengths() -> Iterator[int]:
    content, start = good(), len(good()) - len(payload_of(good()))
    yield from range(0, 40)
    yield from range(start - 9, start + 17)
    yield from range(40, len(content), 97)
    yield from range(len(content) - 17, len(content))


def test_truncated_files_are_refused_at_every_interesting_length() -> None:
    for length in lengths():
        refused(good()[:length])


def test_what_follows_a_certificate_is_refused() -> None:
    for tail in (b"\0", b" ", b"\0" * 8, good(), b"x" * 100_000):
        refused(good() + tail)
        refused(tail + good())


HARMLESS = {"setrl", "requirements", "runtime", "order", "value"}
"""Entries that may say something else that is true: a version, smaller margins, another order of the same proof."""


def test_no_byte_can_be_changed() -> None:
    """Neither in the header, where the digests of the files and of the numbers are, nor in the numbers."""
    content, start = good(), len(good()) - len(payload_of(good()))
    for place in [*range(start), *range(start, len(content), 31), len(content) - 1]:
        for change in (1, 128):
            tampered = content[:place] + bytes([content[place] ^ change]) + content[place + 1 :]
            if isinstance(judged(tampered), Accepted):
                header, other = header_of(content), header_of(tampered)
                assert place < start and {key for key in header if header[key] != other[key]} <= HARMLESS


def test_blocks_cannot_be_moved() -> None:
    content, start = good(), len(good()) - len(payload_of(good()))
    for first, last in ((start, start + 8), (start + 64, start + 512), (100, 140)):
        refused(content[:first] + content[last:])
        refused(content[:last] + content[first:])
        refused(content[:first] + b"\0" * (last - first) + content[last:])
        refused(content[:first] + content[first:last][::-1] + content[last:])


# Foreign files ------------------------------------------------------------------------------------------------------


def foreign() -> dict[str, bytes]:
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("a.cert", good())
    return {
        "empty": b"",
        "png": b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + bytes(200),
        "zip": archive.getvalue(),
        "yaml": CASE.specification,
        "onnx": CASE.policy,
        "json": json.dumps(header_of(good())).encode(),
        "zeros": bytes(100_000),
        "magic only": MAGIC,
        "magic and zeros": MAGIC + bytes(1000),
        "magic and ones": MAGIC + b"\xff" * 1000,
        "newlines": MAGIC.replace(b"\r\n", b"\n") + good()[len(MAGIC) :],
        "text": good().decode("latin1").encode("utf8"),
        "hexadecimal": good().hex().encode(),
    }


@pytest.mark.parametrize("name", foreign())
def test_foreign_files_are_refused(name: str) -> None:
    refused(foreign()[name])


def test_other_files_in_the_place_of_policy_or_specification_are_refused() -> None:
    for policy, specification in ((CASE.specification, CASE.policy), (b"", b""), (CASE.policy + b"\0", CASE.policy)):
        assert "digests differ" in str(check(good(), policy, specification))


# Headers --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BOMBS)
def test_headers_that_are_bombs_are_refused(name: str) -> None:
    refused(with_text(BOMBS[name]))


@pytest.mark.parametrize(("key", "value"), ENTRIES, ids=[f"{i}-{key}" for i, (key, _) in enumerate(ENTRIES)])
def test_entries_out_of_range_are_refused(key: str, value: Any) -> None:
    refused(with_header(**{key: value}))


def test_a_header_has_one_spelling() -> None:
    header = header_of(good())
    text = json.dumps(header, sort_keys=True, separators=(",", ":"))
    for other in (
        json.dumps(header, sort_keys=True),
        text + "\n",
        json.dumps(dict(reversed(header.items())), separators=(",", ":")),
        text.replace('"order":', '"order":5,"order":'),
        text.replace('"jets"', '"\\u006aets"'),
    ):
        assert other != text
        refused(with_text(other.encode(), payload_of(good())))


# Numbers ------------------------------------------------------------------------------------------------------------


def test_extreme_whole_numbers_are_refused_wherever_they_are() -> None:
    base = opened(good(), CASE.policy, CASE.specification)
    (floats, integers), *_ = base.streams
    for place, number in enumerate(integers):
        for extreme in (2**31 - 1, -(2**31), 65536):
            if extreme != number:
                changed = [*integers[:place], extreme, *integers[place + 1 :]]
                refused(sealed(base.header, [(floats, changed)]))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_numbers_that_are_not_finite_are_refused_wherever_they_are(value: float) -> None:
    base = opened(good(), CASE.policy, CASE.specification)
    (floats, integers), *_ = base.streams
    for place in range(0, len(floats), 3):
        changed = [*floats[:place], value, *floats[place + 1 :]]
        assert "not finite" in refused(sealed(base.header, [(changed, integers)]))


@pytest.mark.parametrize("value", [1.7976931348623157e308, -1.7976931348623157e308, 5e-324])
def test_extreme_floats_are_no_reason_to_fail(value: float) -> None:
    base = opened(good(), CASE.policy, CASE.specification)
    (floats, integers), *_ = base.streams
    for place in range(0, len(floats), 3):
        judged(sealed(base.header, [([*floats[:place], value, *floats[place + 1 :]], integers)]))
    refused(sealed(base.header, [([value] * len(floats), integers)]))


def test_streams_with_too_many_or_too_few_numbers_are_refused() -> None:
    base = opened(good(), CASE.policy, CASE.specification)
    (floats, integers), *_ = base.streams
    for more, whole in ((floats + [0.0], integers), (floats, [*integers, 0]), (floats[:-1], integers), ([], [])):
        refused(sealed(base.header, [(more, whole)]))
    refused(sealed(base.header, [(floats * 200, integers * 200)]))


# Memory -------------------------------------------------------------------------------------------------------------


def test_refusing_takes_little_memory() -> None:
    files = [with_text(BOMBS[name]) for name in ("nested lists", "nested and closed", "long text")]
    files += [with_header(floats=10**9), with_header(leaves=[[10**9, 10**9]]), with_header(tree=[[0, "0"]] * 2000)]
    for content in files:
        tracemalloc.start()
        try:
            refused(content)
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert peak < MEMORY, f"{peak >> 20} MiB"


def test_the_digest_is_the_one_of_the_numbers() -> None:
    assert header_of(good())["payload"] == hashlib.sha256(payload_of(good())).hexdigest()


def test_claims_whose_sums_are_no_floats_are_rejected() -> None:
    certificate = opened(good(), CASE.policy, CASE.specification)
    (leaf,) = certificate.leaves
    action = leaf.periods[0].action
    size = len(action.center)
    huge = replace(action, rows=((1.7e308,) * size, *action.rows[1:]), box=(1.79e308,) * size)
    other = replace(leaf, periods=(replace(leaf.periods[0], action=huge), *leaf.periods[1:]))
    writer = certificate.writer(other)
    content = sealed(certificate.header, [(writer.floats, writer.integers)])
    assert isinstance(judged(content), str)
