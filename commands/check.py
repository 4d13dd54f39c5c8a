"""`setrl check`: the checker alone, without the readers that it is independent of."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from .. import __version__
from .arguments import (
    JsonOption,
    PolicyArgument,
    QuietOption,
    SpecOption,
    TimeoutOption,
    WorkersOption,
    require_workers,
    stop_after,
)
from .exit_codes import OK, UNKNOWN
from .inputs import content_of, first_bytes
from .output import one_line, print_json, say, tell


def check(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Certificate or witness.", show_default=False)],
    policy: PolicyArgument = None,
    specification: Annotated[
        str | None, typer.Argument(metavar="[SPEC]", help="Specification, as of --spec.", show_default=False)
    ] = None,
    spec: SpecOption = None,
    replay: Annotated[
        bool, typer.Option("--replay", help="Run a witness's recorded actions again with the installed onnxruntime.")
    ] = False,
    workers: WorkersOption = None,
    timeout: TimeoutOption = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> int:
    """Prove a certificate (of a VERIFIED) or a witness (of a FALSIFIED) again: ACCEPTED or REJECTED on stdout.

    Only the checker runs, from the three files; REJECTED (exit 5) means that nothing is known. Without a policy and a
    specification, those of the shipped example.
    """
    require_workers(workers)
    stop = stop_after(timeout)
    network, contract = _checked_inputs(policy, specification, spec)
    from ..specs.errors import InputError
    from ..verify.checker.recheck import MOST_BYTES, most_bytes, recheck
    from ..verify.interruption import progress_bar

    evidence = content_of(file, "certificate or witness", most_bytes(first_bytes(file, 64)))
    asked = content_of(network, "policy", MOST_BYTES["policy"])
    about = content_of(contract, "specification", MOST_BYTES["specification"])
    again = _replayed(network) if replay else None
    with progress_bar(not quiet) as progress:
        try:
            report = None if progress is None else progress.checking
            answer = recheck(
                evidence, asked, about, contract.parent, workers=workers, progress=report, stop=stop, replay=again
            )
        except InputError as error:
            remedy = error.remedy or "give the file as setrl verify wrote it, or write it again"
            raise InputError(error.message, where=str(file), remedy=remedy) from error
    if as_json:
        print_json({"setrl": __version__, "exit_code": OK if answer.accepted else UNKNOWN, **answer.data})
    else:
        say(f"{'ACCEPTED' if answer.accepted else 'REJECTED'}: {one_line(answer.sentence)}")
    if not quiet:
        tell(*answer.notes)
    return OK if answer.accepted else UNKNOWN


def _checked_inputs(policy: Path | None, specification: str | None, spec: str | None) -> tuple[Path, Path]:
    """Policy and specification of `setrl check`, found without the readers that the checker is independent of."""
    from ..specs.errors import UsageError

    order = "the order is setrl check FILE POLICY.onnx SPEC.yaml"
    if specification is not None and spec is not None:
        raise UsageError(f"received {spec} and {specification}", where="--spec", remedy="give one specification")
    chosen = spec if specification is None else specification
    if policy is None and chosen is None:
        from ..models.example import EXAMPLE_SPECIFICATION, example_policy_path

        policy, chosen = example_policy_path(), EXAMPLE_SPECIFICATION
    if policy is None or policy.suffix in (".yaml", ".yml"):
        received = "nothing" if policy is None else str(policy)
        raise UsageError(f"an ONNX file is required, received {received}", where="POLICY", remedy=order)
    if chosen is None or chosen.endswith(".onnx"):
        received = "nothing" if chosen is None else chosen
        raise UsageError(f"a specification is required, received {received}", where="SPEC", remedy=order)
    if Path(chosen).is_file() and chosen.endswith((".yaml", ".yml")):
        return policy, Path(chosen)
    from ..specs.reader import find_specification

    return policy, find_specification(chosen)


def _replayed(policy: Path) -> Callable[[Any], str]:
    """What runs a recording again: the runtime's name where it returns the same bits, else ""."""
    from ..models.onnx_reader import read_policy
    from ..verify.witness_replay import replay, runtime_name

    network = read_policy(policy)
    return lambda given: runtime_name() if replay(given.observations, given.actions, network) else ""
