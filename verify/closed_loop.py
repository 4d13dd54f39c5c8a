"""The closed loop, one control period after the other, for a batch of cells.

The tracked set has coordinates (states, constant disturbances, actions that are still delayed). Its first rows are the
factors of the initial set: they keep their identity to the end, because splitting, witnesses and long horizons live on
them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..models.policy import Activation
from . import rounding
from .action_sets import (
    CLIPPED,
    NEURON,
    OBSERVATION_BOX,
    OBSERVATION_PRODUCT,
    PERTURBATION,
    TWO_LINES,
    ActionChoices,
    ActionSet,
    better_set,
    merged_set,
)
from .backward_action import backward_set
from .deployed import conversion_error, deployed_error
from .integrator import PeriodFlow, integrate
from .model import Model, clip_activations
from .network import enclose_layers
from .options import LEAST_GENERATORS, Options
from .relaxations import relax
from .zonotope import (
    Zonotope,
    append_rows,
    concatenate,
    diagonal_rows,
    pad_rows,
    reduce_order,
    unbox,
)

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]

SOURCES = (
    "initial set",
    "observation perturbation",
    "disturbances",
    "network relaxation",
    "flow remainder",
    "order reduction",
)


@dataclass
class Cells:
    """A batch of cells on its way through the horizon.

    Attributes
    ----------
    tracked : Zonotope, shape (B, N)
    observation_radius : array, shape (B, n_obs)
    index : array of int, shape (B,)
        Position of each cell in the caller's list; cells that are dropped leave the batch.
    substeps : array of int, shape (B,)
        Integrator steps (as a power of two) that the last period needed.
    growth : array, shape (B, len(SOURCES))
        What each source has added so far, in units of the set's own extent at that time.
    rate : array, shape (2, B, n), or None
        Growth of the last a-priori box per second, a guess.
    """

    tracked: Zonotope
    observation_radius: Array
    index: NDArray[np.intp]
    substeps: NDArray[np.intp]
    growth: Array
    rate: Array | None = None

    def select(self, keep: NDArray[np.intp] | Bools) -> Cells:
        """Some of the cells."""
        return Cells(
            self.tracked[keep],
            self.observation_radius[keep],
            self.index[keep],
            self.substeps[keep],
            self.growth[keep],
            None if self.rate is None else self.rate[:, keep],
        )


@dataclass(frozen=True)
class Period:
    """One control period of a batch.

    Attributes
    ----------
    number : int
        0 for the first.
    index : array of int, shape (B,)
        The caller's positions of the cells.
    start, end : Zonotope, shape (B, n)
        Time-point sets of the states.
    action : Zonotope, shape (B, m)
        What the plant receives.
    computed : Zonotope, shape (B, m)
        What the policy computes in this period; differs from `action` when there is a delay.
    flow : PeriodFlow
    sound : array of bool, shape (B,)
        Where the enclosure of this period exists.
    deployed_error : array, shape (B, m)
        e_L, already included in `computed`; zero when only exact arithmetic is covered.
    growth : array, shape (B, len(SOURCES))
        Ledger of growth up to this period's end; see `Cells`.
    tracked : Zonotope, shape (B, N)
        The tracked set at the start.
    kept : array of int, shape (B, k)
        Rows of the joint set at the end that became the first ones of the next tracked set; any others are zero.
    joint_rows : int
        Rows of the joint set of states, actions and disturbances.
    choices : ActionChoices
        What a checker needs to know to follow the policy's enclosure.
    """

    number: int
    index: NDArray[np.intp]
    start: Zonotope
    end: Zonotope
    action: Zonotope
    computed: Zonotope
    flow: PeriodFlow
    sound: Bools
    deployed_error: Array
    growth: Array
    tracked: Zonotope
    kept: NDArray[np.intp]
    joint_rows: int
    choices: ActionChoices


Observer = Callable[[Period], Bools]
"""Receives every period, says which cells shall go on."""


@dataclass(frozen=True)
class Engine:
    """Enclosure of a closed loop under given options."""

    model: Model
    options: Options
    protected: int = field(default=0)
    """Number of initial factors: leading rows of the tracked set."""

    def start(self, center: Array, rows: Array, radius: Array, observation_radius: Array) -> Cells:
        """Cells from zonotopes of initial states, factors in `rows` (B, p, n); constant disturbances get a factor each.

        `protected` must be p plus the number of constant disturbances.
        """
        model = self.model
        batch = center.shape[0]
        constant = model.constant
        low, high = model.disturbance_lower[constant], model.disturbance_upper[constant]
        middle, spread = rounding.center_radius(low, high)
        delayed, delayed_error = rounding.balls_of(model.loop.delayed_action * model.loop.delay)
        parts = [center, np.tile(middle, (batch, 1)), np.tile(delayed, (batch, 1))]
        count, extra = constant.size, delayed.size
        states, factors = model.states, rows.shape[1]
        generators = np.zeros((batch, factors + count, states + count + extra))
        generators[:, :factors, :states] = rows
        generators[:, factors + np.arange(count), states + np.arange(count)] = spread
        boxed = np.concatenate([radius, np.zeros((batch, count)), np.tile(delayed_error, (batch, 1))], 1)
        tracked = Zonotope(np.concatenate(parts, 1), generators, boxed)
        return Cells(
            tracked,
            observation_radius,
            np.arange(batch),
            np.zeros(batch, dtype=np.intp),
            np.zeros((batch, len(SOURCES))),
        )

    def run(self, cells: Cells, observer: Observer) -> Cells:
        """Move cells through the horizon; the observer sees every period and drops cells.

        Returns
        -------
        Cells
            Those that reached the end.
        """
        for number in range(self.model.loop.periods):
            if cells.index.size == 0:
                break
            period, cells = self.advance(number, cells)
            keep = observer(period) & period.sound
            if not keep.all():
                cells = cells.select(keep)
        return cells

    def advance(self, number: int, cells: Cells) -> tuple[Period, Cells]:
        """Enclose one control period."""
        model, options = self.model, self.options
        states, inputs, delay = model.states, model.inputs, model.loop.delay
        with np.errstate(invalid="ignore", over="ignore"):
            tracked = unbox(cells.tracked)
            shared = tracked.generators.shape[1]
            state = tracked.coordinates(slice(0, states))
            computed, error, shares, choices = self._act(state, cells.observation_radius, shared)
            first_delayed = states + model.constant.size
            queue = tracked.coordinates(slice(first_delayed, tracked.dimension))
            if delay:
                action = queue.coordinates(slice(0, inputs))
                queue = concatenate(queue.coordinates(slice(inputs, queue.dimension)), computed)
            else:
                action = computed
            joint = concatenate(state, action)
            # factors that are private to this period's computed action own their rows even while the action is delayed
            joint = replace(joint, generators=pad_rows(joint.generators, computed.generators.shape[1]))
            joint = self._with_disturbances(joint, tracked)
            flow = integrate(model.loop.plant, joint, model.loop.period, options, cells.substeps, cells.rate)
            end = flow.end.coordinates(slice(0, states))
            constant = tracked.coordinates(slice(states, first_delayed))
            result = concatenate(concatenate(end, constant), queue)
            scale = result.spread
            positive = np.where(
                scale > 0.0, scale, np.where(scale.max(1, keepdims=True) > 0, scale.max(1, keepdims=True), 1.0)
            )
            rows = max(options.generators * result.dimension, LEAST_GENERATORS) + self.protected
            reduced, boxed, kept = reduce_order(result, self.protected, rows, positive)
            growth = self._growth(cells, tracked, computed, end, flow, boxed, positive, shared, shares)
        finite = np.isfinite(end.spread).all(1) & np.isfinite(end.center).all(1)
        period = Period(
            number,
            cells.index,
            cells.tracked.coordinates(slice(0, states)),
            end,
            action,
            computed,
            flow,
            flow.sound & finite,
            error,
            growth,
            cells.tracked,
            kept,
            joint.generators.shape[1],
            choices,
        )
        return period, Cells(reduced, cells.observation_radius, cells.index, flow.substeps, growth, flow.rate)

    def _act(self, state: Zonotope, radius: Array, shared: int) -> tuple[Zonotope, Array, Array, ActionChoices]:
        """Action set of a state set: observe, perturb, network, clip, deployed error; private rows merged.

        Returns the action set, e_L, the share of the private part that comes from the observation perturbation, and the
        choices.
        """
        model, options, products, image = self.model, self.options, None, None
        if model.observed is not None:
            seen = state.coordinates(model.observed)
        else:
            from .flow import image_of

            assert model.loop.observation is not None
            image, _, products = image_of(model.loop.observation, state, options.quadratic_rows * state.dimension)
            seen = unbox(image)
        before = seen.generators.shape[1]
        perturbed = append_rows(seen, diagonal_rows(radius)) if radius.any() else seen
        after = perturbed.generators.shape[1]
        noise, forms = slice(before - shared, after - shared), None
        two_lines: tuple[Array, ...] = ()
        if options.enclosure == "zonotope":
            found = self._forward(perturbed, shared, noise)
        else:
            found = backward = backward_set(model, options, perturbed, shared, noise)
            two_lines, forms = backward.lines, np.full(state.batch, TWO_LINES)
            if options.enclosure == "best":
                found, forms = better_set(self._forward(perturbed, shared, noise), backward, shared)
        products_and_box = before - shared
        size = radius.shape[1]
        clipped = 0 if model.clip is None else found.error.shape[1]
        kinds = [
            (OBSERVATION_PRODUCT, np.arange(max(products_and_box - size, 0))),
            (OBSERVATION_BOX, np.arange(min(products_and_box, size))),
            (PERTURBATION, np.arange(after - before)),
            (NEURON, found.neurons),
            (CLIPPED, np.arange(clipped)),
        ]
        origins = np.concatenate([np.stack([np.full_like(index, kind), index], 1) for kind, index in kinds])
        choices = ActionChoices(products, image, found.lines, two_lines, forms, origins, found.kept)
        return found.output, found.error, found.noise_share, choices

    def _forward(self, perturbed: Zonotope, shared: int, noise: slice) -> ActionSet:
        """Action set of a set of observations by one affine form of all neurons."""
        model = self.model
        enclosure = enclose_layers(model.layers, perturbed)
        output = enclosure.output
        lines: list[Array] = []
        activations = (layer for layer in model.layers if isinstance(layer, Activation))
        for activation, relaxation in zip(activations, enclosure.relaxations, strict=True):
            smooth = activation.kind in ("tanh", "sigmoid")
            lines += [relaxation.slope, *((relaxation.offset, relaxation.error) if smooth else ())]
        error = np.zeros_like(output.center)
        if self.options.deployed:
            error = deployed_error(model.layers, enclosure.bounds, model.loop.policy.precision)
        output = Zonotope(output.center, output.generators, rounding.enlarged(output.radius + error, 1))
        if model.clip is not None:
            output, slope = self._clip(output)
            lines.append(slope)
        return merged_set(output, shared, self.options.action_rows, noise, error, tuple(lines), enclosure.origins)

    def _clip(self, action: Zonotope) -> tuple[Zonotope, Array]:
        """Clip every action to its bounds; each relaxation error becomes a private generator. And the slopes."""
        model = self.model
        assert model.clip is not None
        interval = action.interval
        low, high = interval.lower, interval.upper
        columns = [
            relax(activation, low[:, i : i + 1], high[:, i : i + 1])
            for i, activation in enumerate(clip_activations(model.clip))
        ]
        slope = np.concatenate([c.slope for c in columns], 1)
        offset = np.concatenate([c.offset for c in columns], 1)
        relaxation_error = np.concatenate([c.error for c in columns], 1)
        center = slope * action.center + offset
        generators = action.generators * slope[:, None, :]
        total = rounding.absolute_sum(generators, 1)
        radius = np.abs(slope) * action.radius + rounding.relative_error(total, 1)
        radius = radius + rounding.relative_error(slope * action.center, 1) + rounding.relative_error(center, 1)
        # the exact bounds differ from these floats, and a deployed clip rounds them to its own precision
        error = model.clip[2]
        if self.options.deployed:
            precision = model.loop.policy.precision
            error = np.maximum(*(conversion_error(bound, error, precision) for bound in model.clip[:2]))
        radius = rounding.enlarged(radius + error, 6)
        return append_rows(Zonotope(center, generators, radius), diagonal_rows(relaxation_error)), slope

    def _with_disturbances(self, joint: Zonotope, tracked: Zonotope) -> Zonotope:
        """Append the plant's disturbances in their order: tracked ones, and fresh factors for those that vary."""
        model = self.model
        count = len(model.loop.disturbances)
        if count == 0:
            return joint
        batch, rows = joint.batch, joint.generators.shape[1]
        center = np.zeros((batch, count))
        generators = np.zeros((batch, rows + model.varying.size, count))
        radius = np.zeros((batch, count))
        position = model.states + np.arange(model.constant.size)
        center[:, model.constant] = tracked.center[:, position]
        generators[:, : tracked.generators.shape[1], model.constant] = tracked.generators[:, :, position]
        middle, spread = model.varying_ball
        center[:, model.varying] = middle
        generators[:, rows + np.arange(model.varying.size), model.varying] = spread
        return concatenate(joint, Zonotope(center, generators, radius))

    def _growth(
        self,
        cells: Cells,
        tracked: Zonotope,
        computed: Zonotope,
        end: Zonotope,
        flow: PeriodFlow,
        boxed: Array,
        scale: Array,
        shared: int,
        noise_share: Array,
    ) -> Array:
        """Ledger of growth: how much each source added in this period, relative to the set's extent. Not a bound."""
        states = self.model.states
        share = 1.0 / (states * scale[:, :states])

        def relative(added: Array) -> Array:
            """Mean over the states, in units of the set's extent."""
            return np.einsum("bn,bn->b", added, share)  # type: ignore[no-any-return]

        size = np.abs(end.generators)
        merged = computed.generators.shape[1]
        varying = merged + self.model.varying.size
        private = relative(size[:, shared:merged].sum(1))
        growth = cells.growth.copy()
        growth[:, 0] = relative(size[:, : self.protected].sum(1))
        growth[:, 1] += private * noise_share
        growth[:, 2] += relative(size[:, merged:varying].sum(1))
        growth[:, 3] += private * (1.0 - noise_share)
        growth[:, 4] += relative(flow.added)
        growth[:, 5] += relative(boxed[:, :states])
        return growth
