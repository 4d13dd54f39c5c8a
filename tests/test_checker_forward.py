"""The checker's lines of neurons are proved on the whole of a range whose ends are only known as balls."""

from __future__ import annotations

import math

import pytest
from flint import arb, arb_mat

from setrl.verify.checker.forward import Forward
from setrl.verify.checker.layers import Activation
from setrl.verify.checker.leaf import Lines
from setrl.verify.checker.observed import Seen
from setrl.verify.checker.rejection import Rejected

END, ROOM = 0.5, 0.125
"""A range from -END to END, both known to ROOM: the neuron may be as large as 0.625."""


def form(error: float) -> Forward:
    seen = Seen([arb(0)], arb_mat(1, 1, [arb(1)]), 1, [arb(0)], [arb(0)])
    return Forward(seen, [Lines((0.0,), (0.0,), (error,))])


@pytest.mark.parametrize("kind", ["tanh", "sigmoid"])
@pytest.mark.parametrize(("reached", "proved"), [(END - ROOM, False), (END, False), (END + ROOM, True)])
def test_a_line_has_to_hold_wherever_the_ends_of_a_range_may_be(kind: str, reached: float, proved: bool) -> None:
    largest = math.tanh(reached) if kind == "tanh" else 1.0 / (1.0 + math.exp(-reached))
    low, high = arb(-END, ROOM), arb(END, ROOM)
    follow = form(largest + 1e-6)  # a ball has its radius in thirty bits
    if proved:
        follow.activate(Activation(kind), [low], [high])
        return
    with pytest.raises(Rejected):
        follow.activate(Activation(kind), [low], [high])


@pytest.mark.parametrize(("bound", "size"), [(0.25, 0.25), (0.5625, 0.5625), (1.0, END + ROOM)])
def test_the_clip_of_a_range_is_taken_wherever_its_ends_may_be(bound: float, size: float) -> None:
    follow = form(0.0)
    follow.clip([(arb(-bound), arb(bound))], (0.0,), [arb(-END, ROOM)], [arb(END, ROOM)])
    (found,) = follow.parts[-1].size
    assert bool(found >= size)
