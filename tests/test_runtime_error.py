"""The constant of the runtime's own tanh and sigmoid: measured on all float32 numbers, stored, never below ours."""

from __future__ import annotations

import json
import platform
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loops import network
from test_startup import modules_after

from setrl.models import onnx_elementary
from setrl.specs.errors import InputError, PolicyError
from setrl.verify import deployed, doctor, runtime_error, runtime_measurement
from setrl.verify.network import enclose_layers
from setrl.verify.runtime_error import FunctionError, RuntimeMeasurement
from setrl.verify.zonotope import from_box

SHIPPED = runtime_error.RUNTIME_ERROR


@pytest.fixture(autouse=True)
def cache_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache folder of one's own, and a runtime on which the shipped constants were measured."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(runtime_error, "MEASURED", {(runtime_error.runtime_name(), platform.machine())})
    return tmp_path


def measured(float32: float, float64: float = 2.0**-50, exhaustive: bool = True) -> RuntimeMeasurement:
    """A measurement as the doctor returns it."""
    entries = [
        FunctionError(function, precision, exhaustive, 10, 1, 0, bound, 1.0, bound, -1.0, 1.0)
        for precision, bound in (("float32", float32), ("float64", float64))
        for function in ("tanh", "sigmoid")
    ]
    constants = {"float32": float32, "float64": float64}
    name = runtime_error.runtime_name()
    return RuntimeMeasurement(name, platform.machine(), "some", "2026-11-22", 1.0, constants, tuple(entries))


# The constant -------------------------------------------------------------------------------------------------------


def test_without_a_measurement_the_shipped_constant_counts() -> None:
    assert {name: runtime_error.runtime_error(name) for name in SHIPPED} == SHIPPED
    assert runtime_error.runtime_note() is None


def test_a_runtime_that_nobody_measured_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime_error, "MEASURED", set())
    assert runtime_error.runtime_error("float32") == SHIPPED["float32"]
    note = runtime_error.runtime_note() or ""
    assert f"{runtime_error.runtime_name()} was not measured" in note and "run `setrl doctor --runtime`" in note
    runtime_error.store_measurement(measured(2.0**-22))
    assert runtime_error.runtime_note() is None


def test_another_architecture_was_not_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platform, "machine", lambda: "pdp11")
    assert "was not measured on pdp11" in (runtime_error.runtime_note() or "")


@pytest.mark.parametrize("bound", [2.0**-40, 3.3e-7, 2.0**-21, 4.8e-7, 1e-3, 2.0])
def test_the_constant_is_a_power_of_two_below_neither_the_shipped_nor_the_measured_one(bound: float) -> None:
    path = runtime_error.store_measurement(measured(bound))
    assert path == runtime_error.measurement_path() and path.is_file()
    constant = runtime_error.runtime_error("float32")
    assert constant >= max(bound, SHIPPED["float32"])
    assert np.log2(constant).is_integer()
    assert constant == SHIPPED["float32"] or constant < 2.0 * bound
    assert runtime_error.runtime_error("float64") == SHIPPED["float64"]


def test_a_runtime_that_is_measured_to_be_worse_widens_every_bound() -> None:
    policy = network([2, 5, 1], ["tanh", "none"], 0)
    bounds = enclose_layers(policy.layers, from_box(-np.ones((1, 2)), np.ones((1, 2)))).bounds
    before = deployed.deployed_error(policy.layers, bounds, "float32")
    runtime_error.store_measurement(measured(2.0**-10))
    more = np.abs(policy.layers[-1].weight).sum() * (2.0**-10 - SHIPPED["float32"])  # type: ignore[union-attr]
    assert (deployed.deployed_error(policy.layers, bounds, "float32") >= before + 0.999 * more).all()


@pytest.mark.parametrize("bound", [0.0, -1.0, float("nan"), float("inf"), 2.0**-1074])
def test_what_bounds_no_error_has_no_power_of_two(bound: float) -> None:
    with pytest.raises(AssertionError, match="bounds no error"):
        runtime_error.smallest_power_of_two(bound)


@pytest.mark.parametrize(("bound", "power"), [(1.0, 1.0), (0.75, 1.0), (0.5, 0.5), (np.nextafter(0.5, 1.0), 1.0)])
def test_the_smallest_power_of_two_is_not_below(bound: float, power: float) -> None:
    assert runtime_error.smallest_power_of_two(bound) == power


# The file -----------------------------------------------------------------------------------------------------------

GOOD: dict[str, Any] = {
    "format": 1,
    "runtime": runtime_error.runtime_name(),
    "machine": platform.machine(),
    "constants": {"float32": 2.0**-10, "float64": 2.0**-40},
}


def write(content: bytes) -> None:
    path = runtime_error.measurement_path()
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def test_the_file_of_the_next_tests_is_used_where_it_is_whole() -> None:
    write(json.dumps(GOOD).encode())
    assert runtime_error.runtime_error("float32") == 2.0**-10 and runtime_error.runtime_note() is None


@pytest.mark.parametrize(
    ("content", "objection"),
    [
        (b"", "damaged"),
        (b"{", "damaged"),
        (b"\xff\xfe\x00", "damaged"),
        (b"[" * 60000, "damaged"),
        (b" " * (1 << 20), "too large"),
        (b"null", "another format"),
        (b"[1, 2]", "another format"),
        (json.dumps({**GOOD, "format": 2}).encode(), "another format"),
        (json.dumps({**GOOD, "runtime": "onnxruntime 0.1"}).encode(), "another runtime"),
        (json.dumps({**GOOD, "machine": "pdp11"}).encode(), "another runtime"),
        (json.dumps({**GOOD, "constants": None}).encode(), "damaged"),
        (json.dumps({**GOOD, "constants": {"float32": 2.0**-10}}).encode(), "damaged"),
        *(
            (json.dumps({**GOOD, "constants": {"float32": value, "float64": 2.0**-40}}).encode(), "damaged")
            for value in (float("nan"), float("inf"), -1.0, 0.0, "1e-3", True, None, [1.0])
        ),
    ],
)
def test_a_damaged_or_foreign_file_is_ignored_with_a_note(content: bytes, objection: str) -> None:
    write(content)
    assert {name: runtime_error.runtime_error(name) for name in SHIPPED} == SHIPPED
    note = runtime_error.runtime_note() or ""
    assert objection in note and "is ignored" in note and str(runtime_error.measurement_path()) in note
    assert "run `setrl doctor --runtime`" in note


def test_a_place_that_cannot_be_read_is_no_crash(cache_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (cache_folder / "setrl").write_text("a file where the folder should be")
    assert runtime_error.runtime_error("float32") == SHIPPED["float32"]
    with pytest.raises(InputError, match="no folder can be made"):
        runtime_error.store_measurement(measured(2.0**-22))
    monkeypatch.setenv("XDG_CACHE_HOME", "")
    monkeypatch.setenv("HOME", str(cache_folder / "home"))
    assert runtime_error.measurement_path().is_relative_to(cache_folder / "home" / ".cache" / "setrl")
    monkeypatch.setattr("os.path.expanduser", lambda path: path)  # a user without a home folder
    assert runtime_error.runtime_error("float32") == SHIPPED["float32"]
    with pytest.raises(InputError, match="no home folder"):
        runtime_error.store_measurement(measured(2.0**-22))


def test_a_place_that_cannot_be_written_is_found_before_the_measurement() -> None:
    path = runtime_error.require_storable()
    assert path == runtime_error.measurement_path() and path.parent.is_dir() and not path.exists()
    path.mkdir()
    with pytest.raises(InputError, match="a file is needed"):
        runtime_error.require_storable()
    assert runtime_error.runtime_error("float32") == SHIPPED["float32"]
    path.rmdir()
    path.parent.rmdir()
    path.parent.write_text("a file where the folder should be")
    with pytest.raises(InputError, match="no folder can be made"):
        runtime_error.require_storable()


def test_half_a_measurement_and_one_of_another_runtime_are_not_stored() -> None:
    with pytest.raises(AssertionError, match="part of all float32 numbers"):
        runtime_error.store_measurement(measured(2.0**-22, exhaustive=False))
    with pytest.raises(AssertionError, match=r"measured onnxruntime 0\.1"):
        runtime_error.store_measurement(replace(measured(2.0**-22), runtime="onnxruntime 0.1"))
    assert not runtime_error.measurement_path().exists()


def test_asking_for_the_constant_does_not_import_the_runtime() -> None:
    statement = (
        "from setrl.verify import runtime_error as r; r.runtime_error('float32'); r.runtime_note(); r.runtime_name()"
    )
    assert not modules_after(statement) & {"onnxruntime", "onnx"}


def test_the_runtimes_name_is_what_the_runtime_says() -> None:
    import onnxruntime

    assert runtime_error.runtime_name() == f"onnxruntime {onnxruntime.__version__}"


def test_a_runtime_from_a_package_of_another_name_is_named() -> None:
    code = (
        "from importlib import metadata\n"
        "def version(name): raise metadata.PackageNotFoundError(name)\n"
        "metadata.version = version\n"
        "from setrl.verify.runtime_error import runtime_name\nprint(runtime_name())"
    )
    path = str(Path(__file__).resolve().parents[1] / ".src")
    outcome = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, {path!r})\n{code}"], capture_output=True
    )
    assert outcome.stdout.decode().strip() == runtime_error.runtime_name(), outcome.stderr.decode()


# The measurement ----------------------------------------------------------------------------------------------------


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small tasks."""
    monkeypatch.setattr(runtime_measurement, "BLOCK", 1 << 16)
    monkeypatch.setattr(runtime_measurement, "PART", 1 << 14)
    monkeypatch.setattr(runtime_measurement, "SMALL", 448 * 4)


def altered(monkeypatch: pytest.MonkeyPatch, change: Any) -> None:
    """A runtime whose results `change(values, results, fused)` may spoil in place."""
    honest = onnx_elementary.elementary_runner

    def runner(function: str, precision: str, *, fused: bool = False) -> Any:
        inner = honest(function, precision, fused=fused)

        def run(values: Any) -> Any:
            results = inner(values).copy()
            change(values, results, fused)
            return results

        return run

    monkeypatch.setattr(onnx_elementary, "elementary_runner", runner)


def test_the_blocks_hold_every_finite_float32_number_once() -> None:
    blocks = runtime_measurement._blocks("float32", 1)
    assert len(blocks) * runtime_measurement.BLOCK == 2 * 0x7F800000
    expected = {0: 0, 1: 1 << 22, 509: 0x7F800000 - (1 << 22), 510: 0x80000000, 1019: 0xFF800000 - (1 << 22)}
    for block, first in expected.items():
        numbers = np.concatenate(list(runtime_measurement._parts("float32", block)))
        assert numbers.dtype == np.float32 and np.isfinite(numbers).all()
        np.testing.assert_array_equal(numbers.view(np.uint32), np.arange(first, first + (1 << 22), dtype=np.uint32))


@pytest.mark.parametrize("function", ["tanh", "sigmoid"])
def test_one_wrong_result_among_all_is_found(function: str, small: None, monkeypatch: pytest.MonkeyPatch) -> None:
    bits = 0x3F000000 + 12345  # 0.5 and a little, in a block that is measured

    def spoil(values: Any, results: Any, fused: bool) -> None:
        if values.dtype == np.float32:
            results[values.view(np.uint32) == bits] += 2.0**-12

    altered(monkeypatch, spoil)
    every = bits // runtime_measurement.BLOCK
    found = runtime_measurement.measure_function(function, "float32", every)
    assert found.place == float(np.uint32(bits).view(np.float32))
    assert 2.0**-12 - 1e-6 < found.distance < found.bound < 2.0**-10


@pytest.mark.parametrize(
    "where",
    [
        lambda values, fused: np.arange(values.size) == (6 if values.size == 7 else -1),
        lambda values, fused: np.full(values.size, values.size == 1),
        lambda values, fused: np.full(values.size, fused) & (np.abs(values) < 0.1),
    ],
    ids=["the end of a batch", "a batch of one", "fused"],
)
def test_a_wrong_result_of_a_small_or_fused_batch_is_found(
    where: Any, small: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def spoil(values: Any, results: Any, fused: bool) -> None:
        results[where(values, fused)] += 2.0**-12

    altered(monkeypatch, spoil)
    for precision in ("float32", "float64"):
        found = runtime_measurement.measure_function("tanh", precision, 9000)
        assert found.different > 0
        assert 2.0**-12 - 1e-6 < found.distance < found.bound


def test_a_result_that_is_no_number_is_an_error(small: None, monkeypatch: pytest.MonkeyPatch) -> None:
    def spoil(values: Any, results: Any, fused: bool) -> None:
        results[-1] = np.nan

    altered(monkeypatch, spoil)
    with pytest.raises(PolicyError, match="returns nan for sigmoid"):
        runtime_measurement.measure_function("sigmoid", "float32", 9000)


def test_a_measurement_says_how_far_it_is_and_repeats(small: None) -> None:
    seen: list[runtime_measurement.MeasurementProgress] = []
    first = runtime_measurement.measure_runtime(seen.append, every=4000)
    again = runtime_measurement.measure_runtime(every=4000)
    assert replace(first, seconds=0.0) == replace(again, seconds=0.0)
    done = [state.done for state in seen]
    assert done == sorted(done) and done[-1] == seen[-1].total and seen[-1].remaining == 0.0
    assert {(state.function, state.precision) for state in seen} == {
        (function, precision) for function in ("tanh", "sigmoid") for precision in SHIPPED
    }
    assert "tanh float32: " in runtime_measurement.progress_line(seen[0])
    assert "100.0 %" in runtime_measurement.progress_line(seen[-1])
    assert not first.functions[0].exhaustive


def test_a_part_of_the_inputs_does_not_contradict_the_shipped_constants(small: None) -> None:
    found = runtime_measurement.measure_runtime(every=331)
    for entry in found.functions:
        assert 0.0 < entry.distance + 2.0**-50 <= SHIPPED[entry.precision]
        assert -1.001 < entry.least <= entry.most < 1.001


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_the_shipped_constants_hold_for_all_inputs_of_the_installed_runtime() -> None:
    found = runtime_measurement.measure_runtime()
    assert all(entry.exhaustive for entry in found.functions if entry.precision == "float32")
    assert all(found.constants[name] <= SHIPPED[name] for name in SHIPPED)
    runtime_error.store_measurement(found)
    assert {name: runtime_error.runtime_error(name) for name in SHIPPED} == SHIPPED
    assert runtime_error.runtime_note() is None


# What people read ---------------------------------------------------------------------------------------------------


def test_the_doctor_says_which_constants_claims_use(monkeypatch: pytest.MonkeyPatch) -> None:
    facts = doctor.examine()
    assert facts["runtime"] == {"name": runtime_error.runtime_name(), "error": SHIPPED, "note": None}
    text = "\n".join(doctor.examination_lines(facts))
    assert "within 2^-21 in float32, 2^-48 in float64" in text and "not measured" not in text
    monkeypatch.setattr(runtime_error, "MEASURED", set())
    assert "was not measured" in "\n".join(doctor.examination_lines(doctor.examine()))
    json.dumps(facts)


def test_a_measurement_is_readable() -> None:
    lines = doctor.measurement_lines(measured(3.2537e-7))
    assert "3.26e-7" in lines[1] and "all finite numbers" in lines[1]
    assert any("claims use 2^-21 in float32, 2^-48 in float64" in line for line in lines)
    runtime_error.store_measurement(measured(2.0**-10))
    assert any("claims use 2^-10 in float32" in line for line in doctor.measurement_lines(measured(2.0**-10)))
