"""certification.json: the whole report as plain data, which every other format could be made from again."""

from __future__ import annotations

import json
import re

from ..document import Report

_SURROGATE = re.compile("[\ud800-\udfff]")


def render(report: Report) -> str:
    """The report as JSON text: keys in the order of the dataclasses, null for every number that is not finite.

    Parameters
    ----------
    report : Report
    """
    text = json.dumps(report.to_json(), ensure_ascii=False, allow_nan=False, indent=1)
    # the name of a file may hold bytes that are no UTF-8; inside a string JSON has an escape for those
    return _SURROGATE.sub(lambda match: f"\\u{ord(match[0]):04x}", text) + "\n"
