"""The network claims of a certificate, as parts of an export: one network per leaf and period, 2 m queries for each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from ...specs.exact import signed_text
from .action_claims import INTERVAL, RELATIVE, ActionQuery, action_queries
from .folder import Asked, Part
from .period_network import Controller, PeriodNetwork, period_network
from .sources import Source
from .tracked import tracked_sets


def action_parts(source: Source, leaves: Iterable[int], periods: range, relative: bool = False) -> Iterator[Part]:
    """The parts, in the order of leaves and periods.

    Parameters
    ----------
    source : Source
    leaves : iterable of int
    periods : range
        Periods to export.
    relative : bool
        The relative form of the claims instead of intervals.

    Yields
    ------
    Part
        ``leaf0-period00``, with queries such as ``leaf0-period00-output0-upper``.
    """
    controller = Controller.of(source)
    width = len(str(max(source.layout.periods - 1, 10)))
    for leaf in leaves:
        for number, (tracked, claim) in enumerate(tracked_sets(source.layout, source.leaf(leaf))):
            if number not in periods:
                continue
            network = period_network(source, controller, tracked, claim)
            name = f"leaf{leaf}-period{number:0{width}d}"
            what = f"leaf {leaf}, period {number}, which starts at {float(source.layout.period * number):g} s"
            queries = action_queries(network, RELATIVE if relative else INTERVAL, what)
            about = {"leaf": leaf, "period": number}
            asked = tuple(_asked(source, name, about, query) for query in queries)
            yield Part(name, network.content, {**about, **_described(source, network)}, asked)


def _asked(source: Source, name: str, about: dict[str, Any], query: ActionQuery) -> Asked:
    data = {
        **about,
        "kind": "action",
        "form": query.form,
        "output": query.output,
        "action": source.contract.plant.inputs[query.output],
        "side": query.side,
        "claimed": str(query.claimed),
        "rounding": float(query.rounding),
        "bound": signed_text(query.bound),
    }
    return Asked(f"{name}-output{query.output}-{query.side}", query.query, data)


def _described(source: Source, network: PeriodNetwork) -> dict[str, Any]:
    inputs = [{"kind": factor.kind, "position": factor.position} for factor in network.factors]
    return {"kind": "period", "precision": network.precision, "inputs": inputs, "outputs": source.contract.plant.inputs}
