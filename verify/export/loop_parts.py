"""The closed loop as parts of an export: per leaf one network for every state that a requirement is about."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from ...specs.errors import InputError
from ...specs.exact import signed_text
from .folder import Asked, Part
from .loop_network import Loop, LoopNetwork, Output, loop_network
from .requirement_queries import Wanted, violation, wanted_queries
from .sources import Source


def loop_parts(source: Source, leaves: Iterable[int], periods: int, order: int) -> Iterator[Part]:
    """The parts, leaf by leaf.

    Parameters
    ----------
    source : Source
    leaves : iterable of int
    periods : int
        How many are unrolled at most.
    order : int
        Of the polynomials in time.

    Yields
    ------
    Part
        ``leaf0-during05`` unrolls six periods and has queries such as ``leaf0-during05-requirement0``.

    Raises
    ------
    InputError
        Nothing is asked for in these periods, or what a polynomial leaves out has no bound.
    """
    groups: dict[tuple[Output, ...], list[Wanted]] = {}
    for wanted in wanted_queries(source, periods):
        groups.setdefault(wanted.outputs, []).append(wanted)
    if not groups:
        raise InputError(
            f"no requirement is decided within {periods} periods",
            remedy="unroll more of them, or export the periods without --closed-loop",
        )
    for leaf in leaves:
        loop = Loop.of(source, leaf, periods, order)
        for outputs, group in groups.items():
            network = loop_network(loop, outputs)
            name = f"leaf{leaf}-{_named(outputs)}"
            about = {"leaf": leaf, "kind": "loop", "order": order, "precision": source.network.precision}
            asked = tuple(_asked(source, name, leaf, wanted, network) for wanted in group)
            yield Part(name, network.content, {**about, **_described(network)}, asked)


def _named(outputs: tuple[Output, ...]) -> str:
    (kind, first), (_, last) = outputs[0], outputs[-1]
    return f"{kind}{first:02d}" if first == last else f"{kind}{first:02d}to{last:02d}"


def _asked(source: Source, name: str, leaf: int, wanted: Wanted, network: LoopNetwork) -> Asked:
    requirement = source.contract.requirements[wanted.requirement]
    times = ", ".join(f"{kind} {'period' if kind == 'during' else 'instant'} {k}" for kind, k in wanted.outputs)
    comment = f"leaf {leaf}, requirement {requirement.name} ({requirement.kind}), {times}; unsat: it is not violated"
    data: dict[str, Any] = {
        "leaf": leaf,
        "kind": "requirement",
        "requirement": requirement.name,
        "meaning": requirement.kind,
        "states": [[kind, k] for kind, k in wanted.outputs],
    }
    query = violation(source, wanted, network, comment)
    return Asked(f"{name}-requirement{wanted.requirement}", query, data)


def _described(network: LoopNetwork) -> dict[str, Any]:
    inputs = [
        {
            "kind": entry.kind,
            "period": entry.period,
            "position": entry.position,
            "lower": signed_text(entry.bounds.lower),
            "upper": signed_text(entry.bounds.upper),
        }
        for entry in network.inputs
    ]
    return {"inputs": inputs, "outputs": [[kind, number] for kind, number in network.outputs]}
