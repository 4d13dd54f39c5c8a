"""A search for the radius as lines of text and as plain data."""

from __future__ import annotations

from dataclasses import asdict
from fractions import Fraction
from typing import Any

from ..specs.exact import signed_text
from .options import Options
from .radius_search import RadiusSearch
from .report import describe, json_data, reason_lines, result_to_json, table, timing_text
from .result import Result, Verdict

RADIUS_FORMAT = "setrl-radius/1"
"""Name of the layout that `radius_to_json` writes."""


def radius_lines(found: RadiusSearch) -> list[str]:
    """One line per answer: ``VERIFIED up to 0.112: <claim>``, ``FALSIFIED from 0.14: <violation>``.

    Where no radius is VERIFIED and the least one not FALSIFIED, the first line is ``UNKNOWN at 0: <reason>``.
    """
    lines = []
    if found.verified is not None and found.verified_result is not None:
        result = found.verified_result
        lines += [f"{result.verdict.value} up to {signed_text(found.verified)}: {result.claim}"]
    elif found.unproved_result is not None and found.falsified != found.least:
        lines += [f"UNKNOWN at {signed_text(found.least)}: {_reason(found.unproved_result)}"]
    if found.falsified is not None and found.falsified_result is not None:
        lines += [f"FALSIFIED from {signed_text(found.falsified)}: {_reason(found.falsified_result)}"]
    return lines


def radius_details(found: RadiusSearch) -> list[str]:
    """Everything else that a person wants to know: what was tried, what lies between the answers, times."""
    tried = [("radius", "verdict"), *((signed_text(radius), verdict.value) for radius, verdict in found.tried)]
    lines = [*table(tried), *_between(found)]
    if found.stopped:
        lines += [f"{found.stopped}: more may be true of the radii in between"]
    if found.verified_result is not None:
        lines += ["", f"at the radius {signed_text(found.verified or Fraction(0))}:", *describe(found.verified_result)]
    elif found.unproved_result is not None and found.unproved_result.reason is not None:
        lines += ["", *reason_lines(found.unproved_result.reason, found.unproved_result)]
        lines += [f"note         {note}" for note in found.unproved_result.notes]
    return [*lines, f"search       {timing_text(found.timings)}"]


def _between(found: RadiusSearch) -> list[str]:
    """What is not known, after an empty line."""
    if found.falsified is None:
        if found.verified == found.most:
            return ["", f"{signed_text(found.most)} is the largest radius of the search"]
        return ["", f"no radius up to {signed_text(found.most)} is FALSIFIED"]
    if found.verified is None:
        return []
    gap = found.falsified - found.verified
    return [
        "",
        f"not known: the radii above {signed_text(found.verified)} and below {signed_text(found.falsified)}, "
        f"{signed_text(gap)} (resolution {signed_text(found.resolution)})",
    ]


def _reason(result: Result) -> str:
    return "" if result.reason is None else result.reason.sentence


def radius_to_json(
    found: RadiusSearch, options: Options | None = None, certificate_path: str | None = None
) -> dict[str, Any]:
    """A search as plain data: the same keys whatever the outcome; radii are exact decimals as text.

    Parameters
    ----------
    found : RadiusSearch
    options : Options, optional
        Numerical options of the search; null in the data where they are not given.
    certificate_path : str, optional
        Where the certificate of the largest VERIFIED radius was written.
    """
    from .. import __version__

    def answer(radius: Fraction | None, result: Result | None, path: str | None = None) -> dict[str, Any] | None:
        if radius is None or result is None:
            return None
        return {"radius": signed_text(radius), "result": result_to_json(result, options, path)}

    if found.verified_result is not None:
        verdict = found.verified_result.verdict
    else:
        verdict = Verdict.FALSIFIED if found.exit_code == Verdict.FALSIFIED.exit_code else Verdict.UNKNOWN
    data = {
        "format": RADIUS_FORMAT,
        "setrl": __version__,
        "verdict": verdict.value,
        "exit_code": found.exit_code,
        "verified": answer(found.verified, found.verified_result, certificate_path),
        "falsified": answer(found.falsified, found.falsified_result),
        "unproved": answer(found.least, found.unproved_result),
        "tried": [[signed_text(radius), verdict.value] for radius, verdict in found.tried],
        "least": signed_text(found.least),
        "most": signed_text(found.most),
        "resolution": signed_text(found.resolution),
        "stopped": found.stopped,
        "options": None if options is None else asdict(options),
        "timings": dict(found.timings),
    }
    return dict(json_data(data))
