"""The ONNX operators that are checkable, each in the form that its operator set defines, as layers."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from .affine import arithmetic, convolve, gemm, matmul, negation
from .layers import Activation
from .movements import MAX_NUMBERS, MOVEMENTS, axis_of, joined
from .onnx_file import KINDS, Array, Node
from .signals import Operands, Signal, Value, pair, refusal, signal_of, signal_operand, spread


def apply_operator(node: Node, operands: Operands) -> Value:
    """What an operator computes from its operands, None for one that is left out.

    Raises
    ------
    PolicyError
        The operator, its form in this operator set or this use of it is not checkable.
    """
    form = next((form for form in reversed(_FORMS.get(node.operator, ())) if form.since <= node.opset), None)
    if form is None:
        raise refusal(node, f"is not known in operator set {node.opset}")
    if not form.least <= len(operands) <= form.most or None in operands[: form.least]:
        raise refusal(node, f"has {len(operands)} operands")
    for name, value in node.attributes.items():
        if form.attributes.get(name) is not type(value):
            raise refusal(node, f"has an unknown attribute {name[:60]!r}")
    if node.operator in MOVEMENTS:
        return _move(node, operands)
    return _HANDLERS[node.operator](node, operands)


def _move(node: Node, operands: Operands) -> Value:
    first, *rest = operands
    settings = [value for value in rest if not isinstance(value, Signal)]
    if first is None or len(settings) != len(rest):
        raise refusal(node, "moves numbers to places that depend on the observation")
    shape, places = MOVEMENTS[node.operator](node, settings, first.shape)
    if isinstance(first, Array):
        return Array(first.kind, shape, first.numbers if places is None else tuple(first.numbers[p] for p in places))
    moved = replace(first, shape=shape, index=first.index if places is None else tuple(first.index[p] for p in places))
    if not moved.index:
        raise refusal(node, "leaves no values")
    return moved


def _activated(signal: Signal, activation: Activation) -> Signal:
    return signal_of(signal.kind, signal.shape, (*signal.settled, activation))


def _activation(node: Node, operands: Operands) -> Signal:
    kinds = {"Relu": "relu", "LeakyRelu": "leaky_relu", "Tanh": "tanh", "Sigmoid": "sigmoid"}
    slope = 0.0
    if node.operator == "LeakyRelu":
        slope = node.attributes.get("alpha", _as_float32(0.01))
        if not 0.0 <= slope < math.inf:
            raise refusal(node, f"has slope {slope}")
    return _activated(signal_operand(node, operands[0]), Activation(kinds[node.operator], slope=slope))


def _as_float32(value: float) -> float:
    """The nearest float32 number; OverflowError where there is none."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def _clip(node: Node, operands: Operands) -> Signal:
    """A bound that is left out is the type's largest number, which no number of that type exceeds: none."""
    signal = signal_operand(node, operands[0])
    bounds = [node.attributes.get("min", -math.inf), node.attributes.get("max", math.inf)]
    for position, operand in enumerate(operands[1:]):
        if operand is None:
            continue
        if not isinstance(operand, Array) or operand.kind != signal.kind or operand.shape not in ((), (1,)):
            raise refusal(node, "has a bound that is not one constant of the right type")
        bounds[position] = operand.numbers[0]
    return _bounded(node, signal, *bounds)


def _extremum(node: Node, operands: Operands) -> Signal:
    """Max and Min of a signal and one number, possibly stored once per component."""
    signal, constant, _ = pair(node, operands)
    if not isinstance(constant, Array) or constant.kind != signal.kind:
        raise refusal(node, "combines something else than a signal and a constant of its type")
    if node.opset < 8 and constant.shape != signal.shape:
        raise refusal(node, "spreads a constant, which it cannot in this operator set")
    numbers = set(spread(constant, signal.shape))
    if len(numbers) != 1:
        raise refusal(node, "has different bounds for different components")
    bound = numbers.pop()
    low, high = (bound, math.inf) if node.operator == "Max" else (-math.inf, bound)
    return _bounded(node, signal, low, high)


def _bounded(node: Node, signal: Signal, low: float, high: float) -> Signal:
    if not low <= high or low == math.inf or high == -math.inf:
        raise refusal(node, f"clips to [{low}, {high}]")
    return _activated(signal, Activation("clip", low=low, high=high))


def _concat(node: Node, operands: Operands) -> Value:
    """Of constants, or of parts of one value: then it moves numbers and computes nothing."""
    first = operands[0]
    if first is None or "axis" not in node.attributes:
        raise refusal(node, "has no axis")
    axis = axis_of(node, node.attributes["axis"], len(first.shape))
    arrays = [value for value in operands if isinstance(value, Array)]
    signals = [value for value in operands if isinstance(value, Signal)]
    values: Sequence[Value] = arrays or signals
    if len(values) != len(operands) or any(value.kind != first.kind for value in values):
        raise refusal(node, "joins values of different types")
    if any(len(value.shape) != len(first.shape) for value in values):
        raise refusal(node, "joins values of different ranks")
    shapes = [value.shape for value in values]
    if isinstance(first, Array):
        return Array(first.kind, *joined(shapes, [value.numbers for value in arrays], axis))
    if any(value.layers is not first.layers for value in signals):
        raise refusal(node, "joins the results of different computations")
    shape, index = joined(shapes, [value.index for value in signals], axis)
    return replace(first, shape=shape, index=index)


def _cast(node: Node, operands: Operands) -> Value:
    """A conversion that changes no number; narrowing the observation itself is what a deployed network does anyway."""
    value, kind = operands[0], KINDS.get(node.attributes.get("to", 0), "")
    if value is None or kind not in ("float32", "float64", "int32", "int64"):
        raise refusal(node, "converts to an unknown type")
    if isinstance(value, Signal):
        if not kind.startswith("float") or (value.kind == "float64" and kind == "float32" and value.layers):
            raise refusal(node, "rounds what was computed")
        return replace(value, kind=kind)
    return Array(kind, value.shape, tuple(_converted(node, number, kind) for number in value.numbers))


def _converted(node: Node, number: float, kind: str) -> float:
    try:
        if kind.startswith("float"):
            result: float = _as_float32(number) if kind == "float32" else float(number)
        else:
            result = int(number)
            struct.pack("<i" if kind == "int32" else "<q", result)
    except (OverflowError, ValueError, struct.error) as error:
        raise refusal(node, f"cannot turn {number} into {kind}") from error
    if result != number:
        raise refusal(node, f"rounds {number} to {kind}")
    return result


def _dropout(node: Node, operands: Operands) -> Signal:
    training = operands[2] if len(operands) > 2 else None
    if any(isinstance(value, Signal) for value in operands[1:]):
        raise refusal(node, "has settings that depend on the observation")
    if isinstance(training, Array) and (training.kind != "bool" or any(training.numbers)):
        raise refusal(node, "is in training mode")
    return signal_operand(node, operands[0])


def _stored(node: Node, operands: Operands) -> Array:
    if len(node.attributes) != 1:
        raise refusal(node, "needs exactly one value")
    (value,) = node.attributes.values()
    if isinstance(value, Array):
        return value
    return Array("float32" if isinstance(value, float) else "int64", (), (value,))


def _shape(node: Node, operands: Operands) -> Array:
    value = operands[0]
    if value is None:
        raise refusal(node, "has no operand")
    return Array("int64", (len(value.shape),), value.shape)


@dataclass(frozen=True)
class _Form:
    """How an operator is written from an operator set on: how many operands, and the types of its attributes."""

    since: int
    least: int
    most: int
    attributes: Mapping[str, type]


def _simple(operands: int, since: int = 6, **attributes: type) -> tuple[_Form, ...]:
    return (_Form(since, operands, operands, attributes),)


_AXES, _GEMM = {"axes": Array}, {"alpha": float, "beta": float, "transA": int, "transB": int}
_WINDOW = {"auto_pad": bytes, "group": int} | dict.fromkeys(("dilations", "kernel_shape", "pads", "strides"), Array)
_SCALARS = {"value_float": float, "value_floats": Array, "value_int": int, "value_ints": Array}
_MOVEMENT_FORMS = {
    "Reshape": (_Form(6, 2, 2, {}), _Form(14, 2, 2, {"allowzero": int})),
    "Flatten": _simple(1, axis=int),
    "Squeeze": (_Form(6, 1, 1, _AXES), _Form(13, 1, 2, {})),
    "Unsqueeze": (_Form(6, 1, 1, _AXES), _Form(13, 2, 2, {})),
    "Transpose": _simple(1, perm=Array),
    "Slice": (_Form(6, 1, 1, _AXES | {"starts": Array, "ends": Array}), _Form(10, 3, 5, {})),
    "Gather": _simple(2, axis=int),
    "Identity": _simple(1),
}
# before operator set 7 these spread their operands by rules of their own, and Dropout was in training mode by default
_FORMS: dict[str, tuple[_Form, ...]] = {
    **_MOVEMENT_FORMS,
    **{name: _simple(2, since=7) for name in ("Add", "Sub", "Mul", "Div")},
    **{name: _simple(1) for name in ("Neg", "Relu", "Tanh", "Sigmoid")},
    "Gemm": (_Form(7, 3, 3, _GEMM), _Form(11, 2, 3, _GEMM)),
    "Dropout": (_Form(7, 1, 1, {"ratio": float}), _Form(12, 1, 3, {"seed": int})),
    "MatMul": _simple(2),
    "Conv": (_Form(6, 2, 3, _WINDOW),),
    "LeakyRelu": _simple(1, alpha=float),
    "Clip": (_Form(6, 1, 1, {"min": float, "max": float}), _Form(11, 1, 3, {})),
    "Max": _simple(2),
    "Min": _simple(2),
    "Concat": (_Form(6, 1, MAX_NUMBERS, {"axis": int}),),
    "Cast": (_Form(6, 1, 1, {"to": int}), _Form(19, 1, 1, {"to": int, "saturate": int})),
    "Constant": (_Form(6, 0, 0, {"value": Array}), _Form(12, 0, 0, {"value": Array, **_SCALARS})),
    "Shape": _simple(1),
}
_HANDLERS: dict[str, Callable[[Node, Operands], Value]] = {
    **{name: arithmetic for name in ("Add", "Sub", "Mul", "Div")},
    **{name: _activation for name in ("Relu", "LeakyRelu", "Tanh", "Sigmoid")},
    "Neg": negation,
    "MatMul": matmul,
    "Gemm": gemm,
    "Conv": convolve,
    "Clip": _clip,
    "Max": _extremum,
    "Min": _extremum,
    "Concat": _concat,
    "Cast": _cast,
    "Dropout": _dropout,
    "Constant": _stored,
    "Shape": _shape,
}
