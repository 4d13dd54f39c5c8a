"""`setrl doctor`."""

from __future__ import annotations

from typing import Annotated

import typer

from .arguments import JsonOption
from .exit_codes import BAD_INPUT, OK
from .output import print_json, say, tell

RuntimeOption = Annotated[bool, typer.Option("--runtime", help="Measure the installed onnxruntime (minutes).")]


def doctor(as_json: JsonOption = False, runtime: RuntimeOption = False) -> int:
    """Test what the engine assumes about this machine, and print versions.

    With --runtime, measure tanh and sigmoid of the installed onnxruntime on all float32 numbers instead (minutes), and
    store what claims about its execution use.
    """
    if runtime:
        return _measure_runtime(as_json)
    from ..verify.doctor import examination_lines, examine

    facts = examine()
    if as_json:
        print_json(facts)
    else:
        say(*examination_lines(facts))
    if facts["problems"]:
        tell(*(f"setrl: error: {problem}: no verdict on this machine can be trusted" for problem in facts["problems"]))
        return BAD_INPUT
    return OK


def _measure_runtime(as_json: bool) -> int:
    from dataclasses import asdict

    from ..verify.doctor import measurement_bar, measurement_lines
    from ..verify.runtime_error import require_storable, store_measurement
    from ..verify.runtime_measurement import measure_runtime

    require_storable()
    with measurement_bar(True) as progress:
        measurement = measure_runtime(progress)
    path = store_measurement(measurement)
    if as_json:
        print_json(asdict(measurement))
    else:
        say(*measurement_lines(measurement))
    tell(f"wrote {path}")
    return OK
