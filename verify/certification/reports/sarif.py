"""certification.sarif and alerts.sarif: SARIF 2.1.0, each finding at the line of its requirement.

What is proved has the kind "pass", what is UNKNOWN "open", and only a violation, a file that cannot be used or an
objection of the gate is "fail": everything else has the level "none". A row that does not pass has at least one "fail".

GitHub's code scanning takes no notice of the kind and makes an alert of every result; alerts.sarif is for it.
"""

from __future__ import annotations

import hashlib
import json
from typing import Any
from urllib.parse import quote

from ..document import Outcome, Report, Row, Subject
from . import phrases
from .cases import Answer, Case, cases
from .text import visible

SCHEMA = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"
BASE = "%SRCROOT%"
RULES = {
    "avoid": ("Avoid", "No trajectory enters the region during the window."),
    "stay": ("Stay", "No trajectory leaves the region during the window."),
    "reach": ("Reach", "Every trajectory is in the region at some sampling instant of the window."),
    "value": ("VerifiedPerformance", "V(s0) is a lower bound of the return of every trajectory."),
    "radius": ("CertifiedRadius", "The largest perturbation radius of the observation that is VERIFIED."),
    "gate": ("Gate", "The row is what the manifest expects, and no worse than the baseline."),
    "input": ("Input", "Policy, specification and plant can be read and belong together."),
    "internal": ("Internal", "setrl itself did not fail."),
}


def render(report: Report) -> str:
    """The report as a SARIF log with one run: everything that was asked, and the answers.

    Parameters
    ----------
    report : Report
    """
    return _log(report, alerts=False)


def render_alerts(report: Report) -> str:
    """The same log with nothing but what makes a row fail: for readers to whom every result is an alert.

    Parameters
    ----------
    report : Report
    """
    return _log(report, alerts=True)


def _log(report: Report, alerts: bool) -> str:
    artifacts = _Artifacts()
    results = [_result(row, case, artifacts) for row in report.rows for case in _reported(row)]
    if alerts:
        results = [result for result in results if result["level"] == "error"]
    for row in report.rows:
        for subject in (row.policy, row.plant):
            artifacts.index(subject)
    driver: dict[str, Any] = {"name": "setrl", "rules": [_rule(name) for name in RULES]}
    if version := report.versions.get("setrl"):
        driver["version"] = visible(version)
    run = {
        "tool": {"driver": driver},
        "automationDetails": {"id": f"setrl/{quote(visible(report.manifest.name))}/"},
        "invocations": [
            {
                "executionSuccessful": all(row.outcome is not Outcome.INTERNAL for row in report.rows),
                "exitCode": report.exit_code,
            }
        ],
        "originalUriBaseIds": {BASE: {"description": {"text": "What the names in the manifest are relative to."}}},
        "artifacts": artifacts.entries,
        "columnKind": "unicodeCodePoints",
        "results": results,
        "properties": {"versions": {visible(key): visible(value) for key, value in report.versions.items()}},
    }
    log = {"$schema": SCHEMA, "version": "2.1.0", "runs": [run]}
    return json.dumps(log, ensure_ascii=False, allow_nan=False, indent=1) + "\n"


def _reported(row: Row) -> tuple[Case, ...]:
    """The row's cases, and its objections where no case would be an alert although the row does not pass."""
    found = cases(row)
    if row.passed or any(_kind(case) == "fail" for case in found):
        return found
    objections = row.objections or ("the row does not pass",)
    return (*found, *(Case("gate", f"gate {n}", Answer.OBJECTION, text) for n, text in enumerate(objections, 1)))


def _kind(case: Case) -> str:
    if case.answer is Answer.PROVED:
        return "pass"
    return "open" if case.answer in (Answer.OPEN, Answer.ASIDE) else "fail"


def _result(row: Row, case: Case, artifacts: _Artifacts) -> dict[str, Any]:
    kind = _kind(case)
    level = "error" if kind == "fail" else "none"
    finding = "\0".join((row.name, case.rule, case.name)).encode("utf-8", "surrogatepass")
    fingerprint = hashlib.sha256(finding).hexdigest()
    text = visible(f"{row.outcome.value}: {_asked(case)}: {case.message} ({row.name})")
    result: dict[str, Any] = {
        "ruleId": case.rule,
        "ruleIndex": list(RULES).index(case.rule),
        "kind": kind,
        "level": level,
        "message": {"text": text.replace("[", "\\[").replace("]", "\\]")},  # brackets would be a link
        "locations": [
            {
                "physicalLocation": {
                    "artifactLocation": {
                        **_location(row.specification),
                        "index": artifacts.index(row.specification),
                    },
                    "region": {"startLine": max(case.line, 1)},
                }
            }
        ],
        # the second is the one that code scanning reads: without it all policies of a specification are one alert
        "partialFingerprints": {"setrlCase/v1": fingerprint, "primaryLocationLineHash": f"{fingerprint[:16]}:1"},
        "properties": {"row": visible(row.name), "verdict": row.outcome.value, "passes": row.passed},
    }
    if row.value is not None:
        result["properties"]["value"] = phrases.value_of(row)
    if kind == "fail" and row.passed:
        expected = " or ".join(row.expected) or row.outcome.value
        result["level"] = "note"
        reason = visible(f"the manifest expects {expected}")
        result["suppressions"] = [{"kind": "external", "status": "accepted", "justification": reason}]
    return result


def _asked(case: Case) -> str:
    return case.name if case.rule in ("value", "radius", "gate", "input", "internal") else f"{case.rule} {case.name}"


def _rule(name: str) -> dict[str, Any]:
    title, sentence = RULES[name]
    return {
        "id": name,
        "name": title,
        "shortDescription": {"text": sentence},
        "fullDescription": {"text": sentence},
        "defaultConfiguration": {"level": "error"},
    }


class _Artifacts:
    """The files of the batch, each once, with its digest."""

    def __init__(self) -> None:
        self.entries: list[dict[str, Any]] = []
        self._known: dict[Subject, int] = {}

    def index(self, subject: Subject) -> int:
        """Where a file stands in the list; -1 for one that has no name."""
        if not subject.name:
            return -1
        if subject not in self._known:
            self._known[subject] = len(self.entries)
            entry: dict[str, Any] = {"location": _location(subject), "roles": ["analysisTarget"]}
            if subject.sha256:
                entry["hashes"] = {"sha-256": visible(subject.sha256)}
            self.entries.append(entry)
        return self._known[subject]


def _location(subject: Subject) -> dict[str, str]:
    """A relative reference: no name can be read as a scheme, a host or an absolute path."""
    return {"uri": quote(visible(subject.name).lstrip("/"), safe="/"), "uriBaseId": BASE}
