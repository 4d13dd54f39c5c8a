"""`setrl export`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .arguments import (
    EpsilonOption,
    GeneratorsOption,
    JsonOption,
    Method,
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
)
from .exit_codes import OK, UNKNOWN
from .inputs import content_of, first_bytes, read_inputs
from .output import one_line, print_json, say, tell

if TYPE_CHECKING:
    from ..verify.deadline import Deadline
    from ..verify.export.folder import Exported
    from ..verify.export.sources import Source
    from ..verify.options import Options

NOTHING = "nothing is exported: there is no proof"


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
    written = write_queries(
        policy=policy,
        spec=spec,
        out=out,
        certificate=certificate,
        periods=periods,
        leaves=leaves,
        relative=relative,
        closed_loop=closed_loop,
        map_order=map_order,
        epsilon=epsilon,
        workers=workers,
        timeout=timeout,
        splits=splits,
        method=method,
        taylor_order=taylor_order,
        generators=generators,
        quiet=quiet,
    )
    if isinstance(written, int):
        return written
    count, head = written
    if as_json:
        print_json({"out": str(out), "networks": count.networks, "queries": count.queries, **head})
    else:
        say(f"{count.queries} queries about {count.networks} networks: {out}")
    return OK


def write_queries(
    *,
    policy: Path | None = None,
    spec: str | None = None,
    out: Path | None = None,
    certificate: Path | None = None,
    periods: str | None = None,
    leaves: int | None = None,
    relative: bool = False,
    closed_loop: bool = False,
    map_order: int | None = None,
    epsilon: str | None = None,
    workers: int | None = None,
    timeout: float | None = None,
    splits: int | None = None,
    method: Method | None = None,
    taylor_order: int | None = None,
    generators: int | None = None,
    quiet: bool = True,
) -> tuple[Exported, dict[str, Any]] | int:
    """What `export` does before it answers: what was written and the head of its list, or an exit code without a proof.

    See `export` for the options.
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
    proved = _proved(network, specification, certificate, options, radius, workers, quiet)
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
    return write_export(out, parts, head, readme_of(source, sentence, head["certificate"], order)), head


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


def _proved(
    network: str,
    specification: str,
    certificate: Path | None,
    options: Options,
    radius: Any,
    workers: int | None,
    quiet: bool,
) -> tuple[Source, str] | int:
    """A proof that the checker accepts, and its claim; where there is none, the exit code of what there is."""
    from ..specs.errors import InputError
    from ..specs.reader import find_specification
    from ..verify.checker.recheck import MOST_BYTES, recheck
    from ..verify.export.sources import read_source
    from ..verify.interruption import interruptible, progress_bar

    place = find_specification(specification)
    asked = content_of(Path(network), "policy", MOST_BYTES["policy"])
    about = content_of(place, "specification", MOST_BYTES["specification"])
    evidence = None if certificate is None else _given(certificate)
    with interruptible(options.timeout) as deadline, progress_bar(not quiet) as progress:
        if evidence is None:
            found = _claimed(network, specification, options, radius, deadline, progress)
            if isinstance(found, int):
                return found
            evidence = found
        report = None if progress is None else progress.checking
        try:
            answer = recheck(
                evidence,
                asked,
                about,
                place.parent,
                workers=workers,
                progress=report,
                stop=lambda: deadline.expired,
            )
        except InputError as error:
            raise error.at(str(certificate)) from error
    if answer.accepted:
        return read_source(evidence, asked, about, place.parent), answer.sentence
    say(f"REJECTED: {one_line(answer.sentence)}")
    if not quiet:
        tell(NOTHING)
    return UNKNOWN


def _given(certificate: Path) -> bytes:
    """The bytes of a certificate."""
    from ..specs.errors import InputError
    from ..verify.checker.certificate_file import MAGIC
    from ..verify.checker.recheck import most_bytes

    start = first_bytes(certificate, 64)
    content = content_of(certificate, "certificate", most_bytes(start))
    if not content.startswith(MAGIC):
        raise InputError("this is no certificate", where=str(certificate), remedy="give the file of a VERIFIED")
    return content


def _claimed(
    network: str, specification: str, options: Options, radius: Any, deadline: Deadline, progress: Any
) -> bytes | int:
    """The certificate of a search; without one, the exit code of its verdict."""
    from ..verify import report
    from ..verify.verifier import verify

    result = verify(
        network, specification, options=options, epsilon=radius, deadline=deadline, progress=progress, check=False
    )
    if result.certificate is not None:
        return result.certificate
    say(report.verdict_line(result))
    if progress is not None:
        tell(NOTHING)
    return result.verdict.exit_code
