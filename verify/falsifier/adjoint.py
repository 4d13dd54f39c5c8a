"""Reverse-mode derivatives of a tape on arrays: values forward, gradients backward. They steer a search; no proof."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

from ...models.float_algebra import FloatAlgebra, Floats
from ...models.tape import Tape

Partial: TypeAlias = Callable[[Floats, Floats, Sequence[Floats], Floats], Floats]
"""``gradient * d result / d operand`` from (gradient, result, operands, twin); the twin of sin x is cos x, and back."""

_PARTIALS: dict[str, tuple[Partial, ...]] = {
    "add": (lambda g, y, x, t: g, lambda g, y, x, t: g),
    "subtract": (lambda g, y, x, t: g, lambda g, y, x, t: -g),
    "multiply": (lambda g, y, x, t: g * x[1], lambda g, y, x, t: g * x[0]),
    "divide": (lambda g, y, x, t: g / x[1], lambda g, y, x, t: -g * y / x[1]),
    "negate": (lambda g, y, x, t: -g,),
    "square": (lambda g, y, x, t: 2.0 * g * x[0],),
    "sin": (lambda g, y, x, t: g * t,),
    "cos": (lambda g, y, x, t: -g * t,),
    "exp": (lambda g, y, x, t: g * y,),
    "log": (lambda g, y, x, t: g / x[0],),
    "sqrt": (lambda g, y, x, t: 0.5 * g / y,),
    "tanh": (lambda g, y, x, t: g * (1.0 - y * y),),
}


class TapeAdjoint:
    """A tape prepared for many evaluations with gradients.

    Every slot that depends on an input is an array over the batch; constants are Python floats and get no gradient.

    Parameters
    ----------
    tape : Tape
    """

    def __init__(self, tape: Tape) -> None:
        self.inputs = len(tape.inputs)
        self.outputs = tape.outputs
        algebra = FloatAlgebra()
        variable = [True] * self.inputs
        self.forward: list[tuple[str, Callable[..., Any], tuple[int, ...]]] = []
        for instruction in tape.instructions:
            operation, operands = instruction.operation, instruction.operands
            function: Callable[..., Any]
            if operation == "constant":
                number = float(instruction.value)  # type: ignore[arg-type]
                function = lambda number=number: number  # noqa: E731 (one value per instruction)
            else:
                function = getattr(algebra, "sincos" if operation in ("sin", "cos") else operation)
            self.forward.append((operation, function, operands))
            variable.append(any(variable[slot] for slot in operands))
        self.backward = [
            (
                self.inputs + index,
                operands,
                [(slot, p) for slot, p in zip(operands, _PARTIALS[operation], strict=True) if variable[slot]],
            )
            for index, (operation, _, operands) in reversed(list(enumerate(self.forward)))
            if variable[self.inputs + index]
        ]

    def values(self, inputs: Sequence[Floats]) -> tuple[list[Floats], dict[int, Floats]]:
        """Run the tape and keep what `pull` needs.

        Parameters
        ----------
        inputs : sequence of array, shape (N,)
            One per input slot.

        Returns
        -------
        list
            One value per slot; the tape's results are at `outputs`.
        dict
            By the slot of a sine its cosine, by the slot of a cosine its sine.
        """
        slots: list[Floats] = list(inputs)
        twins: dict[int, Floats] = {}
        pairs: dict[int, tuple[Floats, Floats]] = {}
        for operation, function, operands in self.forward:
            if operation == "sin" or operation == "cos":
                operand = operands[0]
                if operand not in pairs:
                    pairs[operand] = function(slots[operand])
                is_cosine = operation == "cos"
                twins[len(slots)] = pairs[operand][not is_cosine]
                slots.append(pairs[operand][is_cosine])
            else:
                slots.append(function(*[slots[slot] for slot in operands]))
        return slots, twins

    def pull(self, slots: Sequence[Floats], twins: dict[int, Floats], seeds: Sequence[Floats]) -> list[Floats | None]:
        """Vector-Jacobian product: the gradient of ``sum_i seed_i output_i`` in every input.

        Parameters
        ----------
        slots, twins
            What `values` returned.
        seeds : sequence of array, shape (N,)
            One per output.

        Returns
        -------
        list
            Per input slot an array of shape (N,), or None where no output depends on it.
        """
        gradient: list[Floats | None] = [None] * len(slots)
        for output, seed in zip(self.outputs, seeds, strict=True):
            before = gradient[output]
            gradient[output] = seed if before is None else before + seed
        for slot, operands, partials in self.backward:
            incoming = gradient[slot]
            if incoming is None:
                continue
            known = [slots[operand] for operand in operands]
            for operand, partial in partials:
                change = partial(incoming, slots[slot], known, twins.get(slot))
                before = gradient[operand]
                gradient[operand] = change if before is None else before + change
        return gradient[: self.inputs]
