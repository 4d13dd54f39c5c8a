"""`setrl radius`."""

from __future__ import annotations

from fractions import Fraction
from typing import Annotated

import typer

from .arguments import (
    CertificateOption,
    EnclosureOption,
    GeneratorsOption,
    JsonOption,
    MethodOption,
    NoCertificateOption,
    NoCheckOption,
    OrderOption,
    PolicyArgument,
    QuietOption,
    SpecOption,
    TimeoutOption,
    WitnessOption,
    WorkersOption,
    read_options,
    read_radius,
    require_workers,
)
from .inputs import read_inputs
from .output import print_json, say, tell, wrote
from .output_files import certificate_place, require_outputs, save_certificate, write_witness


def radius(
    policy: PolicyArgument = None,
    spec: SpecOption = None,
    resolution: Annotated[
        str | None, typer.Option(metavar="RADIUS", help="Radii closer than this are not told apart; default 0.001.")
    ] = None,
    least: Annotated[str | None, typer.Option(metavar="RADIUS", help="Begin there; default 0.")] = None,
    most: Annotated[str | None, typer.Option(metavar="RADIUS", help="Look no farther; default 10.")] = None,
    as_json: JsonOption = False,
    witness: WitnessOption = None,
    certificate: CertificateOption = None,
    no_certificate: NoCertificateOption = False,
    no_check: NoCheckOption = False,
    workers: WorkersOption = None,
    timeout: TimeoutOption = None,
    splits: Annotated[
        int | None, typer.Option(metavar="N", help="Most cells of the initial set at every radius; default 128.")
    ] = None,
    method: MethodOption = None,
    enclosure: EnclosureOption = None,
    taylor_order: OrderOption = None,
    generators: GeneratorsOption = None,
    quiet: QuietOption = False,
) -> int:
    """Search how much perturbation a policy withstands: the largest radius that is VERIFIED, the smallest FALSIFIED.

    The exit code is 0 where a radius is VERIFIED, 10 where already the least one is FALSIFIED, 5 otherwise.
    """
    from ..verify.radius import MOST, RESOLUTION, SPLITS, search_radius

    options = read_options(timeout, SPLITS if splits is None else splits, method, taylor_order, generators, enclosure)
    finest = read_radius(resolution, "--resolution")
    begin, end = read_radius(least, "--least"), read_radius(most, "--most")
    require_workers(workers)
    require_outputs(witness=witness, certificate=certificate)
    place, note = certificate_place(certificate, no_certificate, no_check, policy)
    network, specification = read_inputs(policy, spec, quiet)
    from ..verify.interruption import interruptible, progress_bar
    from ..verify.radius_report import radius_details, radius_lines, radius_to_json

    with interruptible(options.timeout) as deadline, progress_bar(not quiet) as progress:
        found = search_radius(
            network,
            specification,
            most=MOST if end is None else end,
            resolution=RESOLUTION if finest is None else finest,
            least=Fraction(0) if begin is None else begin,
            options=options,
            deadline=deadline,
            check=not no_check,
            workers=workers,
            progress=progress,
        )
    trouble = None
    content = None if found.verified_result is None else found.verified_result.certificate
    if content is None or place is None:
        place = None
    else:
        place, trouble = save_certificate(place, content)
    if as_json:
        print_json(radius_to_json(found, options, None if place is None else str(place)))
    else:
        say(*radius_lines(found))
    if not quiet:
        tell(*radius_details(found))
        if place is not None:
            wrote(place, quiet)
        elif content is not None and note:
            tell(f"no certificate was written: {note}")
    if trouble is not None:
        raise trouble
    if witness is not None and found.falsified_result is not None:
        write_witness(witness, found.falsified_result, quiet)
    return found.exit_code
