"""`setrl verify`."""

from __future__ import annotations

from .arguments import (
    CertificateOption,
    EnclosureOption,
    EpsilonOption,
    GeneratorsOption,
    JsonOption,
    MethodOption,
    NoCertificateOption,
    NoCheckOption,
    OrderOption,
    PlotOption,
    PolicyArgument,
    QuietOption,
    SpecOption,
    SplitsOption,
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


def verify_command(
    policy: PolicyArgument = None,
    spec: SpecOption = None,
    as_json: JsonOption = False,
    plot: PlotOption = None,
    witness: WitnessOption = None,
    certificate: CertificateOption = None,
    no_certificate: NoCertificateOption = False,
    no_check: NoCheckOption = False,
    workers: WorkersOption = None,
    timeout: TimeoutOption = None,
    epsilon: EpsilonOption = None,
    splits: SplitsOption = None,
    method: MethodOption = None,
    enclosure: EnclosureOption = None,
    taylor_order: OrderOption = None,
    generators: GeneratorsOption = None,
    quiet: QuietOption = False,
) -> int:
    """Verify a policy: VERIFIED, FALSIFIED or UNKNOWN on stdout, everything else on stderr.

    VERIFIED means that the checker accepted the certificate. Without arguments, verify the shipped example.
    """
    options = read_options(timeout, splits, method, taylor_order, generators, enclosure)
    radius = read_radius(epsilon)
    require_workers(workers)
    require_outputs(plot=plot, witness=witness, certificate=certificate)
    place, note = certificate_place(certificate, no_certificate, no_check, policy)
    network, specification = read_inputs(policy, spec, quiet)
    from ..verify import report
    from ..verify.interruption import interruptible, progress_bar
    from ..verify.verifier import verify

    with interruptible(options.timeout) as deadline, progress_bar(not quiet) as progress:
        result = verify(
            network,
            specification,
            options=options,
            epsilon=radius,
            deadline=deadline,
            progress=progress,
            check=not no_check,
            workers=workers,
        )
    trouble = None
    if result.certificate is None or place is None:
        place = None
    else:
        place, trouble = save_certificate(place, result.certificate)
    if as_json:
        print_json(report.result_to_json(result, options, None if place is None else str(place)))
    else:
        say(report.verdict_line(result))
    if not quiet:
        tell(*report.describe(result))
        if place is not None:
            wrote(place, quiet)
        elif result.certificate is not None and note:
            tell(f"no certificate was written: {note}")
    if trouble is not None:
        raise trouble
    if plot is not None:
        result.plot(str(plot))
        wrote(plot, quiet)
    if witness is not None and result.witness is not None:
        write_witness(witness, result, quiet)
    return result.verdict.exit_code
