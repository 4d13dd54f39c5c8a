"""`setrl inspect`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .arguments import JsonOption
from .exit_codes import OK
from .output import print_json, say


def inspect(
    policy: Annotated[Path, typer.Argument(metavar="POLICY", help="ONNX file.", show_default=False)],
    as_json: JsonOption = False,
) -> int:
    """List a policy's operators, layers and sizes, and everything in it that is not supported."""
    from ..models.onnx_reader import describe_policy, read_policy
    from ..verify.report import policy_lines

    description = describe_policy(policy)
    if as_json:
        print_json(description)
    else:
        say(*policy_lines(description))
    read_policy(policy)
    return OK
