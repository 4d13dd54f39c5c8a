"""The ONNX operators a policy may consist of, each as layers with exactly the file's numbers.

Nothing is composed: a layer that were the product of two stored matrices would be another network in the last bits.
Where a stored number times another one is not a float64, the layer carries the error bound of what it stores.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np

from . import onnx_convolution
from .onnx_graph import Array, Node
from .onnx_movement import MAX_RANK, MOVEMENTS
from .onnx_values import (
    Signal,
    Unsupported,
    Value,
    apply_activation,
    apply_matrix,
    apply_scaling,
    exact_product,
    moved,
    new_signal,
    reciprocal,
    require_matrix,
    require_size,
    spread,
)
from .policy import Activation, Affine, FloatArray

Handler: TypeAlias = Callable[[Node, Sequence[Value | None]], Value]


def supported_operators() -> tuple[str, ...]:
    """Names of all operators that are understood, sorted."""
    return tuple(sorted({*MOVEMENTS, *_HANDLERS}))


def apply_operator(node: Node, operands: Sequence[Value | None]) -> Value:
    """The first output of an operator; missing optional inputs are None.

    Raises
    ------
    Unsupported
        The operator, one of its attributes or this use of it is not understood.
    """
    entry = MOVEMENTS.get(node.operator) or _HANDLERS.get(node.operator)
    if entry is None:
        raise Unsupported("is not a supported operator")
    _require_attributes(node, entry[1])
    if len(operands) < _LEAST_OPERANDS.get(node.operator, 1):
        raise Unsupported(f"has {len(operands)} operands, too few")
    if node.operator in _HANDLERS:
        return _HANDLERS[node.operator][0](node, operands)
    return _move(node, operands)


def _require_attributes(node: Node, known: frozenset[str]) -> None:
    unknown = sorted(set(node.attributes) - known)
    if unknown:
        raise Unsupported(f"has unsupported attributes: {', '.join(unknown)}")
    for key, value in node.attributes.items():
        kind = _ATTRIBUTE_TYPES.get(key)
        entries = value if isinstance(value, (list, tuple)) and key in _LISTS else [value]
        if kind is not None and not all(isinstance(entry, kind) for entry in entries):
            raise Unsupported(f"has an attribute {key} of the wrong type")
    if abs(node.attributes.get("axis", 0)) > MAX_RANK:
        raise Unsupported(f"has axis {node.attributes['axis']}")


def _move(node: Node, operands: Sequence[Value | None]) -> Value:
    first, *rest = operands
    if any(isinstance(operand, Signal) for operand in rest):
        raise Unsupported("needs constants for everything but the values it moves")
    settings = [None, *(operand for operand in rest if not isinstance(operand, Signal))]
    movement = MOVEMENTS[node.operator][0]
    if isinstance(first, Signal):
        return moved(first, movement(node, settings, first.index))
    if first is None:
        raise Unsupported("has no input")
    return movement(node, settings, first)


def _signal(node: Node, operands: Sequence[Value | None]) -> Signal:
    if not isinstance(operands[0], Signal):
        raise Unsupported("is arithmetic on constants; simplify the model before exporting it")
    return operands[0]


def _signal_and_constant(operands: Sequence[Value | None]) -> tuple[Signal, Array, bool]:
    """The two operands of a binary operator, and whether the signal is the first."""
    signals = [operand for operand in operands if isinstance(operand, Signal)]
    constants = [operand for operand in operands if isinstance(operand, np.ndarray)]
    if len(signals) > 1:
        raise Unsupported("joins two activations (a skip connection); only chains of layers are supported")
    if len(operands) != 2:
        raise Unsupported(f"has {len(operands)} operands; two are supported")
    if not signals or not constants:
        raise Unsupported("is arithmetic on constants; simplify the model before exporting it")
    return signals[0], constants[0], isinstance(operands[0], Signal)


def _add(node: Node, operands: Sequence[Value | None]) -> Signal:
    signal, constant, first = _signal_and_constant(operands)
    offset = spread(constant, signal)
    scale = np.ones(signal.size)
    if node.operator == "Sub":
        offset, scale = (-offset, scale) if first else (offset, -scale)
    product = signal.layers[-1] if signal.layers else None
    if node.operator == "Add" and signal.open_bias and isinstance(product, Affine):
        layers = (*signal.layers[:-1], Affine(product.weight, offset, product.weight_error))
        return new_signal(layers, signal.shape, signal.batched, signal.dtype)
    return apply_scaling(signal, scale, offset, (None, None))


def _multiply(node: Node, operands: Sequence[Value | None]) -> Signal:
    signal, constant, _ = _signal_and_constant(operands)
    return apply_scaling(signal, spread(constant, signal), np.zeros(signal.size), (None, None))


def _divide(node: Node, operands: Sequence[Value | None]) -> Signal:
    signal, constant, first = _signal_and_constant(operands)
    if not first:
        raise Unsupported("divides by an activation")
    scale, error = reciprocal(spread(constant, signal))
    return apply_scaling(signal, scale, np.zeros(signal.size), (error, None))


def _negate(node: Node, operands: Sequence[Value | None]) -> Signal:
    signal = _signal(node, operands)
    return apply_scaling(signal, -np.ones(signal.size), np.zeros(signal.size), (None, None))


def _weights(value: Value | None, name: str) -> FloatArray:
    if not isinstance(value, np.ndarray) or value.dtype.kind != "f":
        raise Unsupported(f"needs a constant floating-point {name}")
    return value.astype(np.float64)


def _matmul(node: Node, operands: Sequence[Value | None]) -> Signal:
    if all(isinstance(operand, Signal) for operand in operands):
        raise Unsupported("multiplies two activations")
    if not isinstance(operands[0], Signal):
        raise Unsupported("has its weights on the left; export x @ W with the weights on the right")
    signal, weight = operands[0], _weights(operands[1], "matrix")
    shape = signal.shape
    if not shape or weight.ndim not in (1, 2) or weight.shape[0] != shape[-1]:
        raise Unsupported(f"has values of shape {shape} and a matrix of shape {weight.shape}")
    columns = weight.reshape(shape[-1], -1)
    lead = signal.size // shape[-1]
    require_matrix(lead * columns.shape[1], signal.size)
    matrix = np.kron(np.eye(lead), columns.T)
    result = (*shape[:-1], *weight.shape[1:])
    return apply_matrix(signal, matrix, np.zeros(len(matrix)), result, bare=True)


def _power_of_two(value: float) -> bool:
    return abs(float(np.frexp(value)[0])) == 0.5


def _gemm(node: Node, operands: Sequence[Value | None]) -> Signal:
    """``alpha x W + beta C``; a factor is folded into the layer only where that changes neither the numbers nor their
    rounding, that is for powers of two; else it is a layer of its own.
    """
    signal = _signal(node, operands)
    if node.attributes.get("transA", 0):
        raise Unsupported("transposes its activations (transA)")
    if signal.index.ndim != 2 or (not signal.batched and signal.index.shape[0] != 1):
        raise Unsupported(f"needs values of shape (batch, n), received {signal.shape}")
    weight = _weights(operands[1], "matrix")
    matrix = weight if node.attributes.get("transB", 0) else weight.T
    if weight.ndim != 2 or matrix.shape[1] != signal.size:
        raise Unsupported(f"has {signal.size} values and a matrix of shape {weight.shape}")
    alpha, beta = float(node.attributes.get("alpha", 1.0)), float(node.attributes.get("beta", 1.0))
    if not (np.isfinite(alpha) and np.isfinite(beta)):
        raise Unsupported("has a factor that is not finite")
    count = matrix.shape[0]
    shape = (count,) if signal.batched else (1, count)
    like = new_signal((), shape, signal.batched, signal.dtype)
    offset = np.zeros(count)
    if len(operands) > 2 and operands[2] is not None:
        offset = spread(_weights(operands[2], "bias"), like)
    if _power_of_two(alpha) and _power_of_two(beta) and (alpha == beta == 1.0 or signal.dtype == np.float32):
        return apply_matrix(signal, np.asarray(alpha * matrix), beta * offset, shape, bare=False)
    bare = apply_matrix(signal, matrix, np.zeros(count), shape, bare=False)
    scaled, error = exact_product(offset, beta)
    return apply_scaling(bare, np.full(count, alpha), scaled, (None, error))


def _activation(node: Node, operands: Sequence[Value | None]) -> Signal:
    slope = float(node.attributes.get("alpha", np.float32(0.01))) if node.operator == "LeakyRelu" else 0.0
    kinds = {"Relu": "relu", "LeakyRelu": "leaky_relu", "Tanh": "tanh", "Sigmoid": "sigmoid"}
    if not 0.0 <= slope < np.inf:
        raise Unsupported(f"has slope {slope}; a finite slope >= 0 is required")
    return apply_activation(_signal(node, operands), Activation(kinds[node.operator], slope=slope))


def _uniform(value: Value | None, otherwise: float) -> float:
    if value is None:
        return otherwise
    if isinstance(value, Signal) or value.dtype.kind != "f" or value.size == 0 or (value != value.flat[0]).any():
        raise Unsupported("needs one constant bound for all neurons")
    return float(value.flat[0])


def _clip(node: Node, operands: Sequence[Value | None]) -> Signal:
    signal = _signal(node, operands)
    bounds = [*operands[1:], None, None]
    lower = _uniform(bounds[0], float(node.attributes.get("min", -np.inf)))
    upper = _uniform(bounds[1], float(node.attributes.get("max", np.inf)))
    return _clipped(signal, lower, upper)


def _one_sided(node: Node, operands: Sequence[Value | None]) -> Signal:
    signal, constant, _ = _signal_and_constant(operands)
    spread(constant, signal)
    bound = _uniform(constant, 0.0)
    return _clipped(signal, bound, np.inf) if node.operator == "Max" else _clipped(signal, -np.inf, bound)


def _clipped(signal: Signal, lower: float, upper: float) -> Signal:
    if not lower <= upper or lower == np.inf or upper == -np.inf:
        raise Unsupported(f"clips to [{lower}, {upper}], which is empty or not finite")
    return apply_activation(signal, Activation("clip", lower=lower, upper=upper))


def _concat(node: Node, operands: Sequence[Value | None]) -> Value:
    axis = int(node.attributes.get("axis", 1))
    arrays = [operand for operand in operands if isinstance(operand, np.ndarray)]
    signals = [operand for operand in operands if isinstance(operand, Signal)]
    require_size(sum(array.size for array in arrays) + sum(signal.index.size for signal in signals))
    try:
        if not signals:
            return np.concatenate(arrays, axis=axis)
        if arrays or any(signal.layers is not signals[0].layers for signal in signals):
            raise Unsupported("joins different activations; only parts of one activation may be joined")
        return moved(signals[0], np.concatenate([signal.index for signal in signals], axis=axis))
    except ValueError:
        raise Unsupported("joins arrays whose shapes do not fit") from None


def _cast(node: Node, operands: Sequence[Value | None]) -> Value:
    import onnx

    value, target = operands[0], int(node.attributes.get("to", 0))
    names = onnx.TensorProto
    types: dict[int, np.dtype[Any]] = {names.FLOAT: np.dtype(np.float32), names.DOUBLE: np.dtype(np.float64)}
    types |= {names.INT64: np.dtype(np.int64), names.INT32: np.dtype(np.int32)}
    if target not in types:
        raise Unsupported("casts to a type other than float32, float64, int32 and int64")
    dtype = types[target]
    if isinstance(value, np.ndarray):
        with np.errstate(over="ignore", invalid="ignore"):
            result: Array = value.astype(dtype)
        if not (result == value).all():
            raise Unsupported("rounds a constant")
        return result
    signal = _signal(node, operands)
    if dtype.kind != "f" or (dtype.itemsize < signal.dtype.itemsize and signal.layers):
        raise Unsupported("rounds an activation; casting to a narrower type is supported at the input only")
    return Signal(signal.layers, signal.width, signal.index, signal.batched, dtype, signal.open_bias)


def _dropout(node: Node, operands: Sequence[Value | None]) -> Signal:
    training = operands[2] if len(operands) > 2 else None
    if isinstance(training, Signal) or (training is not None and training.any()):
        raise Unsupported("is in training mode")
    if not node.attributes.get("is_test", 1) or (len(node.outputs) > 1 and node.outputs[1]):
        raise Unsupported("is in training mode or its mask is an output")
    return _signal(node, operands)


def _constant(node: Node, operands: Sequence[Value | None]) -> Array:
    if len(node.attributes) != 1:
        raise Unsupported("needs exactly one value")
    ((key, value),) = node.attributes.items()
    if key == "value":
        return np.asarray(value)
    return np.asarray(value, dtype=np.float32 if key.startswith("value_float") else np.int64)


def _shape(node: Node, operands: Sequence[Value | None]) -> Array:
    value = operands[0]
    if isinstance(value, Signal) and value.batched:
        raise Unsupported("depends on the dynamic batch; export with a batch of one")
    array = value.index if isinstance(value, Signal) else np.asarray(value)
    return np.asarray(array.shape, dtype=np.int64)


_LISTS = frozenset({"shape", "axes", "perm", "starts", "ends", "pads", "strides", "dilations", "kernel_shape"})
_ATTRIBUTE_TYPES: dict[str, type | tuple[type, ...]] = {
    **dict.fromkeys((*_LISTS, "axis", "allowzero", "transA", "transB", "group", "to", "broadcast"), int),
    **dict.fromkeys(("alpha", "beta", "min", "max"), float),
    "auto_pad": str,
    "value": np.ndarray,
}
_LEAST_OPERANDS = {"Constant": 0, **dict.fromkeys(("Add", "Sub", "Mul", "Div", "MatMul", "Gemm", "Conv", "Gather"), 2)}
_BROADCAST = frozenset({"broadcast"})
_HANDLERS: dict[str, tuple[Handler, frozenset[str]]] = {
    "Add": (_add, _BROADCAST),
    "Sub": (_add, _BROADCAST),
    "Mul": (_multiply, _BROADCAST),
    "Div": (_divide, _BROADCAST),
    "Neg": (_negate, frozenset()),
    "MatMul": (_matmul, frozenset()),
    "Gemm": (_gemm, frozenset({"alpha", "beta", "transA", "transB", "broadcast"})),
    "Conv": (onnx_convolution.convolve, onnx_convolution.ATTRIBUTES),
    "Relu": (_activation, frozenset()),
    "LeakyRelu": (_activation, frozenset({"alpha"})),
    "Tanh": (_activation, frozenset()),
    "Sigmoid": (_activation, frozenset()),
    "Clip": (_clip, frozenset({"min", "max"})),
    "Max": (_one_sided, frozenset()),
    "Min": (_one_sided, frozenset()),
    "Concat": (_concat, frozenset({"axis"})),
    "Cast": (_cast, frozenset({"to", "saturate"})),
    "Dropout": (_dropout, frozenset({"ratio", "seed", "is_test"})),
    "Constant": (_constant, frozenset({"value", "value_float", "value_floats", "value_int", "value_ints"})),
    "Shape": (_shape, frozenset()),
}
"""Operator to (handler, attributes that are understood)."""
