"""Arguments and options that several commands share, and how their values are read."""

from __future__ import annotations

import time
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from fractions import Fraction

    from ..verify.options import Options


class Method(StrEnum):
    """Flow enclosures."""

    jets = "jets"
    linearization = "linearization"


class Enclosure(StrEnum):
    """Policy enclosures."""

    zonotope = "zonotope"
    crown = "crown"
    best = "best"


PolicyArgument = Annotated[Path | None, typer.Argument(metavar="[POLICY]", help="ONNX file.", show_default=False)]
SpecOption = Annotated[
    str | None,
    typer.Option(
        "--spec", metavar="FILE", help="Specification: a file, or the name of a shipped one such as nav.yaml."
    ),
]
TimeoutOption = Annotated[
    float | None, typer.Option(metavar="SECONDS", help="Stop then; what is not proved is UNKNOWN.")
]
SplitsOption = Annotated[int | None, typer.Option(metavar="N", help="Most cells of the initial set; 1: no splitting.")]
MethodOption = Annotated[Method | None, typer.Option(help="Flow enclosure; default jets.")]
EnclosureOption = Annotated[Enclosure | None, typer.Option(help="Policy enclosure; default zonotope.")]
OrderOption = Annotated[
    int | None, typer.Option("--taylor-order", metavar="K", help="Time order of the flow enclosure.")
]
GeneratorsOption = Annotated[int | None, typer.Option(metavar="N", help="Generators kept per state dimension.")]
EpsilonOption = Annotated[
    str | None,
    typer.Option(metavar="RADIUS", help="Radius of the observation perturbation, instead of the specification's."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="One JSON document on stdout.")]
PlotOption = Annotated[Path | None, typer.Option(metavar="FILE", help="Draw into a .png, .pdf or .svg file.")]
WitnessOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.json", help="Write the witness of a FALSIFIED; its trajectory as .csv and .png beside it."
    ),
]
CertificateOption = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Write the certificate there; default: POLICY.cert in the current folder."),
]
NoCertificateOption = Annotated[bool, typer.Option("--no-certificate", help="Write no certificate.")]
NoCheckOption = Annotated[bool, typer.Option("--no-check", help="Do not run the checker: a proof is only CLAIMED.")]
WorkersOption = Annotated[
    int | None, typer.Option(metavar="N", help="Processes of the checker; default: one per processor.")
]
CsvOption = Annotated[Path | None, typer.Option(metavar="FILE", help="Write comma-separated values.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Nothing but the verdict and errors.")]


def read_options(
    timeout: float | None,
    splits: int | None,
    method: Method | None,
    taylor_order: int | None,
    generators: int | None,
    enclosure: Enclosure | None = None,
) -> Options:
    """Numerical options as given; a wrong one is told by its flag."""
    from ..specs.errors import UsageError
    from ..verify.options import Options

    given = {
        "--timeout": ("timeout", timeout),
        "--splits": ("splits", splits),
        "--method": ("method", None if method is None else method.value),
        "--enclosure": ("enclosure", None if enclosure is None else enclosure.value),
        "--taylor-order": ("taylor_order", taylor_order),
        "--generators": ("generators", generators),
    }
    chosen: dict[str, Any] = {}
    for flag, (name, value) in given.items():
        if value is None:
            continue
        try:
            Options(**{**chosen, name: value})
        except UsageError as error:
            raise UsageError(error.message, where=flag, remedy=f"leave {flag} out for the default") from error
        chosen[name] = value
    return Options(**chosen)


def read_radii(text: str | None, flag: str = "--epsilon") -> tuple[Fraction, ...]:
    """Exact radii of `FIRST:LAST:STEP`, of a list or of one number; none where nothing was given."""
    from ..specs.errors import InputError
    from ..specs.exact import decimal_range

    try:
        return () if text is None else decimal_range(text)
    except InputError as error:
        raise error.at(flag) from error


def read_radius(text: str | None, flag: str = "--epsilon") -> Fraction | None:
    """One exact radius; None where none was given."""
    from ..specs.errors import UsageError

    radii = read_radii(text, flag)
    if len(radii) > 1:
        raise UsageError(f"one radius is required, received {text}", where=flag, remedy="use setrl sweep")
    return radii[0] if radii else None


def require_whole(flag: str, value: int, least: int, most: int) -> None:
    """Refuse a number outside [least, most]."""
    from ..specs.errors import UsageError

    if not least <= value <= most:
        raise UsageError(f"received {value}", where=flag, remedy=f"use a whole number from {least} to {most}")


def require_workers(workers: int | None) -> None:
    """Refuse numbers of processes that no machine has."""
    if workers is not None:
        require_whole("--workers", workers, 1, 1024)


def stop_after(timeout: float | None) -> Callable[[], bool] | None:
    """What the checker asks between two leaves; an interrupt aborts it, because half a check is none."""
    from ..specs.errors import UsageError

    if timeout is None:
        return None
    if not timeout > 0.0:
        raise UsageError(f"received {timeout:g}", where="--timeout", remedy="use a positive number of seconds")
    end = time.monotonic() + timeout
    return lambda: time.monotonic() >= end
