"""How far the deployed runtime's own tanh and sigmoid may be from the true functions: shipped and stored constants.

constant = max(shipped, the smallest power of two that is not below what this machine measured)

so that a claim uses the same constant on every machine, unless a machine's runtime is measured to be worse. What
`setrl doctor --runtime` measures (`runtime_measurement`) is stored in the user's cache folder, one file per runtime,
version and machine architecture. A file that cannot be used is ignored, and `runtime_note` says so.
"""

from __future__ import annotations

import json
import math
import os
import platform
import re
from dataclasses import asdict, dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from ..specs.errors import InputError
from ..specs.files import require_writable, write_atomically

RUNTIME = "onnxruntime"
RUNTIME_ERROR = {"float32": 2.0**-21, "float64": 2.0**-48}
"""Absolute error of the runtime's own tanh and sigmoid: powers of two above what docs/deployed.md measures."""
MEASURED = {(f"{RUNTIME} 1.31.1", "x86_64")}
"""Runtimes and machine architectures on which the shipped constants were measured."""
FORMAT = 1
LARGEST_FILE = 1 << 16


@dataclass(frozen=True)
class FunctionError:
    """How far one function of the runtime was off.

    Attributes
    ----------
    function : {"tanh", "sigmoid"}
    precision : {"float32", "float64"}
    exhaustive : bool
        Whether every finite number of the precision was an input.
    inputs : int
        Numbers that were measured in large batches.
    small : int
        Numbers of them that were also measured in small batches, alone and fused with a matrix product.
    different : int
        Numbers of these with a result that differed from the large batch's.
    distance : float
        Largest distance to the reference, |runtime - numpy|.
    place : float
        Where that was.
    bound : float
        Bound of the distance to the true function at all inputs: the reference's own error is added.
    least, most : float
        Smallest and largest result.
    """

    function: str
    precision: str
    exhaustive: bool
    inputs: int
    small: int
    different: int
    distance: float
    place: float
    bound: float
    least: float
    most: float


@dataclass(frozen=True)
class RuntimeMeasurement:
    """What was measured of the installed runtime.

    Attributes
    ----------
    runtime : str
        Name and version.
    machine : str
        Architecture, for example "x86_64".
    processor : str
        The processor's name; information only.
    date : str
        Day of the measurement, ISO 8601.
    seconds : float
    constants : dict
        From precision to a power of two that is not below any function's error; what `runtime_error` compares with
        the shipped constant.
    functions : tuple of FunctionError
    """

    runtime: str
    machine: str
    processor: str
    date: str
    seconds: float
    constants: dict[str, float]
    functions: tuple[FunctionError, ...]


def runtime_error(precision: str) -> float:
    """Bound of ``|f_runtime(x) - f(x)|`` that claims use, f = tanh, sigmoid; x a number of the precision.

    Never below the shipped constant.

    Parameters
    ----------
    precision : {"float32", "float64"}

    Returns
    -------
    float
        A power of two.
    """
    stored, _ = _stored()
    return max(RUNTIME_ERROR[precision], stored.get(precision, 0.0))


def runtime_note() -> str | None:
    """What a result has to say about the constant; None where the installed runtime was measured."""
    stored, objection = _stored()
    remedy = "run `setrl doctor --runtime`"
    if objection:
        return f"the stored measurement of {runtime_name()} is ignored, {objection}: {remedy}"
    if stored or (runtime_name(), platform.machine()) in MEASURED:
        return None
    return f"the runtime {runtime_name()} was not measured on {platform.machine()}: {remedy}"


@cache
def runtime_name() -> str:
    """Name and version of the installed runtime, "onnxruntime 1.31.1"; the runtime itself is not imported."""
    try:
        return f"{RUNTIME} {metadata.version(RUNTIME)}"
    except metadata.PackageNotFoundError:  # the module comes from a package of another name, onnxruntime-gpu for one
        from ..models.onnx_runtime import runtime_version

        return f"{RUNTIME} {runtime_version()}"


def measurement_path() -> Path:
    """File of the installed runtime's measurement: below ``$XDG_CACHE_HOME/setrl``, else ``~/.cache/setrl``.

    Returns
    -------
    path
        Not absolute where the user has no home folder; then nothing is read or written.
    """
    given = os.environ.get("XDG_CACHE_HOME", "")
    # the convention ignores a relative path
    folder = Path(given) if os.path.isabs(given) else Path(os.path.expanduser("~/.cache"))
    name = re.sub(r"[^\w.+-]+", "-", f"runtime-{runtime_name()}-{platform.machine()}")
    return folder / "setrl" / f"{name}.json"


def require_storable() -> Path:
    """Make the folder for measurements, and find out before the work whether one can be written.

    Returns
    -------
    path
        Where `store_measurement` writes.

    Raises
    ------
    InputError
        Naming the path and the remedy.
    """
    path = measurement_path()
    if not path.is_absolute():
        raise InputError("there is no home folder to store a measurement in", remedy="set XDG_CACHE_HOME")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or str(error)
        where = str(path.parent)
        raise InputError(f"no folder can be made: {reason}", where=where, remedy="set XDG_CACHE_HOME") from error
    require_writable(path)
    return path


def store_measurement(measurement: RuntimeMeasurement) -> Path:
    """Write what was measured, whole or not at all; this process uses it from now on.

    Parameters
    ----------
    measurement : RuntimeMeasurement
        Exhaustive where a precision has few enough numbers, and of the runtime that is installed.

    Returns
    -------
    path

    Raises
    ------
    InputError
        The file cannot be written.
    """
    if not all(entry.exhaustive for entry in measurement.functions if entry.precision == "float32"):
        raise AssertionError("a measurement of a part of all float32 numbers stands for nothing")
    if measurement.runtime != runtime_name() or measurement.machine != platform.machine():
        raise AssertionError(f"measured {measurement.runtime} on {measurement.machine}")
    path = require_storable()
    text = json.dumps({"format": FORMAT, **asdict(measurement)}, indent=2, allow_nan=False)
    write_atomically(path, f"{text}\n".encode())
    _read.cache_clear()
    return path


def smallest_power_of_two(bound: float) -> float:
    """Smallest 2^k >= bound, for a positive normal number."""
    if not 2.0**-1022 <= bound < 2.0**1023:
        raise AssertionError(f"{bound} bounds no error")
    mantissa, exponent = math.frexp(bound)
    return math.ldexp(1.0, exponent - 1 if mantissa == 0.5 else exponent)


def _stored() -> tuple[dict[str, float], str]:
    """Constants of the stored measurement, and why they are not used; neither where nothing is stored."""
    return _read(measurement_path(), runtime_name(), platform.machine())


@cache
def _read(path: Path, runtime: str, machine: str) -> tuple[dict[str, float], str]:
    if not path.is_absolute():
        return {}, ""
    try:
        if not path.is_file():
            return {}, ""
        with path.open("rb") as file:
            content = file.read(LARGEST_FILE + 1)
        if len(content) > LARGEST_FILE:
            return {}, f"{path} is too large"
        document = json.loads(content)
    except OSError as error:
        return {}, f"{path} cannot be read ({error.strerror or error})"
    except (ValueError, RecursionError):  # no JSON, or no UTF-8
        return {}, f"{path} is damaged"
    return _constants(document, path, runtime, machine)


def _constants(document: Any, path: Path, runtime: str, machine: str) -> tuple[dict[str, float], str]:
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        return {}, f"{path} is of another format"
    if document.get("runtime") != runtime or document.get("machine") != machine:
        return {}, f"{path} is of another runtime"
    given = document.get("constants")
    found = {name: given.get(name) if isinstance(given, dict) else None for name in RUNTIME_ERROR}
    # positive polarity: only a number that bounds an error is one
    if not all(isinstance(value, float) and 2.0**-1022 <= value < 2.0**1023 for value in found.values()):
        return {}, f"{path} is damaged"
    return {name: smallest_power_of_two(value) for name, value in found.items() if isinstance(value, float)}, ""
