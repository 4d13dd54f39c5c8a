"""All report files of a batch, into one folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ....specs.files import write_atomically
from ..document import Report
from . import archcomp, html, json_report, junit, markdown, sarif

FILES: dict[str, Callable[[Report], str]] = {
    "certification.json": json_report.render,
    "junit.xml": junit.render,
    "certification.sarif": sarif.render,
    "alerts.sarif": sarif.render_alerts,
    "summary.md": markdown.render,
    "index.html": html.render,
    "results.csv": archcomp.render,
}
"""File name -> what renders it."""


def write_reports(report: Report, folder: Path) -> dict[str, Path]:
    """Write every format, each file whole or not at all.

    Parameters
    ----------
    report : Report
    folder : Path
        Is there already.

    Returns
    -------
    dict of str to Path
        By file name.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    written = {}
    for name, render in FILES.items():
        written[name] = folder / name
        write_atomically(written[name], render(report).encode())
    return written
