"""A claim and its certificate, put before the checker: what makes a verdict VERIFIED."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

from .checker.certificate import Accepted
from .checker.certificate import check as check_certificate
from .deadline import Deadline
from .evidence_files import EvidenceFiles
from .result import Reason, Result, Value, Verdict


def certified(
    result: Result,
    files: EvidenceFiles,
    deadline: Deadline,
    workers: int | None = None,
    watch: Callable[[int, int], None] | None = None,
) -> Result:
    """A claim with its certificate: VERIFIED where the checker accepts it, UNKNOWN where it does not.

    What is VERIFIED are the checker's figures, not the engine's.

    Parameters
    ----------
    result : Result
        CLAIMED, with its certificate.
    files : EvidenceFiles
    deadline : Deadline
    workers : int, optional
        Processes that check leaves side by side.
    watch : callable, optional
        Told after every leaf: (leaves checked, leaves in all).

    Returns
    -------
    Result
    """
    if result.verdict is not Verdict.CLAIMED or result.certificate is None:
        raise AssertionError("only a claim with its certificate is checked")
    started = time.perf_counter()
    answer = check_certificate(
        result.certificate,
        files.policy,
        files.specification,
        files.folder,
        progress=watch,
        workers=workers,
        stop=lambda: deadline.expired,
    )
    timings = {**result.timings, "check": time.perf_counter() - started}
    if isinstance(answer, Accepted):
        reward = result.loop.reward
        return replace(
            result,
            verdict=Verdict.VERIFIED,
            timings=timings,
            requirements=tuple(
                replace(entry, margin=margin)
                for entry, (_, margin) in zip(result.requirements, answer.margins, strict=True)
            ),
            value=None if reward is None or answer.value is None else Value(*answer.value, float(reward.discount)),
        )
    reason = Reason(
        f"every cell was proved, but the checker did not accept the certificate: {answer}",
        source="check",
        remedy="give it more time, or report this: the engine and its checker should not disagree",
        verified_until=0.0,
        stopped=deadline.word if deadline.expired else "",
    )
    return replace(result, verdict=Verdict.UNKNOWN, reason=reason, timings=timings, certificate=None)
