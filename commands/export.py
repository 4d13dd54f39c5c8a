"""`setrl export`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .arguments import (
    EpsilonOption,
    GeneratorsOption,
    JsonOption,
    MethodOption,
    OrderOption,
    PolicyArgument,
    QuietOption,
    SpecOption,
    SplitsOption,
    TimeoutOption,
    WorkersOption,
    read_options,
    read_radius,
    require_whole,
    require_workers,
    stop_after,
)
from .exit_codes import OK, UNKNOWN
from .inputs import read_inputs
from .output import one_line, print_json, say, tell

if TYPE_CHECKING:
    from ..verify.export.sources import Source
    from ..verify.options import Options


def export(
    policy: PolicyArgument = None,
    spec: SpecOption = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder of the export.")] = None,
    certificate: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Export this certificate; default: verify first.")
    ] = None,
    periods: Annotated[
        str | None, typer.Option(metavar="A:B", help="Periods A to B - 1 only, counted from 0; N: the first N.")
    ] = None,
    leaves: Annotated[int | None, typer.Option(metavar="N", help="The first N parts of the initial set only.")] = None,
    relative: Annotated[
        bool, typer.Option("--relative", help="Claim actions relative to their linear part, not as intervals.")
    ] = False,
    closed_loop: Annotated[
        bool, typer.Option("--closed-loop", help="Export the unrolled loop, with the requirements as queries.")
    ] = False,
    map_order: Annotated[
        int | None, typer.Option("--map-order", metavar="K", help="Order of the loop's polynomials in time; default 2.")
    ] = None,
    epsilon: EpsilonOption = None,
    workers: WorkersOption = None,
    timeout: TimeoutOption = None,
    splits: SplitsOption = None,
    method: MethodOption = None,
    taylor_order: OrderOption = None,
    generators: GeneratorsOption = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> int:
    """Write a proof's claims about the network as ONNX and VNN-LIB, for other verifiers.

    Nothing is written unless the checker accepts the certificate.
    """
    from ..specs.errors import UsageError
    from ..verify.export.folder import require_place, write_export
    from ..verify.export.readme import head_of, readme_of

    options = read_options(timeout, splits, method, taylor_order, generators)
    radius = read_radius(epsilon)
    require_workers(workers)
    for flag, other, wrong in (
        ("--epsilon", "--certificate", radius is not None and certificate is not None),
        ("--relative", "--closed-loop", relative and closed_loop),
    ):
        if wrong:
            raise UsageError(f"excludes {other}", where=flag, remedy="give one of the two")
    if map_order is not None:
        if not closed_loop:
            raise UsageError("needs --closed-loop", where="--map-order", remedy="give both, or neither")
        require_whole("--map-order", map_order, 1, 8)
    first, last = _read_periods(periods, closed_loop)
    if leaves is not None:
        require_whole("--leaves", leaves, 1, 10**9)
    if out is None:
        raise UsageError("a folder is required", where="--out", remedy="say where the export goes: --out DIR")
    require_place(out)
    network, specification = read_inputs(policy, spec, quiet)
    if certificate is None:
        proved = _verified(network, specification, options, radius, workers, quiet)
    else:
        proved = _accepted(network, specification, certificate, workers, timeout, quiet)
    if isinstance(proved, int):
        return proved
    source, sentence = proved
    chosen = range(source.layout.periods)[first:last]
    if not chosen:
        raise UsageError(
            f"the run has periods 0 to {source.layout.periods - 1}, received {periods}",
            where="--periods",
            remedy="choose some of them",
        )
    some = range(len(source.boxes))[:leaves]
    head = head_of(source, sentence)
    order = (map_order or 2) if closed_loop else None
    if order is not None:
        from ..verify.export.loop_parts import loop_parts

        parts = loop_parts(source, some, len(chosen), order)
    else:
        from ..verify.export.action_parts import action_parts

        parts = action_parts(source, some, chosen, relative)
    count = write_export(out, parts, head, readme_of(source, sentence, head["certificate"], order))
    if as_json:
        print_json({"out": str(out), "networks": count.networks, "queries": count.queries, **head})
    else:
        say(f"{count.queries} queries about {count.networks} networks: {out}")
    return OK


def _read_periods(text: str | None, closed_loop: bool) -> tuple[int, int | None]:
    """First period and the one behind the last, of `A:B` or `N`."""
    from ..specs.errors import UsageError

    if text is None:
        return 0, None
    first, colon, last = text.partition(":")
    numbers = [first, last] if colon else ["0", first]
    if not all(number.isascii() and number.isdigit() and len(number) < 10 for number in numbers):
        raise UsageError(f"received {text}", where="--periods", remedy="write A:B or N, whole numbers")
    begin, end = map(int, numbers)
    if begin >= end:
        raise UsageError(f"received {text}, which has no period", where="--periods", remedy="write A:B with A < B")
    if closed_loop and begin:
        raise UsageError("a loop is unrolled from its start", where="--periods", remedy="write --periods N")
    return begin, end


def _verified(
    network: str, specification: str, options: Options, radius: Any, workers: int | None, quiet: bool
) -> tuple[Source, str] | int:
    """A proof of this minute; where there is none, the exit code of the verdict that there is."""
    from ..verify import report
    from ..verify.evidence_files import evidence_files
    from ..verify.export.sources import read_source
    from ..verify.interruption import interruptible, progress_bar
    from ..verify.result import Verdict
    from ..verify.verifier import verify

    with interruptible(options.timeout) as deadline, progress_bar(not quiet) as progress:
        result = verify(
            network,
            specification,
            options=options,
            epsilon=radius,
            deadline=deadline,
            progress=progress,
            workers=workers,
        )
    if result.verdict is not Verdict.VERIFIED or result.certificate is None:
        say(report.verdict_line(result))
        if not quiet:
            tell("nothing is exported: there is no proof")
        return result.verdict.exit_code
    files = evidence_files(result.loop, None)
    if isinstance(files, str):
        raise AssertionError(f"a certificate without its files: {files}")
    return read_source(result.certificate, files.policy, files.specification, files.folder), result.claim


def _accepted(
    network: str, specification: str, certificate: Path, workers: int | None, timeout: float | None, quiet: bool
) -> tuple[Source, str] | int:
    """A given proof, once the checker accepts it; else the exit code of what is not known."""
    from ..specs.errors import InputError
    from ..specs.reader import find_specification
    from ..verify.checker.recheck import MOST_BYTES, most_bytes, recheck
    from ..verify.export.sources import read_source
    from ..verify.interruption import progress_bar
    from .check import _content as content_of
    from .inputs import first_bytes

    place = find_specification(specification)
    evidence = content_of(certificate, "certificate", most_bytes(first_bytes(certificate, 64)))
    asked = content_of(Path(network), "policy", MOST_BYTES["policy"])
    about = content_of(place, "specification", MOST_BYTES["specification"])
    with progress_bar(not quiet) as progress:
        try:
            report = None if progress is None else progress.checking
            answer = recheck(
                evidence, asked, about, place.parent, workers=workers, progress=report, stop=stop_after(timeout)
            )
        except InputError as error:
            raise error.at(str(certificate)) from error
    if not answer.accepted or answer.data["evidence"] != "certificate":
        say(f"{'NO PROOF' if answer.accepted else 'REJECTED'}: {one_line(answer.sentence)}")
        if not quiet:
            tell("nothing is exported: there is no proof")
        return UNKNOWN
    return read_source(evidence, asked, about, place.parent), answer.sentence
