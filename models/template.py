"""A specification to start from: commented, complete, and valid as it is."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path

from .closed_loop import Plant

_PLAIN = re.compile(r"[\w./-]+", re.ASCII)


def specification_template(plant: Plant, reference: str, folder: Path) -> str:
    """Text of a specification for a plant.

    Parameters
    ----------
    plant : Plant
    reference : str
        The plant's shipped name, or the path of its file.
    folder : Path
        Where the specification will lie: a path in it is relative to that.

    Returns
    -------
    str
    """
    if "/" in reference or reference.endswith((".yaml", ".yml")):
        reference = os.path.relpath(reference, folder)
        reference = reference if "/" in reference or reference.endswith((".yaml", ".yml")) else f"./{reference}"
    text = plant.description
    first, inputs = plant.states[0], ", ".join(f"{name}: [-1, 1]" for name in plant.inputs)
    held = "seconds per step" if plant.discrete else "seconds; the action is held in between"
    rows = [
        f"# A specification for the plant {text.name}. Every number is a placeholder: replace it.",
        "# `setrl schema specification` prints what may stand here; `setrl verify POLICY.onnx --spec FILE` runs it.",
        "setrl: 1",
        "description: say what must hold and why",
        "",
        f"plant: {reference if _PLAIN.fullmatch(reference) else json.dumps(reference)}",
        f"# states: {_listed(text.states)}",
        f"# inputs: {_listed(text.inputs)}",
        "",
        "controller:",
        ("  period: 0.1", held),
        (f"  # observe: [{', '.join(plant.states)}]", f"what the policy sees, if not this; sin({first}) too"),
        ("  # before: {scale: 1, offset: 0}", "affine map of the observation; `after`: of the network's output"),
        (f"  # clip: {{{inputs}}}", "of the action"),
        ("  # delay: 1", "whole periods"),
        "",
        ("horizon: 1", "seconds, a multiple of the period"),
        "",
        ("initial:", "every state: a number, or [lower, upper]"),
        *((f"  {name}: [-0.01, 0.01]", unit) for name, unit in text.states.items()),
        "",
        "perturbation:",
        ("  observation: 0", f"radius, anew in every period; or by name: {{{first}: 0.01}}"),
        *_disturbances(text.disturbances),
        "",
        "requirements:",
        (f"  - stay: {{{first}: [-10, 10]}}", "at all times; or during: [t1, t2]"),
        f"    name: {first} is bounded",
        (f"  # - avoid: {{{first}: [1, 2]}}", "states that are not named are free"),
        "  #   name: obstacle",
        (f'  # - reach: "{first} <= 0.5"', "at the end; or at: a time"),
        "  #   name: goal",
        "",
        ("reward:", "-weights*|state - target| at the end of every period; may be left out"),
        f"  weights: {{{first}: 1}}",
        "  discount: 0.99",
    ]
    return "\n".join(row if isinstance(row, str) else _commented(*row) for row in rows) + "\n"


def _commented(text: str, comment: str) -> str:
    return f"{text:<32}  # {comment}" if comment and comment != "1" else text


def _listed(names: Mapping[str, str]) -> str:
    return ", ".join(f"{name} ({unit})" if unit and unit != "1" else name for name, unit in names.items())


def _disturbances(names: Mapping[str, str]) -> list[tuple[str, str]]:
    if not names:
        return []
    entries = [(f"    {name}: 0.01", unit) for name, unit in names.items()]
    return [("  disturbance:", "a radius, [lower, upper], or {range: ..., varies: never}"), *entries]
