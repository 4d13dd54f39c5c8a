"""What a batch found, as data: the one source of every report format.

A `Report` is read from, and written to, plain data for JSON (`Report.to_json`, `report_from_json`); every number that
is not finite is None, every exact number is its decimal text. Times are kept apart (`Row.timings`, `Report.seconds`),
because they are not compared.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any

from ...specs.errors import InputError

FORMAT = "setrl-certification/1"
"""Name of the layout; it changes when a key changes its meaning or goes."""


class Outcome(StrEnum):
    """What is known about a row, best to worst.

    The three verdicts; ERROR, where the row's files cannot be used; INTERNAL, where setrl itself failed.
    """

    VERIFIED = "VERIFIED"
    UNKNOWN = "UNKNOWN"
    FALSIFIED = "FALSIFIED"
    ERROR = "ERROR"
    INTERNAL = "INTERNAL"

    @property
    def exit_code(self) -> int:
        """0 verified, 5 unknown, 10 falsified, 2 bad input, 6 internal error."""
        return {"VERIFIED": 0, "UNKNOWN": 5, "FALSIFIED": 10, "ERROR": 2, "INTERNAL": 6}[self.value]

    @property
    def rank(self) -> int:
        """Position from best to worst: a batch is as bad as its worst member."""
        return list(Outcome).index(self)


class Source(StrEnum):
    """How this run knows a row's outcome."""

    DECIDED = "decided"
    """Decided in this run."""
    JOURNAL = "journal"
    """On the word of the journal: nothing that the verdict depends on has changed."""
    RECHECKED = "rechecked"
    """The same, and its certificate or witness was proved again in this run."""


@dataclass(frozen=True)
class Subject:
    """A file that a verdict is about, as an in-toto subject.

    Attributes
    ----------
    name : str
        Path as the manifest has it (relative, with /), or a shipped name; "" for a plant inside the specification.
    sha256 : str
        Of the bytes; "" where there are none of its own.
    """

    name: str
    sha256: str


@dataclass(frozen=True)
class RequirementRow:
    """One requirement of a row.

    Attributes
    ----------
    name : str
    kind : str
        "avoid", "stay" or "reach".
    proved : bool
    margin : float or None
        Smallest signed margin, in the requirement's unit; > 0 is proof. None where no set could be compared.
    time : float or None
        Seconds at which it is smallest.
    line : int
        Line in the specification; 0 where there is none.
    curve : tuple of (float or None)
        The engine's margin of every control period: entry 0 belongs to time 0, entry k to ((k-1) T, k T]; None outside
        the window. Empty where none was kept.
    """

    name: str
    kind: str
    proved: bool
    margin: float | None
    time: float | None
    line: int
    curve: tuple[float | None, ...] = ()


@dataclass(frozen=True)
class Why:
    """Why a row is not VERIFIED.

    Attributes
    ----------
    kind : str
        "proof" (not proved, or disproved), "resource" (time, memory, a lost process), "input" or "internal".
    sentence : str
    requirement : str
    time : float or None
    source : str
        Dominant source of growth.
    remedy : str
    verified_until : float
        Seconds up to which everything is proved.
    verified_part : float
        Share of the initial set that is proved.
    """

    kind: str
    sentence: str
    requirement: str = ""
    time: float | None = None
    source: str = ""
    remedy: str = ""
    verified_until: float = 0.0
    verified_part: float = 0.0


@dataclass(frozen=True)
class ValueRow:
    """Verified performance V(s0): lower bounds of every return; None where there is none.

    Attributes
    ----------
    discounted, undiscounted : float or None
    discount : float
    """

    discounted: float | None
    undiscounted: float | None
    discount: float


@dataclass(frozen=True)
class Evidence:
    """A certificate or a witness in the output folder.

    Attributes
    ----------
    kind : str
        "certificate" or "witness".
    path : str
        Relative to the report.
    sha256 : str
    bytes : int
    detail : str
        Of a certificate how many cells, of a witness what is proved of which semantics.
    """

    kind: str
    path: str
    sha256: str
    bytes: int
    detail: str


@dataclass(frozen=True)
class RadiusFound:
    """Outcome of a search for the certified radius; exact decimals as text.

    Attributes
    ----------
    verified : str or None
        Largest radius that is VERIFIED.
    falsified : str or None
        Smallest radius that is FALSIFIED.
    resolution : str
    tried : tuple of (radius, verdict)
        Every radius whose verdict was asked for, in ascending order.
    """

    verified: str | None
    falsified: str | None
    resolution: str
    tried: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Change:
    """Difference to the baseline's row of the same name.

    Attributes
    ----------
    verdict, value, margin, radius : (before, after) or None
        None where the two do not differ or are not known.
    regressions : tuple of str
        What got worse by more than the tolerance; empty where nothing did.
    """

    verdict: tuple[str, str] | None = None
    value: tuple[float | None, float | None] | None = None
    margin: tuple[float | None, float | None] | None = None
    radius: tuple[str | None, str | None] | None = None
    regressions: tuple[str, ...] = ()


@dataclass(frozen=True)
class Row:
    """One policy, one specification, one perturbation radius: the verdict and how the gate judges it.

    Attributes
    ----------
    name : str
        Unique in the report and stable between runs: ``policy x specification @ radius``.
    key : str
        sha256 of everything the verdict depends on.
    policy, specification, plant : Subject
    epsilon : str or None
        Radius of the observation perturbation; None is the specification's own.
    search : bool
        Whether the row searches the certified radius instead.
    outcome : Outcome
    source : Source
    passed : bool
        Whether the row passes the gate; `objections` says why not.
    exit_code : int
        0 where it passed.
    objections : tuple of str
        "UNKNOWN is not allowed", "V(s0) >= -40 is required, -53.1 is proved", a regression, ...
    expected : tuple of str
        Verdicts that the manifest expects; empty where it expects VERIFIED.
    allow_unknown : bool
    claim : str
        What VERIFIED says here; "" otherwise.
    why : Why or None
        None where the row is VERIFIED.
    requirements : tuple of RequirementRow
    value : ValueRow or None
    radius : RadiusFound or None
    semantics : tuple of str
        Arithmetics of the network that are covered.
    assumptions : tuple of str
        What the verdict rests on, a sentence each.
    notes : tuple of str
    cells, leaves : int
    evidence : Evidence or None
    picture : dict or None
        What `reports.picture` drew of the flowpipe.
    change : Change or None
    period, horizon : float
        Seconds; 0 where the specification was not read.
    options : dict
        Numerical options that differ from the defaults.
    timings : dict of phase to seconds
        "load", "reachability", "falsification", "certificate", "check", "total"; those that there were.
    """

    name: str
    key: str
    policy: Subject
    specification: Subject
    plant: Subject
    epsilon: str | None
    outcome: Outcome
    search: bool = False
    source: Source = Source.DECIDED
    passed: bool = False
    exit_code: int = 0
    objections: tuple[str, ...] = ()
    expected: tuple[str, ...] = ()
    allow_unknown: bool = False
    claim: str = ""
    why: Why | None = None
    requirements: tuple[RequirementRow, ...] = ()
    value: ValueRow | None = None
    radius: RadiusFound | None = None
    semantics: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    cells: int = 0
    leaves: int = 0
    evidence: Evidence | None = None
    picture: dict[str, Any] | None = None
    change: Change | None = None
    period: float = 0.0
    horizon: float = 0.0
    options: dict[str, Any] = field(default_factory=dict)
    timings: dict[str, float] = field(default_factory=dict)

    @property
    def margin(self) -> float | None:
        """Smallest margin of all requirements; None where one has none, or there is no requirement."""
        margins = [entry.margin for entry in self.requirements]
        known = [margin for margin in margins if margin is not None]
        return min(known) if known and len(known) == len(margins) else None


@dataclass(frozen=True)
class Baseline:
    """The report that this one is compared with.

    Attributes
    ----------
    name, sha256 : str
    tolerance : str
        By how much V(s0), margin or certified radius may fall: an exact decimal.
    missing : tuple of str
        Rows of the baseline that this report has not.
    added : tuple of str
        Rows of this report that the baseline has not.
    """

    name: str
    sha256: str
    tolerance: str
    missing: tuple[str, ...] = ()
    added: tuple[str, ...] = ()


@dataclass(frozen=True)
class Report:
    """A whole batch.

    Attributes
    ----------
    manifest : Subject
    versions : dict of str
        setrl, python and the packages that a verdict depends on.
    rows : tuple of Row
        In the manifest's order.
    exit_code : int
        Of the worst row.
    baseline : Baseline or None
    seconds : float
        Wall time of this run.
    """

    manifest: Subject
    versions: dict[str, str]
    rows: tuple[Row, ...]
    exit_code: int
    baseline: Baseline | None = None
    seconds: float = 0.0

    @property
    def counts(self) -> dict[str, int]:
        """Rows by outcome; outcomes that did not occur are left out."""
        return {
            outcome.value: count
            for outcome in Outcome
            if (count := sum(1 for row in self.rows if row.outcome is outcome))
        }

    @property
    def failed(self) -> tuple[Row, ...]:
        """Rows that do not pass the gate."""
        return tuple(row for row in self.rows if not row.passed)

    def to_json(self) -> dict[str, Any]:
        """Plain data, the same keys whatever the outcome; None for every number that is not finite."""
        from ..report import json_data

        return {"format": FORMAT, **dict(json_data(asdict(self)))}


def row_from_json(data: Any) -> Row:
    """A row from what `asdict` made of it, by way of JSON.

    Raises
    ------
    InputError
        The data is not of this layout.
    """
    try:
        return _row(data)
    except (TypeError, KeyError, ValueError, AttributeError) as error:
        raise InputError(f"not a row of {FORMAT}: {error}", remedy="write the report again") from None


def report_from_json(data: Any) -> Report:
    """A report from what `Report.to_json` wrote.

    Raises
    ------
    InputError
        The data is not of this layout.
    """
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        received = data.get("format", "none") if isinstance(data, dict) else "none"
        raise InputError(
            f"a report of the format {FORMAT} is required, received {str(received)[:40]!r}",
            remedy="give the certification.json that setrl certify wrote",
        )
    try:
        baseline = data["baseline"]
        return Report(
            Subject(**data["manifest"]),
            dict(data["versions"]),
            tuple(_row(row) for row in data["rows"]),
            int(data["exit_code"]),
            None if baseline is None else Baseline(**_tuples(baseline, "missing", "added")),
            float(data["seconds"]),
        )
    except (TypeError, KeyError, ValueError, AttributeError) as error:
        raise InputError(f"the report is damaged: {error}", remedy="write it again: setrl certify") from None


def _row(data: Any) -> Row:
    fields = dict(data)
    for name in ("policy", "specification", "plant"):
        fields[name] = Subject(**fields[name])
    fields["outcome"], fields["source"] = Outcome(fields["outcome"]), Source(fields["source"])
    fields["requirements"] = tuple(RequirementRow(**_tuples(entry, "curve")) for entry in fields["requirements"])
    kinds: dict[str, Any] = {"why": Why, "value": ValueRow, "evidence": Evidence}
    for name, kind in kinds.items():
        fields[name] = None if fields[name] is None else kind(**fields[name])
    radius, change = fields["radius"], fields["change"]
    if radius is not None:
        fields["radius"] = RadiusFound(**{**radius, "tried": tuple((a, b) for a, b in radius["tried"])})
    if change is not None:
        pairs = {
            key: None if change[key] is None else tuple(change[key]) for key in ("verdict", "value", "margin", "radius")
        }
        fields["change"] = Change(**pairs, regressions=tuple(change["regressions"]))
    return Row(**_tuples(fields, "objections", "expected", "semantics", "assumptions", "notes"))


def _tuples(data: Any, *names: str) -> dict[str, Any]:
    return {**data, **{name: tuple(data[name]) for name in names}}
