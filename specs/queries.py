"""Questions about one network, as verifiers of networks take them: is there an input in a box whose output is bad?

A query is a *violation*: `sat` means that some input does it, `unsat` is the proof that none does.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from .specification import Bounds


@dataclass(frozen=True)
class LinearConstraint:
    """``sum_i inputs[i] x_i + sum_j outputs[j] y_j <= bound``, exact; entries that are not named are 0.

    Attributes
    ----------
    inputs, outputs : tuple of (index, coefficient)
        By ascending index, without zeros.
    bound : Fraction
    """

    inputs: tuple[tuple[int, Fraction], ...]
    outputs: tuple[tuple[int, Fraction], ...]
    bound: Fraction


@dataclass(frozen=True)
class Case:
    """One way to violate: the input is in the box and all constraints hold.

    Attributes
    ----------
    box : tuple of Bounds
        One entry per input, finite.
    constraints : tuple of LinearConstraint
    """

    box: tuple[Bounds, ...]
    constraints: tuple[LinearConstraint, ...]


@dataclass(frozen=True)
class Query:
    """A violation as a disjunction.

    Attributes
    ----------
    inputs, outputs : tuple of int
        Shapes of the network's input and output, the batch of one included.
    cases : tuple of Case
        The query is satisfied where one of them is; without cases it is `unsat`.
    comment : str
        What is asked, for people; may have several lines.
    """

    inputs: tuple[int, ...]
    outputs: tuple[int, ...]
    cases: tuple[Case, ...]
    comment: str = ""
