"""What an export says about itself: the page inside its folder, and the beginning of its `claims.json`."""

from __future__ import annotations

import hashlib
from typing import Any

from .sources import Source

_HEAD = """\
# Queries about one policy

{sentence}

That is proved by the certificate with the sha256 below. The files here let verifiers of networks answer for parts of it
again. `instances.csv` lists them (`onnx,vnnlib,timeout`); `vnnlib2/` has the same queries in VNN-LIB 2.0, where the
network is called `N`; `claims.json` says exactly what each one asks.

| file | sha256 |
|---|---|
| policy | `{policy}` |
| specification | `{specification}` |
| certificate | `{certificate}` |
"""

_ACTIONS = """
## One control period at a time

Each network is the policy with a set of observations in front of it: its inputs b in [-1, 1] are the factors of the
set, o = c + G b, then the map before the network, the network, the map after it and the clip, as the specification
says. Each query is a violation: some action beyond a bound of the set of actions that the certificate claims for the
period.

- `unsat`: no action of the period is beyond the bound. The certificate's claim about the network holds on this side, to
  within twice the `rounding` of `claims.json`.
- `sat`: a point b at which the network of the file is beyond the bound. If that is right, the certificate is wrong: the
  bound is further out than the claim by more than the rounding of c and G to {precision} can do. Compute the action at
  b with exact or higher arithmetic before you believe it.
- `unknown`, `timeout`: nothing.

All of it is about exact arithmetic on the numbers in the files. What these queries do not say: that the sets contain
what the plant does. That is the rest of the certificate.
"""

_LOOP = """
## The closed loop as a network

Each network of this kind unrolls the whole loop. One step of the plant is its Taylor polynomial of order {order} in
time, plus an input w that stands for what the polynomial leaves out. The inputs: the initial state, the perturbations,
and the w of every period, in the boxes of the query; a time within a period is an input too, as a share of the period.
Every trajectory of the loop is one of the network, for some w. Each query is a violation of one requirement, for the
states that `claims.json` names.

- `unsat`: no trajectory violates the requirement there. The certificate's sets play no part but one: the boxes of w
  rest on them, because the remainder is bounded over the states and actions that the certificate encloses.
- `sat`: it may need a w that no trajectory has, and then it means nothing. Simulate its initial state.
- `unknown`, `timeout`: nothing.

All of it is about exact arithmetic on the numbers in the files; what their rounding changes is in the boxes of w.
States that touch a bound count as violations.
"""


def readme_of(source: Source, sentence: str, certificate: str, order: int | None) -> str:
    """The page.

    Parameters
    ----------
    source : Source
    sentence : str
        The claim that the checker accepted.
    certificate : str
        Its sha256.
    order : int or None
        Order of the polynomials of a closed loop; None where the periods are exported one by one.
    """
    header = source.file.header
    page = _HEAD.format(
        sentence=f"{sentence[:1].upper()}{sentence[1:]}.",
        policy=header.policy,
        specification=header.specification,
        certificate=certificate,
    )
    return page + (_ACTIONS.format(precision=source.network.precision) if order is None else _LOOP.format(order=order))


def head_of(source: Source, sentence: str) -> dict[str, Any]:
    """The beginning of `claims.json`: what the export is about."""
    from ... import __version__

    header = source.file.header
    return {
        "setrl": __version__,
        "claim": sentence,
        "certificate": hashlib.sha256(source.file.content).hexdigest(),
        "policy": header.policy,
        "specification": header.specification,
        "plant": header.plant,
        "observation_radius": [str(radius) for radius in source.radius],
        "leaves": len(source.boxes),
        "periods": source.layout.periods,
    }
