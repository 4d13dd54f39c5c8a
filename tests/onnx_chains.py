"""Random chains of ONNX operators for tests, in the forms that their operator sets define."""

from __future__ import annotations

from typing import Any

import numpy as np
from onnx import TensorProto
from onnx_models import bytes_of


class Chain:
    """A random chain of operators on a value whose shape without the batch is known.

    In float64 the runtime has no Conv and no LeakyRelu, and Clip only from operator set 12 on.
    """

    def __init__(self, seed: int) -> None:
        self.generator = np.random.default_rng(seed)
        self.opset = int(self.generator.choice([8, 9, 10, 11, 12, 13, 17, 21]))
        self.double = bool(self.generator.integers(2))
        self.dtype = np.float64 if self.double else np.float32
        self.shape = tuple(int(size) for size in self.generator.integers(2, 5, size=self.generator.integers(1, 4)))
        self.start, self.value = self.shape, "x"
        self.nodes: list[Any] = []
        self.constants: dict[str, Any] = {}

    def stored(self, value: Any) -> str:
        name = f"c{len(self.constants)}"
        self.constants[name] = value
        return name

    def random(self, *shape: int) -> str:
        return self.stored(self.generator.normal(size=shape).astype(self.dtype))

    def emit(self, operator: str, *others: str, first: bool = True, **attributes: Any) -> str:
        name = f"v{len(self.nodes)}"
        inputs = [self.value, *others] if first else [*others, self.value]
        self.nodes.append((operator, inputs, name, attributes))
        return name

    def settings(self, since: int, **lists: list[int]) -> tuple[list[str], dict[str, Any]]:
        """Lists of integers, as attributes before an operator set and as operands from then on."""
        if self.opset < since:
            return [], lists
        return [self.stored(np.array(entries, dtype=np.int64)) for entries in lists.values()], {}

    def step(self) -> None:
        kind = self.generator.choice(["activation", "scaling", "product", "arrangement", "cut", "window"])
        getattr(self, str(kind))()

    def activation(self) -> None:
        low, high = sorted(float(np.float32(x)) for x in self.generator.normal(size=2))
        match int(self.generator.integers(6)):
            case 0 if not self.double:
                self.value = self.emit("LeakyRelu", alpha=abs(low))
            case 1 if self.opset < 11 and not self.double:
                self.value = self.emit("Clip", min=low)
            case 1 if self.opset >= 12:
                self.value = self.emit("Clip", self.stored(self.dtype(low)), self.stored(self.dtype(high)))
            case 2:
                shape = self.generator.choice(["number", "all"])
                bound = self.dtype(low) if shape == "number" else np.full((1, *self.shape), low, self.dtype)
                operator = str(self.generator.choice(["Max", "Min"]))
                self.value = self.emit(operator, self.stored(bound), first=bool(self.generator.integers(2)))
            case _:
                self.value = self.emit(str(self.generator.choice(["Relu", "Tanh", "Sigmoid"])))

    def scaling(self) -> None:
        operator = str(self.generator.choice(["Add", "Sub", "Mul", "Div", "Neg", "Identity", "Dropout"]))
        if operator in ("Neg", "Identity", "Dropout"):
            self.value = self.emit(operator)
            return
        ones = self.generator.integers(2, size=len(self.shape))
        shape = tuple(1 if one else size for one, size in zip(ones, self.shape, strict=True))
        kept = shape[self.generator.integers(len(shape) + 1) :]
        self.value = self.emit(
            operator, self.random(*kept), first=operator == "Div" or bool(self.generator.integers(2))
        )

    def product(self) -> None:
        count = int(self.generator.integers(1, 6))
        if self.generator.integers(2):
            self.value = self.emit("MatMul", self.random(self.shape[-1], count))
            self.shape = (*self.shape[:-1], count)
            if self.generator.integers(2):
                self.value = self.emit("Add", self.random(*self.shape))
            return
        self.value = self.emit("Flatten")
        size = int(np.prod(self.shape))
        flags = self.generator.integers(2, size=3)
        attributes = {"alpha": 0.3, "beta": -1.7} if flags[0] else {}
        matrix = self.random(count, size) if flags[1] else self.random(size, count)
        bias = self.random(count) if flags[2] or self.opset < 11 else ""
        self.value = self.emit("Gemm", matrix, bias, transB=int(flags[1]), **attributes)
        self.shape = (count,)

    def arrangement(self) -> None:
        match int(self.generator.integers(3)):
            case 0:
                order = [0, *(1 + self.generator.permutation(len(self.shape))).tolist()]
                self.value = self.emit("Transpose", perm=order)
                self.shape = tuple(self.shape[axis - 1] for axis in order[1:])
            case 1:
                self.shape = tuple(self.shape[::-1])
                self.value = self.emit("Reshape", self.stored(np.array([0, *self.shape[:-1], -1])))
            case _:
                axes = [1, 3][: self.generator.integers(1, 3)]
                operands, attributes = self.settings(13, axes=axes)
                self.value = self.emit("Unsqueeze", *operands, **attributes)
                operands, attributes = self.settings(13, axes=axes)
                self.value = self.emit("Squeeze", *operands, **attributes)

    def cut(self) -> None:
        """Parts along an axis, put together in another order and number."""
        axis = int(self.generator.integers(1, len(self.shape) + 1))
        size, low = self.shape[axis - 1], -(2**63)
        places = self.generator.integers(-size if self.opset >= 11 else 0, size, size=self.generator.integers(1, 4))
        parts = [self.emit("Gather", self.stored(places), axis=axis)]
        begin = int(self.generator.integers(size))
        operands, attributes = self.settings(10, starts=[begin - size], ends=[2**63 - 1], axes=[axis])
        parts.append(self.emit("Slice", *operands, **attributes))
        total = len(places) + size - begin
        if self.opset >= 10:
            backward = {"starts": [begin], "ends": [low], "axes": [axis], "steps": [-2]}
            parts.append(self.emit("Slice", *self.settings(10, **backward)[0]))
            total += begin // 2 + 1
        order = self.generator.permutation(len(parts))
        first, *rest = [parts[place] for place in order]
        self.value = first
        self.value = self.emit("Concat", *rest, axis=axis - 1 - len(self.shape) if self.opset >= 11 else axis)
        self.shape = (*self.shape[: axis - 1], total, *self.shape[axis:])

    def window(self) -> None:
        """A convolution of all axes but the first."""
        if self.double or len(self.shape) < 2 or np.prod(self.shape) > 200:
            return
        channels, *spatial = self.shape
        groups = channels if self.generator.integers(2) else 1
        outputs = groups * int(self.generator.integers(1, 3))
        kernel, strides, dilations = ([int(n) for n in self.generator.integers(1, 3, size=len(spatial))] for _ in "ksd")
        pads = [int(n) for n in self.generator.integers(0, 3, size=2 * len(spatial))]
        reach = [d * (k - 1) + 1 for d, k in zip(dilations, kernel, strict=True)]
        padded = [n + a + b for n, a, b in zip(spatial, pads, pads[len(spatial) :], strict=False)]
        if any(n < r for n, r in zip(padded, reach, strict=True)):
            return
        bias = [self.random(outputs)] if self.generator.integers(2) else []
        weights = self.random(outputs, channels // groups, *kernel)
        options: dict[str, Any] = {"strides": strides, "dilations": dilations, "pads": pads, "group": groups}
        self.value = self.emit("Conv", weights, *bias, **options)
        sizes = [(n - r) // s + 1 for n, r, s in zip(padded, reach, strides, strict=True)]
        self.shape = (outputs, *sizes)

    def content(self) -> bytes:
        self.nodes.append(("Flatten", [self.value], "y", {}))
        dtype = TensorProto.DOUBLE if self.double else TensorProto.FLOAT
        batch = "batch" if self.generator.integers(2) else 1
        return bytes_of(self.nodes, self.constants, shape=(batch, *self.start), dtype=dtype, opset=self.opset)


def random_chain(seed: int) -> Chain:
    """A chain of seven steps, one to three operators each."""
    chain = Chain(seed)
    for _ in range(7):
        chain.step()
    return chain
