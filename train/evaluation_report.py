"""An evaluation for people and for programs: pure functions to lines of text, comma-separated values and plain data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..specs.exact import signed_text
from ..verify.report import json_data, table, timing_text
from ..verify.tables import comma_separated
from ..verify.wording import at_least, number, quantity
from .evaluation import ATTACKS, Evaluation, compare
from .statistics import CONFIDENCE, Summary, summary

Array = NDArray[np.float64]

EVALUATION_FORMAT = "setrl-evaluation/1"
"""Name of the layout that `evaluation_to_json` writes."""


def evaluation_lines(evaluation: Evaluation) -> list[str]:
    """Everything that a person wants to know: what was done, a row per radius, a row per seed, how to read them."""
    count = len(evaluation.seeds)
    lines = [f"{evaluation.specification or 'specification'}: {quantity(count, 'policy')}, one per seed", ""]
    lines += [*radius_table(evaluation), "", *seed_table(evaluation), ""]
    lines += _collapse_lines(evaluation) + _notes(evaluation)
    return [*lines, f"time: {timing_text(evaluation.timings)}"]


def radius_table(evaluation: Evaluation) -> list[str]:
    """One row per radius: V(s0) as median, mean and interval over the seeds; medians under every adversary."""
    attacks = [name for name in ATTACKS if name in evaluation.attacked]
    rows: list[tuple[str, ...]] = [("epsilon", "V(s0) median", "mean", "95 % interval", "worst seed", *attacks)]
    for position, radius in enumerate(evaluation.radii):
        values = evaluation.verified.discounted[:, position]
        found = summary(values)
        losses = [number(float(np.median(evaluation.attacked[name].discounted[:, position]))) for name in attacks]
        shown = (at_least(found.median), number(found.mean), interval_text(found), at_least(float(values.min())))
        rows.append((signed_text(radius), *shown, *losses))
    return table(rows)


def seed_table(evaluation: Evaluation) -> list[str]:
    """One row per seed: undisturbed return, V(s0) at the first and the last radius, certified radius, collapse."""
    ends = sorted({0, len(evaluation.radii) - 1})
    header = ["seed", "undisturbed", *(f"V(s0) at {signed_text(evaluation.radii[end])}" for end in ends)]
    rows: list[tuple[str, ...]] = [(*header, "certified radius", "")]
    for position, seed in enumerate(evaluation.seeds):
        values = [at_least(float(evaluation.verified.discounted[position, end])) for end in ends]
        word = "COLLAPSED" if evaluation.collapses[position].collapsed else ""
        nominal = number(float(evaluation.nominal.discounted[position]))
        rows.append((str(seed), nominal, *values, _searched_text(evaluation, position), word))
    found = summary(evaluation.nominal.discounted)
    medians = [at_least(float(np.median(evaluation.verified.discounted[:, end]))) for end in ends]
    rows.append(("median", number(found.median), *medians, _median_radius(evaluation), ""))
    return table(rows)


def comparison_lines(first: Evaluation, second: Evaluation, names: tuple[str, str]) -> list[str]:
    """Whether the first trainings have a higher V(s0) than the second: paired tests, one row per radius.

    Parameters
    ----------
    first, second : Evaluation
        Of the same seeds, radii and specification.
    names : pair of str

    Returns
    -------
    list of str
    """
    rows: list[tuple[str, ...]] = [
        ("epsilon", f"{names[0]} higher", "lower", "equal", "median difference", "Wilcoxon p", "sign p")
    ]
    for radius, found in zip(first.radii, compare(first, second), strict=True):
        counts = [str(n) for n in (found.higher, found.lower, found.equal)]
        tests = [number(x) for x in (found.median_difference, found.wilcoxon, found.sign)]
        rows.append((signed_text(radius), *counts, *tests))
    note = f"one-sided, over {quantity(len(first.seeds), 'seed')}; p is that of `{names[0]}` being no better than "
    return [*table(rows), "", f"{note}`{names[1]}`, for each radius alone"]


def interval_text(found: Summary) -> str:
    """``[-31.2, -28.4]``, or a dash where there is none."""
    return "-" if found.interval is None else "[{}, {}]".format(*map(number, found.interval))


def certified_text(evaluation: Evaluation, position: int) -> str:
    """The certified radius of one policy; "none" where no radius is, a dash where none was asked for."""
    found = evaluation.certified[position]
    if not evaluation.certifiable:
        return "-"
    return "none" if found is None else signed_text(found)


def evaluation_csv(evaluation: Evaluation) -> str:
    """One row per seed, radius and quantity, with all digits; ``-inf`` is no bound, or a trajectory that diverged.

    What has no radius (`nominal`, `certified_radius`, `collapsed`) has an empty one.
    """
    rows: list[list[Any]] = [["seed", "epsilon", "quantity", "discounted", "undiscounted"]]
    for position, seed in enumerate(evaluation.seeds):
        nominal = evaluation.nominal
        rows.append([seed, "", "nominal", float(nominal.discounted[position]), float(nominal.undiscounted[position])])
        for column, radius in enumerate(evaluation.radii):
            for name, found in (*evaluation.attacked.items(), ("verified", evaluation.verified)):
                pair = [float(part[position, column]) for part in (found.discounted, found.undiscounted)]
                rows.append([seed, signed_text(radius), name, *pair])
        if evaluation.certifiable:
            rows.append([seed, "", "certified_radius", certified_text(evaluation, position), ""])
        rows.append([seed, "", "collapsed", int(evaluation.collapses[position].collapsed), ""])
    return comma_separated(rows)


def evaluation_to_json(evaluation: Evaluation) -> dict[str, Any]:
    """The evaluation as plain data; null where a number is not finite."""
    quantities = {"verified": evaluation.verified, **evaluation.attacked}
    data = {
        "format": EVALUATION_FORMAT,
        "specification": evaluation.specification,
        "plant": evaluation.plant,
        "discount": evaluation.discount,
        "starts": evaluation.starts,
        "radii": [float(radius) for radius in evaluation.radii],
        "resolution": float(evaluation.resolution),
        "certifiable": evaluation.certifiable,
        "policies": [
            {
                "seed": seed,
                "nominal": _pair(evaluation.nominal.discounted[row], evaluation.nominal.undiscounted[row]),
                **{name: _pair(found.discounted[row], found.undiscounted[row]) for name, found in quantities.items()},
                "certified_radius": _float(evaluation.certified[row]),
                "collapse": {**asdict(evaluation.collapses[row]), "collapsed": evaluation.collapses[row].collapsed},
            }
            for row, seed in enumerate(evaluation.seeds)
        ],
        "timings": dict(evaluation.timings),
    }
    return dict(json_data(data))


def _pair(discounted: Any, undiscounted: Any) -> dict[str, Any]:
    return {"discounted": np.asarray(discounted).tolist(), "undiscounted": np.asarray(undiscounted).tolist()}


def _float(radius: Fraction | None) -> float | None:
    return None if radius is None else float(radius)


def _searched_text(evaluation: Evaluation, position: int) -> str:
    """The certified radius; the grid's last one is where the search ended, not the policy's limit."""
    text = certified_text(evaluation, position)
    return f">= {text}" if evaluation.certified[position] == max(evaluation.radii) else text


def _median_radius(evaluation: Evaluation) -> str:
    """A policy without one counts as less than any; between two of an even number the smaller one, which holds."""
    if not evaluation.certifiable:
        return "-"
    ordered: Sequence[Fraction] = sorted(Fraction(-1) if r is None else r for r in evaluation.certified)
    middle = ordered[(len(ordered) - 1) // 2]
    return "none" if middle < 0 else signed_text(middle)


def _collapse_lines(evaluation: Evaluation) -> list[str]:
    lines = []
    for seed, found in zip(evaluation.seeds, evaluation.collapses, strict=True):
        if found.collapsed:
            lines.append(f"COLLAPSED: seed {seed}: {'; '.join(found.reasons)}")
    return [*lines, ""] if lines else []


def _notes(evaluation: Evaluation) -> list[str]:
    count = len(evaluation.seeds)
    where = "the initial state" if evaluation.starts == 1 else f"the worst of {evaluation.starts} initial states"
    lines = [
        f"V(s0): a proved lower bound of the return (discount {number(evaluation.discount)}) under every perturbation",
        f"adversaries are simulated from {where}: the worst return is not above theirs, and not below V(s0)",
    ]
    if evaluation.certifiable:
        step = signed_text(evaluation.resolution)
        lines.append(f"certified radius: every requirement VERIFIED, the certificate accepted; searched to {step}")
    if count > 1:
        from scipy.stats import t

        factor = float(t.ppf(0.5 + CONFIDENCE / 2.0, count - 1))
        words = f"of the mean over {count} seeds, Student's t with factor {factor:.3f}"
        lines.append(f"95 % interval: {words}; of no use where trainings end in two kinds of policies")
    else:
        lines.append("one seed: no interval")
    return lines
