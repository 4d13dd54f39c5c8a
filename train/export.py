"""From trained parameters to what is deployed: an ONNX file, checked against torch, and the verifier's report on it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from ..models.onnx_reader import read_policy
from ..models.onnx_runtime import SLACK, deployed_runner, rounding_budget
from ..models.onnx_writer import write_policy
from ..models.policy import Policy
from ..specs.files import write_atomically
from .networks import Layout, Tensor, forward, layers_of

if TYPE_CHECKING:
    from ..verify.deadline import Deadline
    from ..verify.options import Options
    from ..verify.result import Result
    from .run_folder import RunFolder

POLICY, CERTIFICATE, REPORT, REPORT_DATA = "policy.onnx", "policy.cert", "report.txt", "report.json"

SAMPLES = 256
"""Points on which torch and onnxruntime are compared."""


def export_policy(
    folder: Path, layout: Layout, row: Tensor, *, precision: str = "float32", description: str = ""
) -> Policy:
    """Write one seed's network as ``policy.onnx``, read it back and compare it with torch.

    What a report said about the network that was there before is deleted first.

    Parameters
    ----------
    folder : Path
        Made where it is missing.
    layout : Layout
    row : Tensor, shape (P,)
        Numbers that are not exact in `precision` are rounded to nearest.
    precision : {"float32", "float64"}
    description : str
        Goes into the file.

    Returns
    -------
    Policy
        As the verifier reads it.

    Raises
    ------
    PolicyError
        A number is not finite: the training diverged.
    InputError
        The file cannot be written.
    """
    from ..specs.folders import make_folder

    make_folder(folder)
    for name in (CERTIFICATE, REPORT, REPORT_DATA):
        (folder / name).unlink(missing_ok=True)
    rounded = row.detach().cpu().to(torch.float64 if precision == "float64" else torch.float32)
    path = folder / POLICY
    write_policy(path, layers_of(layout, rounded), precision=precision, description=description)
    policy = read_policy(path)
    require_same_network(policy, layout, rounded)
    return policy


def require_same_network(policy: Policy, layout: Layout, row: Tensor) -> None:
    """Compare a file with torch: ``|onnxruntime(x) - torch(x)| <= 2 SLACK budget(x)`` on fixed random points.

    Both round in the same precision, and each stays within `SLACK` times the first-order estimate of
    `models.onnx_runtime.rounding_budget`.

    Parameters
    ----------
    policy : Policy
        With its bytes.
    layout : Layout
    row : Tensor, shape (P,)
        In the file's precision.

    Raises
    ------
    AssertionError
        They differ by more.
    """
    generator = np.random.default_rng(20250117)
    scales = generator.choice([0.1, 1.0, 10.0], size=(SAMPLES, 1))
    given = torch.from_numpy(generator.uniform(-1.0, 1.0, size=(SAMPLES, layout.sizes[0])) * scales).to(row.dtype)
    points = given.double().numpy()
    with torch.no_grad():
        expected = forward(layout, row[None], given[None])[0].double().numpy()
    received = deployed_runner(policy)(points)
    _, budget = rounding_budget(policy, points)
    # stated as what has to hold: NaN is no agreement
    if not (received.shape == expected.shape and (np.abs(received - expected) <= 2.0 * SLACK * budget).all()):
        raise AssertionError(f"{policy.name}: onnxruntime and torch do not compute the same actions")


def report_policy(
    folder: Path,
    specification: Path,
    *,
    options: Options | None = None,
    deadline: Deadline | None = None,
    epsilon: Any = None,
    check: bool = True,
) -> Result:
    """Verify ``policy.onnx`` of a folder and write the report beside it: text, JSON, and the certificate of a proof.

    Parameters
    ----------
    folder : Path
        Of `export_policy`.
    specification : Path
        A file.
    options : Options, optional
        The budget: number of cells, seconds.
    deadline : Deadline, optional
        Lets the caller interrupt.
    epsilon : number or mapping, optional
        Radius instead of the specification's.
    check : bool
        Whether the checker has to accept the certificate.

    Returns
    -------
    Result

    Raises
    ------
    SetrlError
        The policy or the specification cannot be used, or a file cannot be written.
    """
    from ..verify.options import Options
    from ..verify.report import describe, result_to_json, verdict_line
    from ..verify.verifier import verify

    chosen = options or Options()
    path = folder / POLICY
    result = verify(path, specification, options=chosen, epsilon=epsilon, deadline=deadline, check=check)
    certificate = folder / CERTIFICATE
    if result.certificate is None:
        certificate.unlink(missing_ok=True)
    else:
        write_atomically(certificate, result.certificate)
    text = "\n".join([verdict_line(result), "", *describe(result), ""])
    write_atomically(folder / REPORT, text.encode())
    data = result_to_json(result, chosen, None if result.certificate is None else CERTIFICATE)
    write_atomically(folder / REPORT_DATA, (json.dumps(data, indent=2, allow_nan=False) + "\n").encode())
    return result


def publish_best(run: RunFolder, values: Mapping[int, float], facts: Mapping[str, Any] | None = None) -> int:
    """Copy the best seed's policy to the top of the run, and say why it is the best in ``summary.json``.

    Parameters
    ----------
    run : RunFolder
        Every seed's policy is written.
    values : mapping of seed to float
        V(s0) at the validation radius; the largest is the best, the first one of several. NaN and -inf (no bound)
        are never better than a number.
    facts : mapping, optional
        Further plain data for the summary.

    Returns
    -------
    int
        The seed.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    best = best_seed(values)
    content = (run.seed(best) / POLICY).read_bytes()
    write_atomically(run.policy, content)
    finite = {str(seed): value if np.isfinite(value) else None for seed, value in values.items()}
    summary = {"best_seed": best, "policy": f"{run.seed(best).name}/{POLICY}", "values": finite, **(facts or {})}
    write_atomically(run.summary, (json.dumps(summary, indent=2, allow_nan=False) + "\n").encode())
    return best


def best_seed(values: Mapping[int, float]) -> int:
    """The seed of the largest V; the first of equal ones, and of none with a bound."""
    if not values:
        raise AssertionError("there is no seed")
    return max(values, key=lambda seed: values[seed] if values[seed] == values[seed] else -np.inf)
