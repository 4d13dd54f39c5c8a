"""The network obligation: the claimed set of actions contains what the policy computes on the claimed set of states.

The observation is o_c + the tracked set's rows and a few private ones; the policy is followed as an affine form

    y = M (o - o_c) + c + sum_k P_k e_k,      e_k the residuals of the activations, each neuron's own factor,

with the slopes of the certificate, whoever chose them. What that form leaves between itself and the claimed rows, row
by row, has to fit into the claimed box.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from flint import arb, arb_mat

from .activation import clip_residual, residual
from .contract import AffineMap, Contract
from .deployment import Deployment, absolute_matrix
from .image import Start, image_of
from .layers import Activation, Dense, Diagonal, Layer, Selection, apply
from .layout import Layout, observation_program
from .leaf import BOX, CLIPPED, NEURON, PERTURBATION, PRODUCT, ActionClaim, Floats, Lines, PeriodClaim
from .network import Network
from .program import Program, ball
from .rejection import Rejected, require_within

Vector: TypeAlias = list[Any]


@dataclass(frozen=True)
class Policy:
    """Everything between the states and the action, prepared once per certificate.

    Attributes
    ----------
    layers : tuple of Layer
        The map before the network, the network, the map after it.
    observe : Program
    radius : list of balls
        Of the observation's perturbation.
    bounds : list of (low, high), balls
        Of every action where actions are clipped.
    deployment : Deployment or None
        Error bounds of the deployed semantics, where it is claimed.
    layout : Layout
    """

    layers: tuple[Layer, ...]
    observe: Program
    radius: Vector
    bounds: list[tuple[Any, Any]]
    deployment: Deployment | None
    layout: Layout

    @classmethod
    def of(cls, contract: Contract, network: Network, layout: Layout, runtime: Any) -> Policy:
        """Prepare; `runtime` is the error of the runtime's own tanh and sigmoid, None without deployed semantics."""
        before = [] if contract.before is None else [_dense(contract.before)]
        after = [] if contract.after is None else [_dense(contract.after)]
        clip = tuple(pair for pair in contract.clip if pair is not None)
        return cls(
            (*before, *network.layers, *after),
            observation_program(contract),
            [ball(radius) for radius in contract.radius],
            [(ball(low), ball(high)) for low, high in clip],
            None if runtime is None else Deployment(network.precision, runtime, clip),
            layout,
        )


def _dense(affine: AffineMap) -> Dense:
    return Dense(affine.matrix, affine.offset)


@dataclass(frozen=True)
class _Part:
    """Rows of one activation's residuals: ``matrix diag(size)``, None for the identity; `layer` has it as its own."""

    matrix: Any
    size: Vector
    layer: Dense | None = None


@dataclass(frozen=True)
class _Seen:
    """The observation: center, rows (o x q matrix, shared first), and half-widths of rows of one component each."""

    center: Vector
    rows: Any
    shared: int
    box: Vector
    noise: Vector


class _Form:
    """The affine form behind the layers so far."""

    def __init__(self, seen: _Seen) -> None:
        self.seen = seen
        self.center = seen.center
        self.map: Any = None  # None is the identity
        self.parts: list[_Part] = []
        self.slopes: Vector | None = None
        """Of the last activation: still to be applied to `map` and to all parts but the last."""

    def dense(self, layer: Dense) -> None:
        matrix = product = layer.arb_matrix
        rows, size = len(layer.offset), len(self.center)
        moved = (matrix * arb_mat(size, 1, self.center)).entries()
        self.center = [y + b for y, b in zip(moved, layer.arb_offset, strict=True)]
        if self.slopes is not None:  # on the rows of what is there, or on the columns of the layer: what is less work
            waiting = self.map.ncols() + sum(part.matrix.ncols() for part in self.parts[:-1])
            if waiting < rows:
                self._apply_slopes()
            else:
                columns = [w * s for row in matrix.tolist() for w, s in zip(row, self.slopes, strict=True)]
                product, self.slopes = arb_mat(rows, size, columns), None
        self.map = product if self.map is None else product * self.map
        self.parts = [
            _Part(matrix, part.size, layer) if part.matrix is None else _Part(product * part.matrix, part.size)
            for part in self.parts
        ]

    def _apply_slopes(self) -> None:
        if self.slopes is not None:
            *earlier, last = self.parts
            self.map = _scaled(self.map, self.slopes)
            self.parts = [*(_Part(_scaled(part.matrix, self.slopes), part.size) for part in earlier), last]
            self.slopes = None

    def settle(self) -> None:
        """Apply the slopes that wait, and give every matrix its entries."""
        self._apply_slopes()
        if self.map is None:
            self.map = _identity(len(self.center))
        self.parts = [
            replace(part, matrix=_identity(len(self.center))) if part.matrix is None else part for part in self.parts
        ]

    def diagonal(self, layer: Diagonal) -> None:
        self.settle()
        self.center = [s * c + b for s, c, b in zip(layer.arb_scale, self.center, layer.arb_offset, strict=True)]
        if any(scale != 1 for scale in layer.scale):
            self.map = _scaled(self.map, layer.arb_scale)
            self.parts = [_Part(_scaled(part.matrix, layer.arb_scale), part.size) for part in self.parts]

    def select(self, layer: Selection) -> None:
        self.settle()
        self.center = [self.center[i] for i in layer.index]
        self.map = _selected(self.map, layer.index)
        self.parts = [_Part(_selected(part.matrix, layer.index), part.size) for part in self.parts]

    def bounds(self) -> tuple[Vector, Vector]:
        """Ends of the enclosing interval; slopes must not wait."""
        seen, count = self.seen, len(self.center)
        if self.map is None:
            spread = [sum(map(abs, row), arb(0)) for row in seen.rows.tolist()]
            spread = [a + b + e for a, b, e in zip(spread, seen.box, seen.noise, strict=True)]
        else:
            width = seen.rows.ncols()
            entries = (self.map * seen.rows).entries() if width else []
            spread = [sum(map(abs, entries[i * width : (i + 1) * width]), arb(0)) for i in range(count)]
            own = [b + e for b, e in zip(seen.box, seen.noise, strict=True)]
            if any(not bool(x.is_zero()) for x in own):
                table = self.map.tolist()
                spread = [a + _weighted(row, own) for a, row in zip(spread, table, strict=True)]
        for part in self.parts:
            if part.matrix is None:
                spread = [a + e for a, e in zip(spread, part.size, strict=True)]
            elif part.layer is not None:
                more = (absolute_matrix(part.layer) * arb_mat(len(part.size), 1, part.size)).entries()
                spread = [a + b for a, b in zip(spread, more, strict=True)]
            else:
                spread = [a + _weighted(row, part.size) for a, row in zip(spread, part.matrix.tolist(), strict=True)]
        low = [c - s for c, s in zip(self.center, spread, strict=True)]
        return low, [c + s for c, s in zip(self.center, spread, strict=True)]

    def activate(self, activation: Activation, lines: Lines, low: Vector, high: Vector) -> None:
        """Follow an activation of every component; its residuals become a part of their own."""
        self._apply_slopes()
        center, size = [], []
        for i, (slope, c, a, b) in enumerate(zip(lines.slopes, self.center, low, high, strict=True)):
            least, most = residual(activation, slope, a, b)
            if lines.offsets is not None and lines.errors is not None:
                offset, error = arb(lines.offsets[i]), arb(lines.errors[i])
                if not (bool(offset - error <= least) and bool(most <= offset + error)):
                    raise Rejected(f"the line of neuron {i} of a {activation.kind} is not proved")
                least, most = offset - error, offset + error
            center.append(slope * c + (least + most) / 2)
            size.append(arb(0) if bool(least == 0) and bool(most == 0) else (most - least) / 2)
        self.center = center
        if self.map is None:
            self.settle()
        self.slopes = [arb(slope) for slope in lines.slopes]
        self.parts = [*self.parts, _Part(None, size)]


def _identity(size: int) -> Any:
    return arb_mat(size, size, [arb(int(i == j)) for i in range(size) for j in range(size)])


def _weighted(row: Vector, size: Vector) -> Any:
    return sum((abs(x) * e for x, e in zip(row, size, strict=True) if not e.is_zero()), arb(0))


def _scaled(matrix: Any, factors: Vector) -> Any:
    entries = [x * s for row, s in zip(matrix.tolist(), factors, strict=True) for x in row]
    return arb_mat(matrix.nrows(), matrix.ncols(), entries)


def _selected(matrix: Any, index: tuple[int, ...]) -> Any:
    table = matrix.tolist()
    return arb_mat(len(index), matrix.ncols(), [x for i in index for x in table[i]])


def check_action(policy: Policy, states: Start, claim: PeriodClaim, what: str) -> None:
    """Require that a period's claimed set of actions contains what the policy computes on a set of states.

    Parameters
    ----------
    policy : Policy
    states : Start
        The tracked set's states; no boxed part.
    claim : PeriodClaim
    what : str
        Where, for the message.

    Raises
    ------
    Rejected
    """
    layout, deployment = policy.layout, policy.deployment
    form = _Form(_observe(policy, states, claim))
    error: Vector | None = None
    magnitude: Vector = []
    if deployment is not None:
        magnitude = _magnitude(*form.bounds())
        error = deployment.start(magnitude)
    known = True  # whether `magnitude` is the one of the layer's input
    lines = iter(claim.lines)
    for layer in policy.layers:
        if isinstance(layer, Activation):
            if form.slopes is not None:
                form.settle()
            low, high = form.bounds()
            if deployment is not None and error is not None:
                error = deployment.activated(layer, low, high, error)
                magnitude, known = _range(layer, low, high), True
            form.activate(layer, next(lines), low, high)
            continue
        if deployment is not None and error is not None:
            if not known:
                if form.slopes is not None:
                    form.settle()
                magnitude = _magnitude(*form.bounds())
            error = deployment.through(layer, magnitude, error)
            known = False
        match layer:
            case Dense():
                form.dense(layer)
            case Diagonal():
                form.diagonal(layer)
            case Selection():
                form.select(layer)
    loose = [arb(0)] * layout.inputs if error is None else error
    if claim.clip_slopes is not None:
        form.settle()
        low, high = form.bounds()
        low = [a - e for a, e in zip(low, loose, strict=True)]
        high = [b + e for b, e in zip(high, loose, strict=True)]
        _clip(policy, form, claim.clip_slopes, low, high)
        loose = [abs(arb(slope)) * e for slope, e in zip(claim.clip_slopes, loose, strict=True)]
        if deployment is not None:
            loose = [a + b for a, b in zip(loose, deployment.clip_error(), strict=True)]
    form.settle()
    needed = [abs(c - d) + e for c, d, e in zip(form.center, claim.action.center, loose, strict=True)]
    _compare(policy, form, claim.action, needed)
    require_within(needed, claim.action.box, what)


def _observe(policy: Policy, states: Start, claim: PeriodClaim) -> _Seen:
    layout = policy.layout
    count = len(states.rows)
    if layout.observed is not None:
        flat = [row[i] for i in layout.observed for row in states.rows]
        rows = arb_mat(layout.observations, count, flat)
        return _Seen(
            [arb(states.center[i]) for i in layout.observed],
            rows,
            count,
            [arb(0)] * layout.observations,
            policy.radius,
        )
    assert claim.observation is not None
    image = image_of(policy.observe, states, claim.observation)
    if not all(bool(x.is_finite()) for x in (*image.center, *image.rest)):
        raise Rejected("what the policy sees is not defined on all of the set")
    fresh = len(image.fresh)
    shared = [[arb(0)] * 0 for _ in range(layout.observations)]
    if count:
        flat = [x for row in states.rows for x in row]
        shared = (image.jacobian * arb_mat(count, len(states.center), flat).transpose()).tolist()
    rows = [x for i, row in enumerate(shared) for x in (*row, *(new[i] for new in image.fresh))]
    return _Seen(
        image.center,
        arb_mat(layout.observations, count + fresh, rows),
        count,
        image.rest,
        policy.radius,
    )


def _magnitude(low: Vector, high: Vector) -> Vector:
    return [abs(a).max(abs(b)) for a, b in zip(low, high, strict=True)]


def _range(activation: Activation, low: Vector, high: Vector) -> Vector:
    """Bounds of the absolute value behind an activation; all of them are monotone."""
    return _magnitude(apply(activation, low), apply(activation, high))


def _clip(policy: Policy, form: _Form, slopes: Floats, low: Vector, high: Vector) -> None:
    """Follow the specification's clip; its residuals become the last part."""
    center, size = [], []
    for (least, most), slope, c, a, b in zip(policy.bounds, slopes, form.center, low, high, strict=True):
        m = arb(slope)
        below, above = clip_residual(least, most, m, a, b)
        center.append(m * c + (below + above) / 2)
        size.append((above - below) / 2)
    form.center = center
    form.slopes = [arb(slope) for slope in slopes]
    form.parts = [*form.parts, _Part(None, size)]


def _compare(policy: Policy, form: _Form, claim: ActionClaim, needed: Vector) -> None:
    """Add to `needed` what the claimed rows leave of the computed ones: differences, and whole rows that are not kept.

    A claimed row that is like no computed one only makes the claimed set larger.
    """
    seen, inputs = form.seen, len(needed)
    mapped = (form.map * seen.rows).tolist()
    table = form.map.tolist()
    kept = {origin: row for origin, row in zip(claim.origins, claim.private, strict=True)}
    for i in range(inputs):
        differences = [abs(x - row[i]) for x, row in zip(mapped[i], claim.rows, strict=False)]
        needed[i] += sum(differences, arb(0))
    columns: list[tuple[tuple[int, int], Vector]] = []
    for position in range(seen.rows.ncols() - seen.shared):
        columns.append(((PRODUCT, position), [mapped[i][seen.shared + position] for i in range(inputs)]))
    for kind, sizes in ((BOX, seen.box), (PERTURBATION, seen.noise)):
        for position, size in enumerate(sizes):
            if not size.is_zero():
                columns.append(((kind, position), [table[i][position] * size for i in range(inputs)]))
    parts = list(form.parts)
    clipped = parts.pop() if policy.layout.clipped else None
    neuron = 0
    for part in parts:
        rows = part.matrix.tolist()
        for position, size in enumerate(part.size):
            if not size.is_zero():
                columns.append(((NEURON, neuron + position), [rows[i][position] * size for i in range(inputs)]))
        neuron += len(part.size)
    if clipped is not None:
        rows = clipped.matrix.tolist()
        for position, size in enumerate(clipped.size):
            columns.append(((CLIPPED, position), [rows[i][position] * size for i in range(inputs)]))
    for origin, column in columns:
        row = kept.pop(origin, None)
        for i, x in enumerate(column):
            needed[i] += abs(x) if row is None else abs(x - row[i])
