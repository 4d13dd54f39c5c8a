"""Files that a command reads."""

from __future__ import annotations

from pathlib import Path

from .output import tell


def read_inputs(policy: Path | None, spec: str | None, quiet: bool) -> tuple[str, str]:
    """Policy and specification as given, or the shipped example."""
    from ..specs.errors import UsageError

    if policy is None and spec is None:
        from ..verify.verifier import example

        network, specification = example()
        if not quiet:
            tell(
                f"No policy was given: this is the shipped example, {Path(network).name} with {specification}.yaml.",
                "Your own: setrl verify POLICY.onnx --spec FILE.yaml; a specification to start from: setrl init PLANT",
                "",
            )
        return network, specification
    spec = require_specification(spec)
    if policy is None:
        raise UsageError("a policy is required", where="POLICY", remedy="give an ONNX file before --spec")
    return str(policy), spec


def require_specification(spec: str | None) -> str:
    """What --spec says; it has to say something."""
    from ..specs.errors import UsageError
    from ..specs.reader import shipped_specifications

    if spec is None:
        names = ", ".join(shipped_specifications())
        raise UsageError("a specification is required", where="--spec", remedy=f"a file, or a shipped one: {names}")
    return spec


def first_bytes(path: Path, count: int) -> bytes:
    """The first bytes of a file; none where it cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(count)
    except OSError:
        return b""


def content_of(path: Path, what: str, most: int) -> bytes:
    """The bytes of a regular file: of nothing else it is known that they end."""
    from ..specs.errors import InputError

    try:
        if not path.is_file():
            raise InputError(f"a file is required: there is no such {what}", where=str(path), remedy="check the path")
        if path.stat().st_size > most:
            raise InputError(f"no {what} has more than {most} bytes", where=str(path), remedy="check the path")
        return path.read_bytes()
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise InputError(f"cannot read the {what}: {reason}", where=str(path), remedy="check the path") from error
