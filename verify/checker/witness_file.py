"""The file of a witness: exact numbers as text, the same text for the same witness.

Version 2 has one key more than version 1, `deployed`; both are read, version 2 is written.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeAlias

from ...specs.errors import InputError

Numbers: TypeAlias = tuple[Fraction, ...]

FORMAT, EARLIER = "setrl-witness/2", "setrl-witness/1"
KEYS = (
    *("format", "requirement", "time", "initial", "noise", "disturbances", "policy", "specification", "plant"),
    "observation_radius",
)
MAX_BYTES, MAX_NUMBERS, MAX_DIGITS = 16 << 20, 100_000, 1200
"""A file with more is refused before it is taken apart, so that no file keeps a reader busy."""

_RATIONAL = re.compile(rf"(-?[0-9]{{1,{MAX_DIGITS}}})(?:/([1-9][0-9]{{0,{MAX_DIGITS}}}))?", re.ASCII)
_RUNTIME = re.compile(r"onnxruntime [0-9A-Za-z.+-]{1,40}", re.ASCII)


@dataclass(frozen=True)
class Recording:
    """What went into the ONNX file and came out of it when a runtime drove the plant, one row per period.

    Attributes
    ----------
    runtime : str
        Name and version, such as "onnxruntime 1.31.1".
    observations : tuple of tuples of Fraction, periods x inputs of the network
    actions : tuple of tuples of Fraction, periods x outputs of the network
        Of the file itself, before the specification's `after` and `clip`. Both have one row for every period that
        begins before the violation is read off.
    """

    runtime: str
    observations: tuple[Numbers, ...]
    actions: tuple[Numbers, ...]


@dataclass(frozen=True)
class Witness:
    """A proposed violation, all numbers exact.

    Attributes
    ----------
    requirement : str
    time : Fraction or None
        Seconds at which an `avoid` or `stay` requirement is violated; None for `reach`, which is missed at every
        sampling instant of its window.
    initial : tuple of Fraction
        In the plant's order of states.
    noise : tuple of tuples of Fraction, periods x observations
    disturbances : tuple of tuples of Fraction, periods x disturbances
    policy, specification, plant : str
        sha256 of the files' bytes; `plant` is "" where the specification contains its plant.
    observation_radius : tuple of Fraction, optional
        Instead of the specification's, where the question was asked for other radii.
    deployed : Recording, optional
        Where a runtime executed the policy from this start under these perturbations.
    """

    requirement: str
    time: Fraction | None
    initial: Numbers
    noise: tuple[Numbers, ...]
    disturbances: tuple[Numbers, ...]
    policy: str
    specification: str
    plant: str = ""
    observation_radius: Numbers | None = None
    deployed: Recording | None = None

    def to_json(self) -> str:
        """Text of a witness file: rationals as strings, the same text for the same witness."""
        radius, deployed = self.observation_radius, self.deployed
        data = {
            "format": FORMAT,
            "requirement": self.requirement,
            "time": None if self.time is None else str(self.time),
            "initial": _texts(self.initial),
            "noise": [_texts(row) for row in self.noise],
            "disturbances": [_texts(row) for row in self.disturbances],
            "policy": self.policy,
            "specification": self.specification,
            "plant": self.plant,
            "observation_radius": None if radius is None else _texts(radius),
            "deployed": None
            if deployed is None
            else {
                "runtime": deployed.runtime,
                "observations": [_texts(row) for row in deployed.observations],
                "actions": [_texts(row) for row in deployed.actions],
            },
        }
        lines = [f"  {json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}" for key, value in data.items()]
        return "{\n" + ",\n".join(lines) + "\n}\n"


def _texts(numbers: Numbers) -> list[str]:
    return [str(number) for number in numbers]


def read_witness(content: bytes) -> Witness:
    """Read a witness file of either version.

    Parameters
    ----------
    content : bytes

    Returns
    -------
    Witness

    Raises
    ------
    InputError
        The bytes are not exactly of the format, or too many.
    """
    if len(content) > MAX_BYTES or content.count(b",") > MAX_NUMBERS:
        raise InputError(f"a witness has at most {MAX_BYTES} bytes and {MAX_NUMBERS} numbers")
    try:
        # objects become tuples of pairs and arrays stay lists, so that no key can hide behind another
        root = json.loads(content.decode("utf-8"), object_pairs_hook=tuple)
    except (ValueError, RecursionError) as error:
        raise InputError("the witness is no JSON document") from error
    version = root[0][1] if isinstance(root, tuple) and root and root[0][0] == "format" else None
    if version not in (FORMAT, EARLIER):
        raise InputError(f"a witness of format {FORMAT} or {EARLIER} is required")
    data = _object(root, KEYS if version == EARLIER else (*KEYS, "deployed"), "a witness")
    radius, deployed = data["observation_radius"], data.get("deployed")
    return Witness(
        requirement=_text(data["requirement"]),
        time=None if data["time"] is None else _rational(data["time"]),
        initial=_rationals(data["initial"]),
        noise=_rows(data["noise"]),
        disturbances=_rows(data["disturbances"]),
        policy=_text(data["policy"]),
        specification=_text(data["specification"]),
        plant=_text(data["plant"]),
        observation_radius=None if radius is None else _rationals(radius),
        deployed=None if deployed is None else _recording(deployed),
    )


def _recording(value: Any) -> Recording:
    data = _object(value, ("runtime", "observations", "actions"), "deployed")
    runtime = _text(data["runtime"])
    if not _RUNTIME.fullmatch(runtime):
        raise InputError("the runtime is a text such as onnxruntime 1.31.1")
    return Recording(runtime, _rows(data["observations"]), _rows(data["actions"]))


def _object(value: Any, keys: tuple[str, ...], what: str) -> dict[str, Any]:
    if not isinstance(value, tuple) or tuple(key for key, _ in value) != keys:
        raise InputError(f"{what} has the keys {', '.join(keys)}, each once and in this order")
    return dict(value)


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise InputError("names and digests of a witness are texts")
    return value


def _rational(value: Any) -> Fraction:
    match = _RATIONAL.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        raise InputError("numbers of a witness are texts such as -3/8")
    return Fraction(int(match[1]), int(match[2] or 1))


def _rationals(value: Any) -> Numbers:
    if not isinstance(value, list):
        raise InputError("a list of numbers is required")
    return tuple(map(_rational, value))


def _rows(value: Any) -> tuple[Numbers, ...]:
    if not isinstance(value, list):
        raise InputError("a list of lists of numbers is required")
    return tuple(map(_rationals, value))
