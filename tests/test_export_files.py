"""The folder of an export and `setrl export`: whole or not there, readable for others, nothing without a proof."""

from __future__ import annotations

import csv
import hashlib
import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import onnx
import pytest
import vnnlib
from command_line import EXAMPLE, QUICK, contents, run
from export_cases import run as execute

from setrl.specs.errors import InputError
from setrl.specs.queries import Case, LinearConstraint, Query
from setrl.specs.specification import Bounds
from setrl.verify.export import folder as export_folder
from setrl.verify.export.folder import Asked, Part, write_export

ONE = Fraction(1)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "quick.yaml").write_text(QUICK)
    return tmp_path


def export(capsys: Any, *arguments: Any, spec: str = "quick.yaml", out: str = "queries") -> Any:
    return run(capsys, "export", EXAMPLE, "--spec", spec, "--out", out, "--quiet", *arguments)


def claims(out: str = "queries") -> Any:
    return json.loads(Path(out, "claims.json").read_text())


def test_an_export_has_two_queries_per_action_and_period(place: Path, capsys: Any) -> None:
    outcome = export(capsys)
    assert (outcome.code, outcome.out) == (0, "10 queries about 5 networks: queries\n")
    data, rows = claims(), list(csv.reader(Path("queries", "instances.csv").read_text().splitlines()))
    assert rows == [[entry["onnx"], entry["vnnlib"], "60"] for entry in data["queries"]]
    assert [entry["query"] for entry in data["queries"]] == [
        f"leaf0-period{k:02d}-output0-{side}" for k in range(5) for side in ("lower", "upper")
    ]
    listed = {entry[key] for entry in data["queries"] for key in ("onnx", "vnnlib", "vnnlib2")}
    assert listed | {"claims.json", "instances.csv", "README.md"} == set(contents(place / "queries"))


@pytest.mark.parametrize("options", [(), ("--relative",), ("--closed-loop",), ("--closed-loop", "--map-order", "3")])
def test_what_is_written_is_read_by_others(options: tuple[str, ...], place: Path, capsys: Any) -> None:
    assert export(capsys, *options, "--periods", "2").code == 0
    for network in claims()["networks"]:
        content = (place / "queries" / network["onnx"]).read_bytes()
        assert hashlib.sha256(content).hexdigest() == network["sha256"]
        onnx.checker.check_model(onnx.load_from_string(content), full_check=True)
        assert len(execute(content, [0.0] * len(network["inputs"]))) == 1
    for entry in claims()["queries"]:
        query = vnnlib.parse_query_file(str(place / "queries" / entry["vnnlib2"]))
        (network,) = query.networks
        (described,) = [n for n in claims()["networks"] if n["onnx"] == entry["onnx"]]
        assert network.name == "N" and query.assertions
        assert network.inputs[0].shape == [1, len(described["inputs"])]
        for kind in ("vnnlib", "vnnlib2"):
            text = (place / "queries" / entry[kind]).read_bytes()
            assert hashlib.sha256(text).hexdigest() == entry[f"{kind}_sha256"]
            assert b"; leaf 0, " in text and (b"(vnnlib-version <2.0>)" in text) == (kind == "vnnlib2")


def test_digests_say_what_the_export_is_about(place: Path, capsys: Any) -> None:
    assert run(capsys, "verify", EXAMPLE, "--spec", "quick.yaml", "--certificate", "a.cert", "-q").code == 0
    assert export(capsys, "--certificate", "a.cert").code == 0
    data, page = claims(), Path("queries", "README.md").read_text()
    for key, path in (("certificate", "a.cert"), ("policy", EXAMPLE), ("specification", "quick.yaml")):
        assert data[key] == hashlib.sha256(Path(path).read_bytes()).hexdigest() and data[key] in page
    first = contents(place / "queries")
    assert export(capsys).code == 0, "verifies anew"
    assert contents(place / "queries") == {
        **first,
        "claims.json": first["claims.json"],
        "README.md": first["README.md"],
    }


def test_closed_loop_queries_ask_for_the_requirements(place: Path, capsys: Any) -> None:
    assert export(capsys, "--closed-loop", "--periods", "3").code == 0
    data = claims()
    assert [entry["query"] for entry in data["queries"]] == [f"leaf0-during{k:02d}-requirement0" for k in range(3)]
    assert {entry["requirement"] for entry in data["queries"]} == {"altitude"}
    kinds = [entry["kind"] for entry in data["networks"][2]["inputs"]]
    assert kinds.count("initial") == 2 and kinds.count("perturbation") == 6 and kinds.count("share") == 1
    assert "polynomial of order 2" in Path("queries", "README.md").read_text()


def test_a_loop_that_ends_before_every_requirement_is_not_exported(place: Path, capsys: Any) -> None:
    (place / "late.yaml").write_text(QUICK.replace("name: altitude", "at: 0.5"))
    outcome = export(capsys, "--closed-loop", "--periods", "4", spec="late.yaml")
    assert outcome.code == 2 and "no requirement is decided within 4 periods" in outcome.err
    assert [path.name for path in place.iterdir()].count("queries") == 0
    assert export(capsys, "--closed-loop", spec="late.yaml").code == 0
    assert [entry["query"] for entry in claims()["queries"]] == ["leaf0-at05-requirement0"]


@pytest.mark.parametrize(("given", "expected"), [("2:4", [2, 3]), ("1", [0]), ("4:99", [4])])
def test_a_part_is_exported(given: str, expected: list[int], place: Path, capsys: Any) -> None:
    assert export(capsys, "--periods", given).code == 0
    assert [entry["period"] for entry in claims()["networks"]] == expected


@pytest.mark.slow
def test_leaves_are_exported_one_by_one(place: Path, capsys: Any) -> None:
    (place / "tight.yaml").write_text(QUICK.replace("[-1, 1]", "[-0.126, 0.126]"))
    everything = export(capsys, spec="tight.yaml")
    assert everything.code == 0
    data = claims()
    assert data["leaves"] > 1 and {entry["leaf"] for entry in data["networks"]} == set(range(data["leaves"]))
    assert export(capsys, "--leaves", "1", spec="tight.yaml").code == 0
    assert {entry["leaf"] for entry in claims()["networks"]} == {0} and claims()["leaves"] == data["leaves"]


def test_json_says_what_was_written(place: Path, capsys: Any) -> None:
    outcome = export(capsys, "--json", "--periods", "1")
    data = json.loads(outcome.out)
    assert (data["out"], data["networks"], data["queries"]) == ("queries", 1, 2)
    assert data["certificate"] == claims()["certificate"]


# What is refused ---------------------------------------------------------------------------------------------------


def test_without_a_proof_nothing_is_exported(place: Path, capsys: Any) -> None:
    (place / "hopeless.yaml").write_text(QUICK.replace("[-1, 1]", "[-0.05, 0.05]"))
    outcome = export(capsys, "--splits", "1", spec="hopeless.yaml")
    assert outcome.code == 10 and outcome.out.startswith("FALSIFIED: ")
    assert not (place / "queries").exists()


def test_a_certificate_that_the_checker_rejects_is_not_exported(place: Path, capsys: Any) -> None:
    assert run(capsys, "verify", EXAMPLE, "--spec", "quick.yaml", "--certificate", "a.cert", "-q").code == 0
    (place / "other.yaml").write_text(QUICK.replace("[-1, 1]", "[-2, 2]"))
    outcome = export(capsys, "--certificate", "a.cert", spec="other.yaml")
    assert outcome.code == 5 and outcome.out.startswith("REJECTED: ")
    assert not (place / "queries").exists()
    content = (place / "a.cert").read_bytes()
    (place / "a.cert").write_bytes(content[:-9] + bytes([content[-9] ^ 1]) + content[-8:])
    outcome = export(capsys, "--certificate", "a.cert")
    assert outcome.code == 2 and "a.cert: " in outcome.err and not (place / "queries").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--periods", "x"), "--periods: received x"),
        (("--periods", "3:3"), "no period"),
        (("--periods", "7:9"), "the run has periods 0 to 4"),
        (("--periods", "1:3", "--closed-loop"), "unrolled from its start"),
        (("--map-order", "2"), "needs --closed-loop"),
        (("--map-order", "9", "--closed-loop"), "from 1 to 8"),
        (("--relative", "--closed-loop"), "excludes --closed-loop"),
        (("--leaves", "0"), "--leaves: received 0"),
        (("--certificate", "none.cert", "--epsilon", "0.1"), "excludes --certificate"),
        (("--certificate", "none.cert"), "there is no such certificate"),
    ],
)
def test_wrong_options_are_one_line(arguments: tuple[str, ...], words: str, place: Path, capsys: Any) -> None:
    outcome = export(capsys, *arguments)
    assert (outcome.code, outcome.out, outcome.err.count("\n")) == (2, "", 1) and words in outcome.err
    assert not (place / "queries").exists()


def test_a_place_is_required(place: Path, capsys: Any) -> None:
    assert "--out" in run(capsys, "export", EXAMPLE, "--spec", "quick.yaml").err


def test_what_is_no_export_is_not_replaced(place: Path, capsys: Any) -> None:
    mine = place / "queries"
    mine.mkdir()
    (mine / "claims.json").write_text('{"format": "mine"}')
    before = contents(mine)
    outcome = export(capsys)
    assert outcome.code == 2 and "not empty, and no export" in outcome.err and contents(mine) == before
    (place / "file").write_text("mine")
    assert export(capsys, out="file").code == 2 and (place / "file").read_text() == "mine"


def test_an_export_replaces_an_older_one_whole(place: Path, capsys: Any) -> None:
    (place / "queries").mkdir()
    assert export(capsys).code == 0, "an empty folder is taken"
    assert export(capsys, "--periods", "1").code == 0
    assert len(contents(place / "queries")) == 1 + 2 * 2 + 3
    assert {path.name for path in place.iterdir()} == {"quick.yaml", "queries"}


# Whole or not at all -----------------------------------------------------------------------------------------------


def part(name: str) -> Part:
    constraint = LinearConstraint((), ((0, ONE),), ONE)
    query = Query((1, 1), (1, 1), (Case((Bounds(-ONE, ONE),), (constraint,)),))
    return Part(name, b"content of " + name.encode(), {"leaf": 0}, (Asked(f"{name}-q", query, {"side": "upper"}),))


def test_an_error_leaves_what_was_there(tmp_path: Path) -> None:
    write_export(tmp_path / "a", [part("one")], {"setrl": "0"}, "page")
    before = contents(tmp_path)

    def failing() -> Any:
        yield part("two")
        raise KeyboardInterrupt

    for place in ("a", "b"):
        with pytest.raises(KeyboardInterrupt):
            write_export(tmp_path / place, failing(), {"setrl": "0"}, "page")
    assert contents(tmp_path) == before and [path.name for path in tmp_path.iterdir()] == ["a"]


def test_a_rename_that_fails_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_export(tmp_path / "a", [part("one")], {"setrl": "0"}, "page")
    before = contents(tmp_path)
    genuine = Path.rename

    def rename(self: Path, target: Any) -> Any:
        if self.name.endswith(".tmp"):
            raise OSError(28, "no space left")
        return genuine(self, target)

    monkeypatch.setattr(export_folder.Path, "rename", rename)
    with pytest.raises(InputError, match="no space left"):
        write_export(tmp_path / "a", [part("two")], {"setrl": "0"}, "page")
    assert contents(tmp_path) == before and [path.name for path in tmp_path.iterdir()] == ["a"]
