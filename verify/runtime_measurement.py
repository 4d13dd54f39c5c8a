"""Measuring the installed runtime's tanh and sigmoid: every float32 number, and a dense sample of the float64 ones.

The reference is numpy's float64 tanh, whose own error `rounding.elementary_error` bounds: with d the largest distance
to it, |runtime - true| <= d + 8 u for the inputs that were measured. Vectorised code may treat what is left over at
the end of a batch in another way, so a part of the inputs is measured in batches of 1, 7 and 64 again, and once more
behind a matrix product, with which the runtime may fuse the function.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from ..models import onnx_elementary
from ..models.policy import Activation, activate
from ..specs.errors import PolicyError
from . import rounding
from .runtime_error import RUNTIME_ERROR, FunctionError, RuntimeMeasurement, runtime_name, smallest_power_of_two

Array = Any
Runner = Callable[[Array], Array]

BLOCK = 1 << 22
"""Inputs of one task; the finite float32 numbers of one sign are 510 of them."""
PART = 1 << 17
"""Inputs of one batch: what the runtime, numpy and the comparison keep in the processor's caches."""
FINITE = 0x7F800000
"""Bit patterns of the finite float32 numbers of one sign."""
SAMPLED = 64
"""Tasks of random float64 numbers."""
SMALL_BATCHES = (1, 7, 64)
SMALL = 7 * 64 * 100
"""Random numbers that are measured in small batches, beside those around the worst places."""
SAMPLE_FACTOR = 2.0
"""Safety factor of a distance that is only sampled."""
SEED = 20261122


@dataclass(frozen=True)
class MeasurementProgress:
    """How far a measurement is.

    Attributes
    ----------
    function, precision : str
        What was measured last.
    done, total : int
        Inputs.
    seconds : float
        Since the start.
    """

    function: str
    precision: str
    done: int
    total: int
    seconds: float

    @property
    def rate(self) -> float:
        """Inputs per second."""
        return self.done / self.seconds if self.seconds > 0.0 else 0.0

    @property
    def remaining(self) -> float:
        """Seconds that the rest takes at this rate; infinite before the first inputs."""
        return (self.total - self.done) / self.rate if self.rate > 0.0 else float("inf")


@dataclass(frozen=True)
class _Extreme:
    """Largest distance of some inputs, where, and the range of the results."""

    distance: float
    place: float
    least: float
    most: float


def measure_runtime(
    progress: Callable[[MeasurementProgress], None] | None = None, *, every: int = 1
) -> RuntimeMeasurement:
    """Measure tanh and sigmoid of the installed runtime in both precisions; minutes, all processors.

    Parameters
    ----------
    progress : callable, optional
        Called after every few million inputs.
    every : int
        1 measures all float32 numbers. A larger number measures one block in so many: for a first impression, no
        constant for claims.

    Returns
    -------
    RuntimeMeasurement

    Raises
    ------
    PolicyError
        The runtime returns something that is no number.
    """
    start = time.perf_counter()
    work = [(function, precision) for precision in RUNTIME_ERROR for function in onnx_elementary.OPERATORS]
    total = len(onnx_elementary.OPERATORS) * BLOCK * (len(_blocks("float32", every)) + len(_blocks("float64", every)))
    done = 0
    functions = []
    for function, precision in work:

        def report(count: int, function: str = function, precision: str = precision) -> None:
            nonlocal done
            done += count
            if progress is not None:
                progress(MeasurementProgress(function, precision, done, total, time.perf_counter() - start))

        functions.append(measure_function(function, precision, every, report))
    constants = {
        precision: smallest_power_of_two(max(f.bound for f in functions if f.precision == precision))
        for precision in RUNTIME_ERROR
    }
    return RuntimeMeasurement(
        runtime_name(),
        platform.machine(),
        _processor(),
        date.today().isoformat(),
        time.perf_counter() - start,
        constants,
        tuple(functions),
    )


def measure_function(
    function: str, precision: str, every: int = 1, report: Callable[[int], None] | None = None
) -> FunctionError:
    """Measure one function in one precision; see `measure_runtime`.

    Parameters
    ----------
    function : {"tanh", "sigmoid"}
    precision : {"float32", "float64"}
    every : int
    report : callable, optional
        Called with the number of inputs of every task that is done.
    """
    runner = onnx_elementary.elementary_runner(function, precision)
    blocks = _blocks(precision, every)
    extremes: list[_Extreme] = []
    pool = ThreadPoolExecutor(os.cpu_count() or 1)
    try:
        tasks = [pool.submit(_measure_block, runner, function, precision, block) for block in blocks]
        for task in as_completed(tasks):
            extremes.append(task.result())
            if report is not None:
                report(BLOCK)
    finally:
        pool.shutdown(cancel_futures=True)
    extremes.sort(key=lambda extreme: (-extreme.distance, extreme.place))  # the order of the tasks is not repeatable
    inputs = len(blocks) * BLOCK
    if precision == "float64":
        near = _around([extreme.place for extreme in extremes], 2048, precision)
        extremes.append(_measure(runner, function, near))
        inputs += near.size
    small, different, values = _measure_small(runner, function, precision, [e.place for e in extremes])
    extremes.append(small)
    worst = max(extremes, key=lambda extreme: extreme.distance)
    exhaustive = precision == "float32" and every == 1
    factor = 1.0 if exhaustive else SAMPLE_FACTOR
    reference = float(rounding.elementary_error(1.0))
    return FunctionError(
        function,
        precision,
        exhaustive,
        inputs,
        values,
        different,
        worst.distance,
        worst.place,
        float(rounding.enlarged(factor * worst.distance + reference, 3)),
        min(extreme.least for extreme in extremes),
        max(extreme.most for extreme in extremes),
    )


def _blocks(precision: str, every: int) -> range:
    """Numbers of the tasks: first bit patterns of float32 numbers in units of `BLOCK`, or seeds of float64 ones."""
    return range(0, 2 * FINITE // BLOCK, every) if precision == "float32" else range(max(1, SAMPLED // every))


def _measure_block(runner: Runner, function: str, precision: str, block: int) -> _Extreme:
    found = [_measure(runner, function, values) for values in _parts(precision, block)]
    worst = max(found, key=lambda extreme: extreme.distance)
    return _Extreme(worst.distance, worst.place, min(e.least for e in found), max(e.most for e in found))


def _parts(precision: str, block: int) -> Iterator[Array]:
    if precision == "float32":
        half = FINITE // BLOCK  # blocks of one sign
        first = (block % half) * BLOCK + (0x80000000 if block >= half else 0)
        for start in range(first, first + BLOCK, PART):
            yield np.arange(start, start + PART, dtype=np.uint32).view(np.float32)
        return
    generator = np.random.default_rng([SEED, block])
    for _ in range(BLOCK // PART):
        yield _random(generator, PART, precision)


def _random(generator: np.random.Generator, count: int, precision: str) -> Array:
    """Numbers where the functions bend, where they saturate, and of all magnitudes; `count` divisible by 4."""
    sign = generator.choice([-1.0, 1.0], size=count // 4)
    numbers = np.concatenate(
        [
            generator.uniform(-24.0, 24.0, size=count // 2),
            generator.uniform(-2.0, 2.0, size=count // 4),
            sign * np.exp2(generator.uniform(-60.0, 10.0, size=count // 4)),
        ]
    )
    return numbers.astype(precision)


def _around(places: list[float], width: int, precision: str) -> Array:
    """The numbers next to each place: `width` neighbours on both sides, and as many within 2^-12 of it."""
    kind = np.dtype(precision)
    integer = np.int32 if precision == "float32" else np.int64
    bits = np.array(places, dtype=kind).view(integer)
    steps = np.arange(-width, width + 1, dtype=integer)
    magnitude = np.abs(np.array(places)[:, None]) * (1.0 + np.linspace(-1.0, 1.0, 2 * width) * 2.0**-12)
    sign = np.sign(np.array(places))[:, None]
    # a step from a place of magnitude 0 would cross the sign bit: such places have no neighbours worth a look
    near = (bits[np.abs(bits) > width][:, None] + steps).view(kind)
    numbers = np.concatenate([near.ravel(), (sign * magnitude).astype(kind).ravel()])
    return numbers[np.isfinite(numbers)]


def _measure(runner: Runner, function: str, values: Array) -> _Extreme:
    return _extreme(function, values, runner(values))


def _extreme(function: str, values: Array, results: Array) -> _Extreme:
    exact = activate(Activation(function), values.astype(np.float64))
    distance = np.abs(results.astype(np.float64) - exact)
    worst = int(distance.argmax())  # the first NaN, where there is one
    if not np.isfinite(distance[worst]):
        name = runtime_name()
        raise PolicyError(
            f"{name} returns {results[worst]} for {function} of {values[worst]}", remedy="use another one"
        )
    return _Extreme(float(distance[worst]), float(values[worst]), float(results.min()), float(results.max()))


def _measure_small(runner: Runner, function: str, precision: str, places: list[float]) -> tuple[_Extreme, int, int]:
    """The extreme of small and fused batches, of how many inputs a result differs from the large batch's, and of how
    many inputs.
    """
    generator = np.random.default_rng([SEED, 7])
    chosen = np.concatenate([_random(generator, SMALL, precision), _around(places[:32], 64, precision)])
    chosen = chosen[: chosen.size // 448 * 448]  # whole batches of every size
    large = runner(chosen)
    fused = onnx_elementary.elementary_runner(function, precision, fused=True)
    found, different = [_extreme(function, chosen, large)], np.zeros(chosen.size, dtype=bool)
    for run in (runner, fused):
        for size in (*SMALL_BATCHES, chosen.size):
            results = np.concatenate([run(chosen[i : i + size]) for i in range(0, chosen.size, size)])
            found.append(_extreme(function, chosen, results))
            different |= results != large
    worst = max(found, key=lambda extreme: extreme.distance)
    combined = _Extreme(worst.distance, worst.place, min(e.least for e in found), max(e.most for e in found))
    return combined, int(different.sum()), int(chosen.size)


def _processor() -> str:
    """The processor's name, as far as the system says it."""
    information = Path("/proc/cpuinfo")
    lines = information.read_text(errors="replace").splitlines() if information.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def progress_line(state: MeasurementProgress) -> str:
    """How far a measurement is, for people: share, rate, time left."""
    share = 100.0 * state.done / state.total
    left = "" if state.remaining == float("inf") else f", {state.remaining:.0f} s left"
    return f"{state.function} {state.precision}: {share:.1f} %, {state.rate / 1e6:.0f} million inputs/s{left}"
