"""Lower bounds of a question's forms over a batch of boxes, in exact arithmetic and as the network is deployed.

Two enclosures of the network, and per form the better bound: zonotopes forward, in which form and inputs share their
factors, and linear bounds backward from the forms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...models.policy import Affine, Policy
from .. import balls, rounding
from ..backward import follow, usual
from ..balls import Ball
from ..deployed import deployed_error
from ..network import NetworkEnclosure, enclose_layers
from ..zonotope import Zonotope, concatenate, from_box, linear_map
from .question import Question

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FormBounds:
    """What is proved of the forms v over each of B boxes, and where they seem smallest.

    Attributes
    ----------
    lower : array, shape (B, K)
        ``lower <= v`` for every x of the box, in exact arithmetic; not finite where nothing is known.
    deployed : array, shape (B, K)
        The same for the outputs that the runtime computes.
    upper : array, shape (B, K)
        ``v <= upper`` in exact arithmetic.
    generators : array, shape (B, n, K)
        How v moves with each input from the middle of the box to its face, approximately.
    rest : array, shape (B, K)
        What v moves besides that: the relaxations.
    """

    lower: Array
    deployed: Array
    upper: Array
    generators: Array
    rest: Array


def bound_forms(policy: Policy, question: Question, low: Array, high: Array, backward: bool = True) -> FormBounds:
    """Bound the forms of a question over boxes.

    Parameters
    ----------
    policy : Policy
    question : Question
    low, high : array, shape (B, n)
    backward : bool
        Whether to ask the second enclosure too.

    Returns
    -------
    FormBounds
    """
    with np.errstate(invalid="ignore", over="ignore"):
        x = from_box(low, high)
        network = enclose_layers(policy.layers, x)
        v = linear_map(concatenate(x, network.output), _joined(question), balls.negate(question.bound))
        interval = v.interval
        lower = interval.lower
        if backward:
            # fmax: a bound that is not a number is none, and does not take the other one with it
            lower = np.fmax(lower, _backward(policy, question, x))
        moved = np.abs(v.generators[:, : x.dimension]).sum(1)
        return FormBounds(
            lower=lower,
            deployed=np.asarray(rounding.lower(lower, _runtime(policy, question, network))),
            upper=interval.upper,
            generators=v.generators[:, : x.dimension],
            rest=np.maximum(interval.rad - moved, 0.0),
        )


def _joined(question: Question) -> Ball:
    return balls.concatenate([question.inputs, question.outputs], -1)


def _runtime(policy: Policy, question: Question, network: NetworkEnclosure) -> Array:
    """How far the runtime's outputs can move the forms: ``|D| e_L``, shape (B, K)."""
    error = deployed_error(policy.layers, network.bounds, policy.precision)
    return np.asarray(rounding.enlarged(error @ question.outputs.magnitude.T, policy.outputs + 1))


def _backward(policy: Policy, question: Question, x: Zonotope) -> Array:
    """Lower bounds of the forms by backward substitution, shape (B, K)."""
    chain, _, _ = follow(policy.layers, x, usual)
    matrix, offset = chain.lower_functions(question.outputs.mid)
    # coefficients that are no floats: D y is off by rad(D) |y|
    uncertain = rounding.enlarged(chain.magnitude @ question.outputs.rad.T, policy.outputs + 1)
    bias = balls.subtract(Ball(offset.mid, rounding.enlarged(offset.rad + uncertain, 1)), question.bound)
    weight = balls.add(balls.exact(matrix), question.inputs)
    return linear_map(x, weight, bias).interval.lower


def influence(policy: Policy, question: Question) -> Array:
    """How much each input can move each form at most, up to the slopes of activations: |C| + |D| |W_L| ... |W_1|.

    Returns
    -------
    array, shape (K, n)
        Plain floats, for the choice of what to split.
    """
    total = np.abs(question.outputs.mid)
    for layer in reversed(policy.layers):
        if isinstance(layer, Affine):
            total = total @ np.abs(layer.weight)
    return np.asarray(total + np.abs(question.inputs.mid))
