"""What worker processes do for a batch: decide a row, or a part of one, and look at old evidence again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ...specs.exact import decimal_text
from ..deadline import Deadline
from ..parts import Cut, cut_like, joined
from ..radius import SPLITS, search_radius
from ..result import Result, Verdict
from ..verifier import Part, verify, verify_radii
from .document import RadiusFound
from .figures import Figures, figures_of, with_radius
from .question import Question

FIRST_CELLS = 64
"""A row that so many cells decide is not worth cutting."""


@dataclass(frozen=True)
class Hard:
    """A row that its first cells did not decide.

    Attributes
    ----------
    whole : Result
    cut : Cut
    """

    whole: Result
    cut: Cut


def decide(question: Question) -> Figures | Hard:
    """Decide one row; a hard one comes back cut, where the question allows that."""
    with question.files() as (policy, specification):
        if question.search is not None:
            return _search(question, policy, specification)
        splits = question.numerics().splits
        first = min(splits, FIRST_CELLS) if question.spread > 1 else splits
        result = verify(
            policy,
            specification,
            options=question.numerics(splits=first),
            epsilon=question.epsilon,
            workers=1,
        )
        if first < splits and result.verdict is Verdict.UNKNOWN and result.leaves >= first:
            cut = cut_like(result, question.spread)
            if len(cut.parts) > 1:
                return Hard(result, cut)
        return figures_of(result)


def decide_part(work: tuple[Question, Part, int]) -> Result:
    """Decide a row for the part of its initial set; the last number is how many cells the part may use."""
    question, part, splits = work
    with question.files() as (policy, specification):
        options = question.numerics(splits=splits)
        return verify_radii(policy, specification, [question.epsilon], options=options, part=part)[0]


def join(work: tuple[Question, Hard, Sequence[Result]]) -> Figures:
    """Put the parts' answers together, and their certificate before the checker."""
    question, hard, results = work
    with question.files():
        return figures_of(joined(hard.whole, hard.cut, results, Deadline.after(question.timeout)))


def _search(question: Question, policy: str, specification: str) -> Figures:
    """The certified radius; the figures are those of that radius, else of the smallest one that was tried."""
    if question.search is None:
        raise AssertionError("nothing to search")
    found = search_radius(
        policy,
        specification,
        most=question.search.most,
        resolution=question.search.resolution,
        options=question.numerics(**({} if "splits" in question.options else {"splits": SPLITS})),
        deadline=Deadline.after(question.timeout),
        workers=1,
    )
    result = found.verified_result or found.falsified_result or found.unproved_result
    radius = RadiusFound(
        None if found.verified is None else decimal_text(found.verified),
        None if found.falsified is None else decimal_text(found.falsified),
        decimal_text(question.search.resolution),
        tuple((decimal_text(tried), verdict.value) for tried, verdict in found.tried),
    )
    if result is None:
        raise AssertionError("a search that found nothing says why")
    if found.stopped:
        note = f"the search was ended by its {found.stopped}: a larger radius may verify, a smaller one may fail"
        result = replace(result, notes=(*result.notes, note))
    return with_radius(figures_of(result), radius)
