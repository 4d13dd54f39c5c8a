"""junit.xml: a test suite per row and a test case per requirement, for Jenkins, GitLab and everything like them.

UNKNOWN is a failure unless the row passes all the same, and then it is skipped; bad input and internal errors are
errors. The layout is that of Jenkins' ``junit-10.xsd``.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

from ..document import Outcome, Report, Row
from . import phrases
from .cases import Answer, Case, cases
from .text import visible


def render(report: Report) -> str:
    """The report as a JUnit XML document.

    Parameters
    ----------
    report : Report
    """
    root = ET.Element("testsuites", name=visible(report.manifest.name) or "setrl certify", time=_time(report.seconds))
    suites = [_suite(row, number) for number, row in enumerate(report.rows)]
    for key in ("tests", "failures", "errors"):
        root.set(key, str(sum(int(suite.get(key, "0")) for suite in suites)))
    root.extend(suites)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _suite(row: Row, number: int) -> ET.Element:
    asked = cases(row)
    total = row.timings.get("total", sum(row.timings.values()))
    suite = ET.Element("testsuite", name=visible(row.name), id=str(number))
    for case in asked:
        suite.append(_testcase(row, case, total / len(asked)))
    suite.set("tests", str(len(asked)))
    for key, child in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
        suite.set(key, str(len(suite.findall(f"testcase/{child}"))))
    suite.set("time", _time(total))
    suite.set("package", visible(row.policy.name))
    facts = _facts(row)
    properties = ET.Element("properties")
    for key, value in facts.items():
        ET.SubElement(properties, "property", name=key, value=visible(value))
    suite.insert(0, properties)
    return suite


def _facts(row: Row) -> dict[str, str]:
    """What a reader of the suite wants to know about the row as a whole."""
    facts = {
        "verdict": row.outcome.value,
        "source": row.source.value,
        "passes": "yes" if row.passed else "no",
        "epsilon": phrases.radius_text(row),
        "policy.sha256": row.policy.sha256,
        "specification.sha256": row.specification.sha256,
        "plant.sha256": row.plant.sha256,
    }
    if row.value is not None:
        facts["V(s0)"] = phrases.value_of(row)
    if row.evidence is not None:
        facts[row.evidence.kind] = row.evidence.path
    return {key: value for key, value in facts.items() if value}


def _testcase(row: Row, case: Case, seconds: float) -> ET.Element:
    name = case.name if case.rule in ("input", "internal", "gate") else f"{case.rule} {case.name}"
    element = ET.Element("testcase", name=visible(name), classname=visible(row.name), time=_time(seconds))
    said = f"{row.outcome.value}: {case.message}" if case.answer is not Answer.OBJECTION else case.message
    child = _child(row, case)
    outcome = ET.SubElement(element, child)
    if child == "system-out":
        outcome.text = visible(said)
        return element
    outcome.set("type", case.answer.value if row.outcome is Outcome.VERIFIED else row.outcome.value)
    outcome.set("message", visible(said))
    if row.objections:
        outcome.text = visible("; ".join(row.objections))
    return element


def _child(row: Row, case: Case) -> str:
    """What a case has inside: an answer that is no fault is only printed."""
    if case.answer is Answer.PROVED:
        return "system-out"
    if case.answer is Answer.BROKEN:
        return "error"
    if case.answer is Answer.ASIDE:
        return "skipped"
    if row.passed:
        return "skipped" if case.answer is Answer.OPEN else "system-out"
    return "failure"


def _time(seconds: float) -> str:
    return f"{max(seconds, 0.0):.3f}"
