"""Where a run's options come from: defaults, the tuned weights of a shipped specification, a file, the command line.

Each of them wins over those before it. ``--preset paper`` puts Table 2 of the paper in the place of the tuned weights.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..specs.errors import InputError, SetrlError, UsageError
from ..specs.specification import Specification
from ..specs.yaml_nodes import load_nodes, plain_data
from .options import PAPER, TrainingOptions, options_from

PRESETS = ("tuned", "paper", "none")
TUNED = Path(__file__).parent / "tuned"


@dataclass(frozen=True)
class Configuration:
    """What a run is made of, besides its specification.

    Attributes
    ----------
    options : TrainingOptions
    start : mapping of state name to number or pair, or None
        Box of initial states of training episodes; None: the specification's initial set.
    radii : tuple of str
        Perturbation radii at which `setrl evaluate` looks, as decimals.
    """

    options: TrainingOptions
    start: Mapping[str, Any] | None = None
    radii: tuple[str, ...] = ()


def configure(
    specification: Specification,
    given: Mapping[str, Any],
    *,
    file: Path | None = None,
    preset: str | None = None,
) -> Configuration:
    """Put a run's options together.

    Parameters
    ----------
    specification : Specification
    given : mapping
        Options of the command line, by dotted name (``flowpipe.steps``), already of their types.
    file : Path, optional
        YAML with options and, as `start`, the box of initial states.
    preset : {"tuned", "paper", "none"}, optional
        Default: tuned, where there are tuned weights for the specification.

    Returns
    -------
    Configuration

    Raises
    ------
    SetrlError
        A key is unknown or a value is of no use; with the file.
    """
    if preset is not None and preset not in PRESETS:
        raise UsageError(f"received {preset}", where="--preset", remedy=f"choose from: {', '.join(PRESETS)}")
    layers: list[tuple[str, dict[str, Any]]] = []
    tuned = _tuned(specification)
    if preset == "tuned" and tuned is None:
        name = Path(specification.source).name or "this specification"
        raise UsageError(
            f"there are no tuned weights for {name}", where="--preset", remedy="leave it out, or say --preset paper"
        )
    from_file = {} if file is None else read_options(file)
    chosen = {**from_file, **given}
    start, radii = None, ()
    if tuned is not None:
        start, radii = tuned.pop("start", None), tuple(tuned.pop("radii", ()))
        algorithms = tuned.pop("algorithms", {})
        if preset in (None, "tuned"):
            mine = algorithms.get(chosen.get("algorithm", TrainingOptions().algorithm), {})
            layers.append((str(_tuned_path(specification)), {**tuned, **mine}))
    if preset == "paper":
        layers.append(("--preset paper", dict(PAPER.get(chosen.get("base", "ddpg"), {}))))
    if "start" in from_file:
        start = from_file.pop("start")
    layers += [(str(file), from_file), ("", dict(given))]
    values: dict[str, Any] = {}
    for where, layer in layers:
        try:
            options_from(_nested(layer))  # so that a message names the place a value comes from
        except SetrlError as error:
            raise error.at(where) if where else error from error
        _merge(values, _nested(layer))
    return Configuration(options_from(values), start, radii)


def read_options(path: Path) -> dict[str, Any]:
    """Options from a YAML file, as plain data.

    Raises
    ------
    SetrlError
        The file cannot be read or is no mapping.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"cannot read the file: {reason}", where=str(path), remedy="check the path") from error
    data = _typed(plain_data(load_nodes(content, str(path))))
    assert isinstance(data, dict)
    return data


def read_value(text: str) -> Any:
    """A number, true, false, null or text, as the command line and YAML write them."""
    words = {"true": True, "false": False, "null": None, "none": None}
    if text.lower() in words:
        return words[text.lower()]
    for kind in (int, float):
        try:
            value = kind(text)
        except ValueError:
            continue
        return value if math.isfinite(value) else text
    return text


def read_assignment(text: str) -> tuple[str, Any]:
    """``name=value`` of the command line; a list of whole numbers is written with commas.

    Raises
    ------
    UsageError
        It has no name or no value.
    """
    name, sign, value = text.partition("=")
    if not (name.strip() and sign and value.strip()):
        raise UsageError(
            f"name=value is required, received {text!r}", where="--set", remedy="for example --set tau=0.01"
        )
    parts = [read_value(part.strip()) for part in value.split(",")]
    return name.strip(), parts if len(parts) > 1 or name.strip() == "hidden" else parts[0]


def _tuned_path(specification: Specification) -> Path | None:
    """Tuned weights belong to a shipped specification, not to a file that has its name."""
    source = Path(specification.source)
    shipped = Path(__file__).parent.parent / "specs"
    if not specification.source or source.resolve().parent != shipped.resolve():
        return None
    path = TUNED / source.name
    return path if path.is_file() else None


def _tuned(specification: Specification) -> dict[str, Any] | None:
    path = _tuned_path(specification)
    return None if path is None else read_options(path)


def _typed(data: Any) -> Any:
    """Scalars of a YAML file, which are text there, as values."""
    if isinstance(data, dict):
        return {key: _typed(value) for key, value in data.items()}
    if isinstance(data, list):
        return [_typed(value) for value in data]
    return read_value(data) if type(data) is str else data


def _nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Dotted names as mappings in mappings."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        head, dot, rest = name.partition(".")
        if dot:
            inner = found.setdefault(head, {})
            if isinstance(inner, dict):
                inner[rest] = value
        elif isinstance(value, dict) and isinstance(found.get(name), dict):
            found[name] |= value
        else:
            found[name] = value
    return found


def _merge(values: dict[str, Any], more: Mapping[str, Any]) -> None:
    for name, value in more.items():
        if isinstance(value, dict) and isinstance(values.get(name), dict):
            values[name] |= value
        else:
            values[name] = value
