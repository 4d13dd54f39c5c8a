"""From a manifest to rows: which files, which names, and a key that changes with everything a verdict depends on."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from certification_cases import PLANT, SPECIFICATION, names, planned_of, workshop

from setrl.models.example import POLICIES
from setrl.specs.errors import SpecificationError
from setrl.specs.manifest import read_manifest
from setrl.specs.reader import SHIPPED, digest
from setrl.verify.certification import plan as module
from setrl.verify.certification.plan import MOST_ROWS, plan

ENTRY = "policy: policies/set.onnx, specification: specs/own.yaml"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return workshop(tmp_path)


def key(folder: Path, entry: str = ENTRY, spread: int = 1) -> str:
    (found,) = planned_of(folder, entry, spread=spread)
    assert found.problem == ""
    return found.key


# ---- which rows


def test_rows_are_policies_times_specifications_times_radii_in_the_manifest_s_order(folder: Path) -> None:
    rows = planned_of(
        folder,
        "policy: policies/*.onnx, specification: [quadrotor1d, specs/own.yaml], epsilon: [0.10, 0], radius: {}",
        ENTRY,
    )
    assert names(rows) == [
        f"policies/{policy}.onnx x {specification}{case}"
        for policy in ("point", "set")
        for specification in ("quadrotor1d.yaml", "specs/own.yaml")
        for case in (" @ 0.1", " @ 0", " (certified radius)")
    ] + ["policies/set.onnx x specs/own.yaml"]
    assert len({row.key for row in rows}) == len(rows)


def test_a_row_names_the_very_bytes(folder: Path) -> None:
    (found,) = planned_of(folder, ENTRY)
    assert found.policy.sha256 == digest((POLICIES / "quadrotor1d-set.onnx").read_bytes())
    assert (found.specification.name, found.specification.sha256) == ("specs/own.yaml", digest(SPECIFICATION))
    assert (found.plant.name, found.plant.sha256) == ("../plants/mine.yaml", digest(PLANT))
    (shipped,) = planned_of(folder, "policy: policies/set.onnx, specification: quadrotor1d")
    assert shipped.plant.sha256 and shipped.plant.name == "quadrotor1d"


def test_paths_start_at_the_manifest_wherever_the_command_is_given(
    folder: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "fleet.yaml").write_text(f"setrl: 1\ncertify: [{{{ENTRY}}}]\n")
    here = plan(read_manifest(folder / "fleet.yaml"))
    monkeypatch.chdir(folder)
    assert plan(read_manifest("fleet.yaml")) == here
    monkeypatch.chdir(folder / "specs")
    assert plan(read_manifest("../fleet.yaml")) == here


def test_absolute_paths_and_recursive_globs_are_found(folder: Path) -> None:
    rows = planned_of(folder, f"policy: {folder}/policies/set.onnx, specification: '**/own.yaml'")
    assert names(rows) == [f"{folder}/policies/set.onnx x specs/own.yaml"]


def test_a_file_whose_name_has_a_glob_s_sign_is_itself(folder: Path) -> None:
    shutil.copy(folder / "policies" / "set.onnx", folder / "policies" / "[set].onnx")
    rows = planned_of(folder, "policy: 'policies/[set].onnx', specification: specs/own.yaml")
    assert names(rows) == ["policies/[set].onnx x specs/own.yaml"]


def test_two_globs_of_an_entry_that_match_one_file_make_one_row(folder: Path) -> None:
    some = "[policies/set.onnx, policies/*.onnx, ./policies/set.onnx, policies/../policies/set.onnx]"
    rows = planned_of(folder, f"policy: {some}, specification: specs/own.yaml")
    assert len(rows) == 2


def test_a_file_beside_the_manifest_comes_before_the_shipped_one_of_its_name(folder: Path) -> None:
    (folder / "quadrotor1d.yaml").write_text(SPECIFICATION.replace("../plants", "plants"))
    for given in ("quadrotor1d", "quadrotor1d.yaml"):
        (found,) = planned_of(folder, f"policy: policies/set.onnx, specification: {given}")
        assert found.specification.sha256 == digest((folder / "quadrotor1d.yaml").read_bytes())
    os.unlink(folder / "quadrotor1d.yaml")
    (found,) = planned_of(folder, "policy: policies/set.onnx, specification: quadrotor1d")
    assert found.specification.sha256 == digest((SHIPPED / "quadrotor1d.yaml").read_bytes())


def test_a_link_is_the_file_that_it_points_to(folder: Path) -> None:
    (folder / "policies" / "latest.onnx").symlink_to("set.onnx")
    rows = planned_of(folder, "policy: [policies/latest.onnx, policies/set.onnx], specification: specs/own.yaml")
    assert len(rows) == 2 and rows[0].key == rows[1].key


WRONG = {
    "no match": ("policy: policies/*.pt, specification: quadrotor1d", "no policy matches 'policies/*.pt'"),
    "not there": ("policy: gone.onnx, specification: quadrotor1d", "the policy 'gone.onnx' does not exist"),
    "a folder": ("policy: policies, specification: quadrotor1d", "the policy 'policies' is a folder"),
    "a glob of folders": ("policy: 'polic*', specification: quadrotor1d", "no policy matches"),
    "a dangling link": ("policy: dangling.onnx, specification: quadrotor1d", "does not exist"),
    "no specification": ("policy: policies/set.onnx, specification: quadrotor", "'quadrotor' does not exist"),
    "a shipped name's path": ("policy: policies/set.onnx, specification: specs/quadrotor1d", "does not exist"),
    "a line break": ('policy: "a\\nb.onnx", specification: quadrotor1d', "'a\\nb.onnx' does not exist"),
    "a long name": (f"policy: {'a' * 5000}, specification: quadrotor1d", "cannot be looked for"),
    "a long glob": (f"policy: '*{'a' * 5000}', specification: quadrotor1d", "cannot be looked for"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_matches_no_file_is_one_line_with_the_manifest_s(name: str, folder: Path) -> None:
    (folder / "dangling.onnx").symlink_to("nowhere.onnx")
    entry, words = WRONG[name]
    with pytest.raises(SpecificationError) as caught:
        planned_of(folder, ENTRY, entry)
    assert caught.value.where == f"{folder}/fleet.yaml:4"
    assert caught.value.remedy
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_a_row_that_appears_twice_is_an_error_of_the_second_entry(folder: Path) -> None:
    shutil.copy(folder / "policies" / "set.onnx", folder / "policies" / "a\nb.onnx")
    for again in (ENTRY, "policy: './policies//set.onnx', specification: specs/own.yaml", ENTRY + ", expect: UNKNOWN"):
        with pytest.raises(SpecificationError, match="appears twice") as caught:
            planned_of(folder, ENTRY, again)
        assert caught.value.where == f"{folder}/fleet.yaml:4"
    with pytest.raises(SpecificationError, match="appears twice") as caught:
        planned_of(folder, *["policy: 'policies/a*.onnx', specification: specs/own.yaml"] * 2)
    assert "\n" not in str(caught.value)


def test_a_file_that_cannot_be_used_costs_its_own_rows_only(folder: Path) -> None:
    (folder / "specs" / "wrong.yaml").write_text("setrl: 1\nplant: quadrotor1d\n")
    (folder / "specs" / "plantless.yaml").write_text(SPECIFICATION.replace("mine", "gone"))
    rows = planned_of(
        folder,
        "policy: [policies/set.onnx, /proc/self/mem], specification: [specs/*.yaml, /proc/self/mem]",
    )
    problems = {row.name: row.problem for row in rows if row.question is None}
    assert names([row for row in rows if row.question is not None]) == ["policies/set.onnx x specs/own.yaml"]
    assert len(rows) == 8 and len(problems) == 7 and all(problems.values())
    assert "is missing" in problems["policies/set.onnx x specs/wrong.yaml"]
    assert "no plant file" in problems["policies/set.onnx x specs/plantless.yaml"]
    assert "cannot read the policy" in problems["/proc/self/mem x specs/own.yaml"]
    assert not any(row.allow_unknown for row in rows)


def test_ten_thousand_rows_are_planned_at_once_and_one_more_is_an_error(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MOST_ROWS", 100)
    entry = ENTRY + ", epsilon: '0:0.99:0.01'"
    assert len(planned_of(folder, entry)) == 100 and MOST_ROWS == 10_000
    with pytest.raises(SpecificationError, match="more than 100 rows"):
        planned_of(folder, entry, "policy: policies/point.onnx, specification: quadrotor1d")


# ---- what a row demands


@pytest.mark.parametrize("own", [True, False])
@pytest.mark.parametrize(
    ("said", "allowed"), [("", None), ("allow_unknown: true", True), ("allow_unknown: false", False)]
)
def test_the_manifest_s_word_on_unknown_comes_before_the_specification_s(
    folder: Path, own: bool, said: str, allowed: bool | None
) -> None:
    (folder / "specs" / "own.yaml").write_text(f"{SPECIFICATION}allow_unknown: {str(own).lower()}\n")
    (found,) = planned_of(folder, f"{ENTRY}{', ' if said else ''}{said}")
    assert found.allow_unknown is (own if allowed is None else allowed)


def test_every_row_keeps_the_demands_of_its_own_entry(folder: Path) -> None:
    rows = planned_of(
        folder,
        "policy: policies/set.onnx, specification: specs/own.yaml, expect: FALSIFIED",
        "policy: policies/point.onnx, specification: specs/own.yaml, require: {value: -1}, timeout: 7",
    )
    assert [(row.entry.expected, row.entry.value, row.entry.line) for row in rows] == [
        (("FALSIFIED",), None, 3),
        ((), -1, 4),
    ]
    assert [row.question.timeout for row in rows if row.question] == [300.0, 7.0]


def test_only_what_does_not_search_is_cut_into_parts(folder: Path) -> None:
    rows = planned_of(folder, ENTRY + ", radius: {}, epsilon: 0", spread=4)
    assert [row.question.spread for row in rows if row.question] == [4, 1]
    (said,) = planned_of(folder, ENTRY + ", spread: 2", spread=4)
    assert said.question is not None and said.question.spread == 2


def test_a_question_carries_its_files_so_that_nothing_else_can_be_proved(folder: Path, tmp_path: Path) -> None:
    (found,) = planned_of(folder, ENTRY)
    for path in ("policies/set.onnx", "specs/own.yaml", "plants/mine.yaml"):
        (folder / path).write_bytes(b"something else")
    assert found.question is not None
    with found.question.files() as (policy, specification):
        assert digest(Path(policy).read_bytes()) == found.policy.sha256
        assert digest(Path(specification).read_bytes()) == found.specification.sha256
        plant = Path(specification).parent / "../plants/mine.yaml"
        assert digest(plant.read_bytes()) == found.plant.sha256


# ---- what changes the key


def edited(path: str, content: bytes | None = None) -> Callable[[Path], None]:
    """Append a byte that changes no meaning; every byte counts all the same."""

    def edit(folder: Path) -> None:
        (folder / path).write_bytes((folder / path).read_bytes() + b"\n" if content is None else content)

    return edit


FILES = {
    "policy": edited("policies/set.onnx"),
    "specification": edited("specs/own.yaml"),
    "plant": edited("plants/mine.yaml"),
    "another plant of the same name": edited("plants/mine.yaml", PLANT.replace("v: a", "v: 2*a").encode()),
}


@pytest.mark.parametrize("name", FILES)
def test_a_byte_of_a_file_changes_the_key(name: str, folder: Path) -> None:
    before = key(folder)
    FILES[name](folder)
    assert key(folder) != before


SETTINGS = (
    *("epsilon: 0.1", "epsilon: 0.01", "epsilon: 0", "timeout: 299.9", "timeout: 299.8", "memory: 3 GiB", "spread: 2"),
    *("radius: {}", "radius: {most: 9}", "radius: {resolution: 0.01}"),
    *(f"options: {{{option}}}" for option in ("splits: 1", "splits: 2", "taylor_order: 4", "generators: 13")),
    "options: {method: linearization}",
    "options: {method: linearization, splits: 2}",
)


def test_whatever_an_entry_says_about_the_proof_changes_the_key(folder: Path) -> None:
    keys = [key(folder), *(key(folder, f"{ENTRY}, {said}") for said in SETTINGS)]
    assert len(set(keys)) == len(keys)


def test_the_command_s_number_of_parts_is_the_entry_s(folder: Path) -> None:
    assert key(folder, spread=2) == key(folder, ENTRY + ", spread: 2") != key(folder)


@pytest.mark.parametrize("name", ["setrl", "python", "numpy", "onnxruntime", "architecture", "source", "runtime"])
def test_a_version_changes_the_key(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before, versions = key(folder), module.current_versions()
    assert versions[name]
    monkeypatch.setattr(module, "current_versions", lambda: {**versions, name: "another"})
    assert key(folder) != before


@pytest.mark.parametrize(
    "said",
    [
        "expect: FALSIFIED",
        "require: {value: -1, margin: 3}",
        "allow_unknown: true",
        "timeout: 300.0",
        "memory: 4096 MiB",
    ],
)
def test_what_the_gate_demands_and_how_a_number_is_written_changes_no_key(said: str, folder: Path) -> None:
    assert key(folder, f"{ENTRY}, {said}") == key(folder)


def test_radii_and_floors_have_one_key_however_they_are_written(folder: Path) -> None:
    assert key(folder, ENTRY + ", epsilon: 0.10") == key(folder, ENTRY + ", epsilon: 1e-1")
    assert key(folder, ENTRY + ", radius: {}") == key(folder, ENTRY + ", radius: {floor: 0.3, most: 10.0}")


def moved(folder: Path) -> str:
    """The same bytes, everything under another name and in another place."""
    (folder / "elsewhere").mkdir()
    (folder / "policies" / "set.onnx").rename(folder / "elsewhere" / "renamed.onnx")
    (folder / "specs").rename(folder / "contracts")
    (folder / "contracts" / "own.yaml").rename(folder / "contracts" / "theirs.yaml")
    return "policy: elsewhere/renamed.onnx, specification: contracts/theirs.yaml"


def test_files_that_are_moved_or_renamed_keep_their_key(folder: Path) -> None:
    before = key(folder)
    assert key(folder, moved(folder)) == before


def test_the_order_of_rows_and_the_rest_of_the_table_change_no_key(folder: Path) -> None:
    other = "policy: policies/point.onnx, specification: specs/own.yaml"
    forth, back = planned_of(folder, ENTRY, other), planned_of(folder, other, ENTRY)
    assert {row.name: row.key for row in forth} == {row.name: row.key for row in back}
    assert names(forth) == names(back)[::-1]


def test_an_edited_checkout_is_another_version() -> None:
    """The key holds a digest over the source, so that a fixed bug is not hidden by an old verdict."""
    versions = module.current_versions()
    assert set(versions) >= {"setrl", "python", "numpy", "onnx", "onnxruntime", "python-flint", "source", "runtime"}
    assert len(versions["source"]) == 64
