"""VERIFIED and a proved violation on the same question: an error of this program, and what a report of it needs."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Sequence
from pathlib import Path

from ..specs.files import write_atomically
from .result import Result, Verdict


def require_no_contradiction(results: Sequence[Result]) -> None:
    """Raise where one result is VERIFIED and another one FALSIFIED for perturbations that the first one allows.

    Writes everything that a report needs to `setrl-bug-....zip` in the current folder first.

    Parameters
    ----------
    results : sequence of Result
        Of one policy, specification and plant.

    Raises
    ------
    AssertionError
        The engine and the checker accepted both.
    """
    for proved in results:
        for refuted in results:
            if proved.verdict is not Verdict.VERIFIED or refuted.witness is None:
                continue
            if len(proved.semantics) == 1 and "real" not in refuted.witness.grade:
                continue  # of the deployed network only, about which nothing was verified
            pairs = zip(refuted.loop.observation_radius, proved.loop.observation_radius, strict=True)
            if all(small <= large for small, large in pairs):
                path = write_bug_bundle(proved, refuted)
                raise AssertionError(
                    f"both verified and falsified, which cannot be: {refuted.witness.sentence}; please report {path}"
                )


def write_bug_bundle(proved: Result, refuted: Result, folder: Path | None = None) -> Path:
    """Put a contradiction's certificate, witness, policy, specification and the versions into one file.

    Parameters
    ----------
    proved, refuted : Result
    folder : Path, optional
        The current one by default.

    Returns
    -------
    Path
        ``setrl-bug-<digest>.zip``, the same bytes for the same contradiction on the same machine.
    """
    from .doctor import examine

    loop = proved.loop
    source = Path("" if loop.specification is None else loop.specification.source)
    witness = "" if refuted.witness is None else refuted.witness.content
    content = {
        "certificate.cert": proved.certificate or b"",
        "witness.json": witness.encode(),
        "policy.onnx": loop.policy.content,
        "specification.yaml": source.read_bytes() if source.is_file() else b"",
        "machine.json": json.dumps(examine(), indent=1, sort_keys=True).encode(),
    }
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_DEFLATED) as bundle:
        for name, data in content.items():
            bundle.writestr(zipfile.ZipInfo(name), data)
    name = hashlib.sha256(b"".join(content.values())).hexdigest()[:12]
    path = (folder or Path.cwd()) / f"setrl-bug-{name}.zip"
    write_atomically(path, memory.getvalue())
    return path
