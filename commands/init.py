"""`setrl init`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .exit_codes import OK
from .output import say, write


def init(
    plant: Annotated[str, typer.Argument(metavar="PLANT", help="A shipped plant's name, or a plant file.")],
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Write to a file instead of stdout.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the file.")] = False,
) -> int:
    """Print a commented specification for a plant, to be filled in."""
    from ..models.plant import load_plant
    from ..models.template import specification_template
    from ..specs.files import require_writable

    if out is not None:
        require_writable(out, overwrite=force)
    text = specification_template(load_plant(plant), plant, out.parent if out is not None else Path())
    if out is None:
        say(text.rstrip("\n"))
    else:
        write(out, text, False)
    return OK
