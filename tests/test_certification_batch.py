"""A batch in this process: what is lost costs its row only, old evidence is believed for what it proves."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from fractions import Fraction as F
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from certification_cases import PLANT, SPECIFICATION, Scripted, names, planned_of, table, workshop
from certification_cases import row as made_up

import setrl
from setrl.specs.errors import InputError
from setrl.specs.reader import digest, find_specification
from setrl.verify.certification import batch as module
from setrl.verify.certification import work
from setrl.verify.certification.batch import Batch, Watch
from setrl.verify.certification.certify import JOURNAL, certify
from setrl.verify.certification.document import Outcome, Row, Source, Why
from setrl.verify.certification.figures import Figures
from setrl.verify.certification.journal import Journal
from setrl.verify.certification.progress import Table
from setrl.verify.executors.task import Answer, Broken, Lost, Refused, Task, TaskOutcome
from setrl.verify.parts import Cut
from setrl.verify.result import Verdict

OWN = "policy: policies/set.onnx, specification: specs/own.yaml"
LOST = Lost("signal", "was killed by SIGKILL")
VIOLATED = SPECIFICATION.replace("z: [-1, 1]", "z: [-0.05, 0.05]")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("os.fsync", lambda file: None)
    return workshop(tmp_path)


def run(folder: Path, executor: Scripted, *entries: str, **how: Any) -> tuple[Row, ...] | None:
    """One run over a table, with the journal and the evidence in the folder `out`."""
    out = folder / "out"
    out.mkdir(exist_ok=True)
    with Journal.read(out / JOURNAL) as journal:
        return Batch(planned_of(folder, *entries, spread=how.pop("spread", 1)), out, journal, executor, **how).run()


def rows(folder: Path, executor: Scripted, *entries: str, **how: Any) -> tuple[Row, ...]:
    found = run(folder, executor, *entries, **how)
    assert found is not None
    return found


def journal(folder: Path) -> dict[str, Row]:
    return Journal.read(folder / "out" / JOURNAL).rows


def unknown(sentence: str = "not proved", **why: Any) -> Answer:
    return Answer(Figures({"outcome": Outcome.UNKNOWN, "why": Why("proof", sentence, **why)}), 0.25)


def by_radius(script: dict[str, TaskOutcome]) -> Callable[[Task], TaskOutcome | None]:
    """Outcomes by the row's radius; UNKNOWN where there is none."""
    return lambda task: script.get(task.name.rpartition(" @ ")[2], unknown())


# ---- one row's fate


def test_what_is_lost_refused_or_broken_harms_no_other_row(folder: Path) -> None:
    script: dict[str, TaskOutcome] = {
        "1": LOST,
        "2": Refused("policies/set.onnx: wrong"),
        "3": Broken("AssertionError: a bug"),
        "4": Lost("time", "did not end within 480 s and was killed"),
        "5": Lost("memory", "needed more than 4.0 GiB of memory"),
        "6": Lost("cluster", "was lost with its machine"),
        "7": Lost("exit", "ended with code 1"),
    }
    found = rows(folder, Scripted(by_radius(script)), OWN + ", epsilon: '0:8:1'")
    assert [(row.outcome.value, row.why.kind, row.why.source) for row in found if row.why] == [
        ("UNKNOWN", "proof", ""),
        ("UNKNOWN", "resource", "lost"),
        ("ERROR", "input", ""),
        ("INTERNAL", "internal", ""),
        ("UNKNOWN", "resource", "time limit"),
        ("UNKNOWN", "resource", "memory limit"),
        ("UNKNOWN", "resource", "lost"),
        ("UNKNOWN", "resource", "lost"),
        ("UNKNOWN", "proof", ""),
    ]
    assert all(row.evidence is None and row.claim == "" for row in found)
    assert [row.epsilon for row in found] == list("012345678")

    again = Scripted(lambda task: unknown("again"))
    second = rows(folder, again, OWN + ", epsilon: '0:8:1'")
    tried = [task.name.rpartition(" @ ")[2] for task in again.tasks]
    assert tried == ["1", "2", "3", "6", "7"]  # verdicts stay, and so does what used up what it was given
    assert [row.source for row in second] == [
        Source.DECIDED if row.epsilon in tried else Source.JOURNAL for row in second
    ]


def test_rows_keep_the_plan_s_order_whatever_ends_first(folder: Path) -> None:
    script = {str(radius): unknown(str(radius)) for radius in range(6)}
    found = rows(folder, Scripted(by_radius(script), backwards=True), OWN + ", epsilon: '0:5:1'")
    assert [row.why.sentence for row in found if row.why] == list("012345")


def test_a_file_that_cannot_be_used_starts_no_task_and_is_not_remembered(folder: Path) -> None:
    (folder / "specs" / "own.yaml").write_text("setrl: 1\n")
    executor = Scripted()
    (found,) = rows(folder, executor, OWN)
    assert (found.outcome, executor.tasks, journal(folder)) == (Outcome.ERROR, [], {})
    assert found.why is not None and "specs/own.yaml" in found.why.sentence


def test_limits_of_a_row_are_its_task_s(folder: Path) -> None:
    executor = Scripted(lambda task: unknown())
    rows(folder, executor, OWN + ", timeout: 10, memory: 1 GiB")
    assert [(task.seconds, task.memory) for task in executor.tasks] == [(45.0, 2**30)]


def test_an_executor_never_holds_more_than_it_soon_needs(folder: Path) -> None:
    executor = Scripted(lambda task: unknown(), workers=2)
    found = rows(folder, executor, OWN + ", epsilon: '0:199:1'")
    assert len(found) == len(executor.tasks) == 200
    assert executor.most == 2 + module.AHEAD


def test_the_same_question_under_two_names_is_decided_once_and_reported_twice(folder: Path) -> None:
    shutil.copy(folder / "policies" / "set.onnx", folder / "policies" / "copy.onnx")
    other = "policy: policies/copy.onnx, specification: specs/own.yaml, allow_unknown: true"
    for run_number, expected in enumerate((["decide"], [], ["look_again"])):
        executor = Scripted()
        found = rows(folder, executor, OWN, other, recheck=run_number == 2)
        assert executor.functions == expected
        assert names(found) == ["policies/set.onnx x specs/own.yaml", "policies/copy.onnx x specs/own.yaml"]
        assert [row.policy.name for row in found] == ["policies/set.onnx", "policies/copy.onnx"]
        assert [row.source for row in found] == [(Source.DECIDED, Source.JOURNAL, Source.RECHECKED)[run_number]] * 2
        assert found[0].evidence == found[1].evidence and found[0].outcome is Outcome.VERIFIED


def test_the_same_question_is_judged_by_each_entry_s_own_demands(folder: Path) -> None:
    shutil.copy(folder / "policies" / "set.onnx", folder / "policies" / "copy.onnx")
    other = "policy: policies/copy.onnx, specification: specs/own.yaml"
    manifest = table(
        folder, OWN + ", require: {margin: 100}", other, other.replace("copy", "point") + ", expect: UNKNOWN"
    )
    report = certify(manifest, folder / "out", Scripted(lambda task: unknown() if "point" in task.name else None))
    assert report is not None
    assert [row.passed for row in report.rows] == [False, True, True]
    assert report.exit_code == 5


# ---- what is believed of an earlier run


@dataclass
class Decided:
    """A batch that was decided for good: rows at two radii and a search, all with evidence."""

    folder: Path
    entries: tuple[str, ...]
    rows: tuple[Row, ...]
    executor: Scripted = field(default_factory=Scripted)

    def again(self, *entries: str, **how: Any) -> tuple[Row, ...]:
        self.executor = Scripted(how.pop("script", lambda task: None))
        return rows(self.folder, self.executor, *(entries or self.entries), **how)

    def enter(self, row: Row) -> None:
        """Write a row into the journal, as a program that is wrong would have."""
        with Journal.read(self.folder / "out" / JOURNAL) as journal:
            journal.append(row)

    def path(self, number: int) -> Path:
        evidence = self.rows[number].evidence
        assert evidence is not None
        return self.folder / "out" / evidence.path


ENTRIES = (
    OWN + ", epsilon: [0.02, 0.01]",
    OWN,
    "policy: policies/set.onnx, specification: specs/violated.yaml",
)


@pytest.fixture(scope="module")
def _decided(tmp_path_factory: pytest.TempPathFactory) -> Decided:
    folder = workshop(tmp_path_factory.mktemp("decided"))
    (folder / "specs" / "violated.yaml").write_text(VIOLATED)
    return Decided(folder, ENTRIES, rows(folder, Scripted(), *ENTRIES))


@pytest.fixture
def decided(_decided: Decided, folder: Path) -> Decided:
    shutil.copytree(_decided.folder, folder, dirs_exist_ok=True)
    return Decided(folder, _decided.entries, _decided.rows)


def test_a_decided_batch_has_its_evidence_on_the_disk(decided: Decided) -> None:
    assert [row.outcome.value for row in decided.rows] == ["VERIFIED", "VERIFIED", "VERIFIED", "FALSIFIED"]
    for number, row in enumerate(decided.rows):
        content = decided.path(number).read_bytes()
        assert row.evidence is not None
        assert (row.evidence.sha256, row.evidence.bytes) == (digest(content), len(content))
        assert row.evidence.kind == ("witness" if number == 3 else "certificate")
        assert row.source is Source.DECIDED and row.timings["total"] == 0.125
    assert len({decided.path(number) for number in range(4)}) == 4
    assert all(row.claim for row in decided.rows[:3]) and not decided.rows[3].claim


def test_rows_of_files_with_one_name_have_evidence_of_their_own(folder: Path) -> None:
    (folder / "policies" / "new").mkdir()
    shutil.copy(folder / "policies" / "point.onnx", folder / "policies" / "new" / "set.onnx")
    found = rows(folder, Scripted(), OWN, OWN.replace("policies/", "policies/new/"))
    assert [row.evidence is not None for row in found] == [True, True]
    for row in found:
        assert row.evidence is not None
        assert digest((folder / "out" / row.evidence.path).read_bytes()) == row.evidence.sha256


def test_unchanged_rows_are_taken_from_the_journal_as_they_were(decided: Decided) -> None:
    found = decided.again()
    assert decided.executor.tasks == []
    assert [replace(row, source=Source.DECIDED) for row in found] == list(decided.rows)


def test_nothing_is_taken_from_the_journal_where_that_is_not_wanted(decided: Decided) -> None:
    found = decided.again(cached=False)
    assert decided.executor.functions == ["decide"] * 4
    assert {row.source for row in found} == {Source.DECIDED}


def remove(path: Path) -> None:
    path.unlink()


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[-5] ^= 1
    path.write_bytes(content)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-8])


def grow(path: Path) -> None:
    path.write_bytes(path.read_bytes() + b"\n")


def turn_into_a_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


@pytest.mark.parametrize("recheck", [False, True])
@pytest.mark.parametrize("damage", [remove, flip, cut, grow])
def test_evidence_that_is_gone_or_not_the_same_is_proved_again(
    decided: Decided, damage: Callable[[Path], None], recheck: bool
) -> None:
    for number in (1, 3):
        damage(decided.path(number))
    found = decided.again(recheck=recheck)
    assert decided.executor.functions.count("decide") == 2
    assert [row.source is Source.DECIDED for row in found] == [False, True, False, True]
    assert [row.evidence for row in found] == [row.evidence for row in decided.rows]
    assert digest(decided.path(1).read_bytes()) == getattr(decided.rows[1].evidence, "sha256", "")


def test_evidence_in_whose_place_nothing_can_be_written_is_an_error(decided: Decided) -> None:
    turn_into_a_folder(decided.path(1))
    with pytest.raises(InputError):
        decided.again()


def test_evidence_that_is_looked_at_again_proves_everything_that_is_reported(decided: Decided) -> None:
    found = decided.again(recheck=True)
    assert decided.executor.functions == ["look_again"] * 4
    assert {row.source for row in found} == {Source.RECHECKED}
    assert [replace(row, source=Source.DECIDED) for row in found] == list(decided.rows)


def with_evidence(number: int) -> Callable[[Decided], Row]:
    """The first row with another row's evidence."""
    return lambda decided: replace(decided.rows[0], evidence=decided.rows[number].evidence)


def better(name: str) -> Callable[[Decided], Row]:
    """The first row with a figure that is better than what is proved."""

    def change(decided: Decided) -> Row:
        first = decided.rows[0]
        assert first.value is not None and first.value.discounted is not None
        if name == "margin":
            (entry,) = first.requirements
            return replace(first, requirements=(replace(entry, margin=(entry.margin or 0.0) + 1e-9),))
        if name == "a requirement more":
            return replace(first, requirements=(*first.requirements, replace(first.requirements[0], name="comfort")))
        if name == "value":
            return replace(first, value=replace(first.value, discounted=first.value.discounted + 1e-9))
        if name == "undiscounted value":
            return replace(first, value=replace(first.value, undiscounted=0.0))
        return replace(first, semantics=(*first.semantics, "float64"))

    return change


def falsified(decided: Decided) -> Row:
    """The first row with the verdict that another row's witness proves."""
    return replace(decided.rows[0], outcome=Outcome.FALSIFIED, evidence=decided.rows[3].evidence)


def verified(decided: Decided) -> Row:
    """A falsified row that is called VERIFIED."""
    return replace(decided.rows[3], outcome=Outcome.VERIFIED, why=None)


def shortened(decided: Decided) -> Row:
    """The first row with half of its certificate, of which the journal has the digest."""
    decided.path(0).write_bytes(decided.path(0).read_bytes()[:2000])
    first = decided.rows[0]
    assert first.evidence is not None
    return replace(first, evidence=replace(first.evidence, sha256=digest(decided.path(0).read_bytes())))


FORGED: dict[str, tuple[Callable[[Decided], Row], int, str]] = {
    "of a smaller radius": (with_evidence(1), 0, "another perturbation radius"),
    "of the specification's radius": (with_evidence(2), 0, "another perturbation radius"),
    "of another specification": (with_evidence(3), 0, "specification"),
    "of another verdict": (falsified, 0, "specification"),
    "half of it": (shortened, 0, "the evidence is damaged"),
    "of a violation": (verified, 3, "a witness does not prove VERIFIED"),
    "of a smaller margin": (better("margin"), 0, "smaller margins"),
    "of fewer requirements": (better("a requirement more"), 0, "smaller margins"),
    "of a smaller value": (better("value"), 0, "smaller V(s0)"),
    "of a smaller undiscounted value": (better("undiscounted value"), 0, "smaller V(s0)"),
    "of fewer arithmetics": (better("semantics"), 0, "covers less"),
}


@pytest.mark.parametrize("name", FORGED)
def test_evidence_that_proves_less_than_the_journal_says_is_not_accepted_and_the_row_is_proved_again(
    decided: Decided, name: str
) -> None:
    forge, number, words = FORGED[name]
    decided.enter(forge(decided))
    found = decided.again(recheck=True)
    assert decided.executor.functions == ["look_again"] * 4 + ["decide"]
    true = decided.rows[number]
    assert found[number].notes[-1].startswith("the evidence of an earlier run was not accepted again: ")
    assert words in found[number].notes[-1]
    assert replace(found[number], notes=true.notes, timings=true.timings) == true
    assert [row.source for place, row in enumerate(found) if place != number] == [Source.RECHECKED] * 3
    assert journal(decided.folder)[true.key] == found[number]


def test_a_certificate_of_a_smaller_radius_is_none_of_the_specification_s(decided: Decided) -> None:
    """Where the row is about the specification's own radius, and the certificate names another one."""
    text = SPECIFICATION.replace("observation: 0.01", "observation: 0.03")
    (decided.folder / "specs" / "own.yaml").write_text(text)
    wide, narrow = decided.again(OWN, OWN + ", epsilon: 0.01")
    decided.enter(replace(wide, evidence=narrow.evidence))
    found = decided.again(OWN, OWN + ", epsilon: 0.01", recheck=True)
    assert decided.executor.functions == ["look_again", "look_again", "decide"]
    assert "another perturbation radius" in found[0].notes[-1]


def test_a_witness_of_a_larger_radius_is_none_of_a_smaller_one(decided: Decided) -> None:
    entry = ENTRIES[2] + ", epsilon: [0.5, 0.25]"
    large, small = decided.again(entry)
    assert (large.outcome, small.outcome) == (Outcome.FALSIFIED, Outcome.FALSIFIED)
    decided.enter(replace(small, evidence=large.evidence))
    found = decided.again(entry, recheck=True)
    assert decided.executor.functions == ["look_again", "look_again", "decide"]
    assert "another perturbation radius" in found[1].notes[-1]


def test_a_search_s_evidence_is_looked_at_at_the_radius_that_it_found(decided: Decided) -> None:
    entry = OWN + ", radius: {most: 0.04, resolution: 0.02}"
    (first,) = decided.again(entry)
    assert first.radius is not None and first.radius.verified == "0.04"
    (found,) = decided.again(entry, recheck=True)
    assert (decided.executor.functions, found.source) == (["look_again"], Source.RECHECKED)
    decided.enter(replace(first, radius=replace(first.radius, verified="0.05")))
    (found,) = decided.again(entry, recheck=True)
    assert decided.executor.functions == ["look_again", "decide"]
    assert found.radius == first.radius and "another perturbation radius" in found.notes[-1]


def test_a_search_that_found_only_violations_is_looked_at_again(decided: Decided) -> None:
    entry = ENTRIES[2] + ", radius: {most: 0.04, resolution: 0.02}"
    (first,) = decided.again(entry)
    assert first.outcome is Outcome.FALSIFIED and first.radius is not None and first.radius.falsified == "0"
    (found,) = decided.again(entry, recheck=True)
    assert (decided.executor.functions, found.source) == (["look_again"], Source.RECHECKED)


@pytest.mark.parametrize("lost", [LOST, Lost("time", "was killed"), Refused("wrong")], ids=["lost", "time", "refused"])
def test_a_look_again_that_has_no_answer_is_no_acceptance(decided: Decided, lost: TaskOutcome) -> None:
    found = decided.again(recheck=True, script=lambda task: lost if task.function.endswith("look_again") else None)
    assert decided.executor.functions == ["look_again"] * 4 + ["decide"] * 4
    assert {row.source for row in found} == {Source.DECIDED}
    assert [row.outcome for row in found] == [row.outcome for row in decided.rows]


def test_a_look_again_that_breaks_is_an_internal_error(decided: Decided) -> None:
    found = decided.again(
        recheck=True, script=lambda task: Broken("a bug") if task.function.endswith("look_again") else None
    )
    assert {row.outcome for row in found} == {Outcome.INTERNAL}
    assert {row.outcome for row in decided.again()} == {Outcome.VERIFIED, Outcome.FALSIFIED}


def test_a_verdict_without_evidence_is_not_believed(decided: Decided) -> None:
    for row in decided.rows:
        decided.enter(replace(row, evidence=None))
    decided.again()
    assert decided.executor.functions == ["decide"] * 4


def test_rows_of_other_files_are_not_found_in_the_journal(decided: Decided) -> None:
    (decided.folder / "plants" / "mine.yaml").write_text(PLANT + "# another byte\n")
    decided.again()
    assert decided.executor.functions == ["decide"] * 4


def test_files_that_change_after_they_were_planned_are_not_what_is_proved(folder: Path) -> None:
    """A plant's absolute path is read by the worker: what it proves of another plant is not entered."""
    (folder / "specs" / "own.yaml").write_text(SPECIFICATION.replace("../plants", f"{folder}/plants"))
    planned = planned_of(folder, OWN)
    (folder / "plants" / "mine.yaml").write_text(PLANT.replace("v: a", "v: 0*a"))
    (folder / "out").mkdir()
    with Journal.read(folder / "out" / JOURNAL) as opened:
        found = Batch(planned, folder / "out", opened, Scripted()).run()
    assert found is not None
    assert (found[0].outcome, found[0].evidence, found[0].claim) == (Outcome.ERROR, None, "")
    assert list((folder / "out").glob("certificates/*")) == []
    (folder / "plants" / "mine.yaml").write_text(PLANT)
    (found_now,) = rows(folder, Scripted(), OWN)
    assert found_now.outcome is Outcome.VERIFIED


# ---- a hard row


def hard(folder: Path, script: Callable[[Task], TaskOutcome | None]) -> tuple[Row, Scripted]:
    """A row that is cut into three parts; what is done with them is scripted."""
    executor = Scripted(script)
    (found,) = rows(folder, executor, OWN + ", options: {splits: 300}", spread=3)
    return found, executor


def parts(answers: dict[int, TaskOutcome]) -> Callable[[Task], TaskOutcome | None]:
    """A row that is hard at once; parts answer by their number, the join what it is given."""
    cut = Cut(((0, "0"), (0, "-1/2"), None, None, None), tuple(((F(place), F(place + 1)),) for place in range(3)))

    def script(task: Task) -> TaskOutcome | None:
        function = task.function.rpartition(":")[2]
        if function == "decide":
            return Answer(work.Hard("whole", cut), 1.0)  # type: ignore[arg-type]
        if function == "decide_part":
            _, part, splits = task.argument
            assert splits == 100
            return answers.get(int(part[0][0]), Answer(f"part {part[0][0]}", 1.0))
        _, given, results = task.argument
        assert (given.whole, given.cut) == ("whole", cut)
        return unknown(" ".join(results))

    return script


def test_a_hard_row_s_parts_are_joined_in_their_order(folder: Path) -> None:
    found, executor = hard(folder, parts({}))
    assert executor.functions == ["decide", "decide_part", "decide_part", "decide_part", "join"]
    assert found.why is not None and found.why.sentence == "part 0 part 1 part 2"
    assert found.timings["total"] == 4.25  # of every process
    executor = Scripted(parts({}), backwards=True)
    (other,) = rows(folder, executor, OWN + ", options: {splits: 300}", spread=3, cached=False)
    assert other.why == found.why


@pytest.mark.parametrize(
    ("lost", "outcome"),
    [(LOST, Outcome.UNKNOWN), (Refused("wrong"), Outcome.ERROR), (Broken("a bug"), Outcome.INTERNAL)],
)
@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_part_without_an_answer_leaves_the_row_without_one(
    folder: Path, place: int, lost: TaskOutcome, outcome: Outcome
) -> None:
    found, executor = hard(folder, parts({place: lost}))
    assert executor.functions == ["decide", "decide_part", "decide_part", "decide_part"]
    assert found.outcome is outcome and found.evidence is None
    assert [row.outcome for row in journal(folder).values()] == [outcome]


def test_several_parts_without_an_answer_are_one_row(folder: Path) -> None:
    found, _ = hard(folder, parts({0: LOST, 1: Broken("a bug"), 2: LOST}))
    assert found.outcome is Outcome.UNKNOWN
    assert (folder / "out" / JOURNAL).read_bytes().count(b"\n") == 2


@pytest.mark.slow
def test_a_hard_row_is_really_cut_decided_and_joined(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(work, "FIRST_CELLS", 4)
    text = (
        find_specification("quadrotor1d").read_text(encoding="utf-8").replace("observation: 0.1", "observation: 0.02")
    )
    wide = text.replace("initial: {z: -4, zdot: 0}", "initial: {z: [-4.5, -3.5], zdot: [-0.5, 0.5]}")
    (folder / "specs" / "wide.yaml").write_text(wide)
    entry = "policy: policies/point.onnx, specification: specs/wide.yaml"
    executor = Scripted()
    (found,) = rows(folder, executor, entry, spread=2)
    assert executor.functions == ["decide", "decide_part", "decide_part", "join"]
    assert (found.outcome, found.leaves > 4) == (Outcome.VERIFIED, True)
    assert "decided in 2 parts" in found.notes
    (again,) = rows(folder, Scripted(), entry, spread=2, recheck=True)
    assert again.source is Source.RECHECKED


def test_a_row_is_falsified_where_one_part_is(folder: Path) -> None:
    (folder / "specs" / "own.yaml").write_text(VIOLATED)
    planned = planned_of(folder, OWN, spread=2)
    question = planned[0].question
    assert question is not None
    with question.files() as (policy, specification):
        whole = setrl.verify(policy, specification, workers=1)
    assert whole.verdict is Verdict.FALSIFIED
    (low, high), rest = whole.loop.initial[0], whole.loop.initial[1:]
    halves = tuple((bounds, *rest) for bounds in ((low, F(0)), (F(0), high)))
    hard_row = work.Hard(replace(whole, verdict=Verdict.UNKNOWN), Cut(((0, "0"), None, None), halves))

    def script(task: Task) -> TaskOutcome | None:
        return Answer(hard_row, 0.5) if task.function.endswith(":decide") else None

    (found,) = rows(folder, Scripted(script), OWN, spread=2)
    assert found.outcome is Outcome.FALSIFIED and found.evidence is not None and found.evidence.kind == "witness"
    (again,) = rows(folder, Scripted(), OWN, spread=2, recheck=True)
    assert again.source is Source.RECHECKED


# ---- stopping, and what is told meanwhile


def test_a_stopped_batch_has_no_report_and_the_next_run_goes_on(folder: Path) -> None:
    entry = OWN + ", epsilon: '0:9:1'"
    for done in (3, 7):
        executor = Scripted(lambda task: unknown())
        assert run(folder, executor, entry, stop=lambda at=done: len(journal(folder)) >= at) is None
        assert len(journal(folder)) == done
    executor = Scripted(lambda task: unknown())
    found = rows(folder, executor, entry)
    assert [task.name.rpartition(" @ ")[2] for task in executor.tasks] == ["7", "8", "9"]
    assert [row.source is Source.JOURNAL for row in found] == [True] * 7 + [False] * 3


def test_a_report_is_written_by_nobody_who_was_stopped(folder: Path) -> None:
    executor = Scripted()
    assert certify(table(folder, OWN), folder / "out", executor, stop=lambda: True) is None
    assert executor.left and executor.tasks == []
    assert sorted(path.name for path in (folder / "out").iterdir()) == [".lock", JOURNAL]


def test_a_live_table_keeps_up_with_thousands_of_rows_that_come_at_once() -> None:
    drawings: list[Any] = []
    watch = Table(SimpleNamespace(update=drawings.append), total=3000)
    for number in range(3000):
        watch.finished(made_up(Outcome.VERIFIED if number % 3 else Outcome.UNKNOWN, name=str(number)))
    assert watch.counts == {Outcome.VERIFIED: 2000, Outcome.UNKNOWN: 1000}
    assert 1 <= len(drawings) < 300


@dataclass
class Seen(Watch):
    begun: list[tuple[int, int]] = field(default_factory=list)
    rows: list[str] = field(default_factory=list)
    ran: list[str] = field(default_factory=list)

    def begin(self, planned: Any, workers: int) -> None:
        self.begun.append((len(planned), workers))

    def finished(self, row: Row) -> None:
        self.rows.append(row.name)

    def running(self, names: Any) -> None:
        self.ran += [name for name, _ in names]


def test_a_watch_sees_every_row_once(folder: Path) -> None:
    shutil.copy(folder / "policies" / "set.onnx", folder / "policies" / "copy.onnx")
    entries = (OWN + ", epsilon: [0, 1]", OWN.replace("set", "copy") + ", epsilon: [0, 1]")
    for _ in range(2):
        seen = Seen()
        found = rows(folder, Scripted(by_radius({"0": unknown(), "1": LOST})), *entries, watch=seen)
        assert sorted(seen.rows) == sorted(names(found)) and len(set(seen.rows)) == 4
        assert seen.begun == [(4, 1)] and set(seen.ran) <= set(names(found))


# ---- the whole way


def test_a_batch_is_as_bad_as_its_worst_row_in_the_order_that_is_promised(folder: Path) -> None:
    script: dict[str, TaskOutcome] = {
        "1": unknown(),
        "2": Answer(Figures({"outcome": Outcome.VERIFIED}), 0.5),
        "3": Refused("wrong"),
        "4": Broken("a bug"),
    }
    worst = []
    for radii in ("2", "[1, 2]", "[1, 2, 3]", "[1, 2, 3, 4]"):
        executor = Scripted(by_radius(script))
        report = certify(table(folder, f"{OWN}, epsilon: {radii}"), folder / "out", executor, cached=False)
        assert report is not None and executor.left
        worst.append(report.exit_code)
    assert worst == [0, 5, 2, 6]


def test_a_baseline_that_is_none_is_found_before_anything_is_decided(folder: Path) -> None:
    executor = Scripted()
    with pytest.raises(InputError):
        certify(table(folder, OWN), folder / "out", executor, baseline=folder / "specs" / "own.yaml")
    assert executor.tasks == [] and not (folder / "out").exists()


def test_two_runs_never_write_one_folder(folder: Path) -> None:
    problems: list[str] = []

    def script(task: Task) -> TaskOutcome | None:
        with pytest.raises(InputError, match="another process") as caught:
            certify(table(folder, OWN), folder / "out", Scripted())
        problems.append(str(caught.value))
        return unknown()

    assert certify(table(folder, OWN), folder / "out", Scripted(script)) is not None
    assert len(problems) == 1
