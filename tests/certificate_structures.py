"""Leaves of certificates with another structure: parts swapped, left out, or given twice; written as they then are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from setrl.verify.checker.leaf import Leaf, PeriodClaim, Products, Slabs, StepClaim


def _with_period(leaf: Leaf, number: int, period: PeriodClaim) -> Leaf:
    return replace(leaf, periods=(*leaf.periods[:number], period, *leaf.periods[number + 1 :]))


def _of_period(change: Callable[[PeriodClaim, Any], PeriodClaim | None]) -> Callable[[Leaf, Any], Leaf | None]:
    def maker(leaf: Leaf, generator: Any) -> Leaf | None:
        number = int(generator.integers(len(leaf.periods)))
        period = change(leaf.periods[number], generator)
        return None if period is None else _with_period(leaf, number, period)

    return maker


def _of_step(change: Callable[[StepClaim, Any], StepClaim | None]) -> Callable[[Leaf, Any], Leaf | None]:
    def whole(period: PeriodClaim, generator: Any) -> PeriodClaim | None:
        number = int(generator.integers(len(period.steps)))
        step = change(period.steps[number], generator)
        steps = (*period.steps[:number], step, *period.steps[number + 1 :])
        return None if step is None else replace(period, steps=steps)

    return _of_period(whole)


def _swapped_periods(leaf: Leaf, generator: Any) -> Leaf | None:
    first, second = sorted(generator.integers(0, len(leaf.periods), 2).tolist())
    periods = list(leaf.periods)
    periods[first], periods[second] = periods[second], periods[first]
    return replace(leaf, periods=tuple(periods))


def _swapped_claims(leaf: Leaf, generator: Any) -> Leaf | None:
    """Only the actions, or only the ends, of two periods."""
    first, second = sorted(generator.integers(0, len(leaf.periods), 2).tolist())
    one, two = leaf.periods[first], leaf.periods[second]
    part = str(generator.choice(["seen", "action", "steps", "radius", "lines", "points"]))
    if first == second:
        return None
    changed = _with_period(leaf, first, replace(one, **{part: getattr(two, part)}))
    return _with_period(changed, second, replace(two, **{part: getattr(one, part)}))


def _fewer_periods(leaf: Leaf, generator: Any) -> Leaf | None:
    return replace(leaf, periods=leaf.periods[:-1])


def _steps(period: PeriodClaim, generator: Any) -> PeriodClaim | None:
    """One step fewer, one more, or two of them swapped."""
    steps, place = list(period.steps), int(generator.integers(len(period.steps)))
    match generator.integers(3):
        case 0:
            del steps[place]
        case 1:
            steps.insert(place, steps[place])
        case _:
            steps.reverse()
    first = [replace(step, kept=(), start_radius=None) if i == 0 else step for i, step in enumerate(steps)]
    return replace(period, steps=tuple(first)) if steps else None


def _private(period: PeriodClaim, generator: Any) -> PeriodClaim | None:
    """A private row of the actions left out, or two of them exchanged."""
    action = period.action
    if not action.origins:
        return None
    place = int(generator.integers(len(action.origins)))
    origins, rows = list(action.origins), list(action.private)
    if generator.integers(2):
        rows[place], rows[0] = rows[0], rows[place]
    else:
        del origins[place], rows[place]
    return replace(period, action=replace(action, origins=tuple(origins), private=tuple(rows)))


def _pairs(step: StepClaim, generator: Any) -> StepClaim | None:
    """A product left out, with or without its row in the box."""
    if step.products is None or not step.products.pairs:
        return None
    place = int(generator.integers(len(step.products.pairs)))
    pairs, fresh = list(step.products.pairs), list(step.end.fresh)
    del pairs[place]
    row = fresh.pop(place)
    radius = step.end.radius
    if generator.integers(2):
        radius = tuple(r + abs(x) for r, x in zip(radius, row, strict=True))
    end = replace(step.end, fresh=tuple(fresh), radius=radius)
    return replace(step, products=Products(step.products.factors, tuple(pairs)), end=end)


def _rows(step: StepClaim, generator: Any) -> StepClaim | None:
    """The rows of a step's end reversed, one of them zero, or all of them a little shorter."""
    rows = list(step.end.rows)
    place = int(generator.integers(max(len(rows), 1)))
    match generator.integers(3):
        case 0:
            rows.reverse()
        case 1 if rows:
            rows[place] = tuple(0.0 for _ in rows[place])
        case _:
            rows = [tuple(x * (1 - 2.0**-20) for x in row) for row in rows]
    return replace(step, end=replace(step.end, rows=tuple(rows)))


def _boxes(step: StepClaim, generator: Any) -> StepClaim | None:
    """The box of a step's end larger (which stays true) or smaller."""
    factor = float(generator.choice([1.5, 1 + 2.0**-20, 1 - 2.0**-10, 0.99, 0.5, 0.0]))
    return replace(step, end=replace(step.end, radius=tuple(r * factor for r in step.end.radius)))


def _guess(step: StepClaim, generator: Any) -> StepClaim | None:
    """Another guess of the a-priori enclosure."""
    if step.prior is None:
        return None
    low, high = step.prior
    wide = float(generator.choice([-0.5, -0.01, 1e-4, 0.1, 1e3]))
    moved = [(a - wide * (b - a), b + wide * (b - a)) for a, b in zip(low, high, strict=True)]
    return replace(step, prior=(tuple(a for a, _ in moved), tuple(b for _, b in moved)))


def _slabs(step: StepClaim, generator: Any) -> StepClaim | None:
    """Fewer or more parts of a step in a requirement's proof."""
    places = [i for i, slabs in enumerate(step.slabs) if slabs is not None]
    if not places:
        return None
    place = places[generator.integers(len(places))]
    given = step.slabs[place]
    assert given is not None
    choices = given.choices[:1] if generator.integers(2) else given.choices * 2
    slabs = (*step.slabs[:place], Slabs(len(choices), choices), *step.slabs[place + 1 :])
    return replace(step, slabs=slabs)


def _penalty(period: PeriodClaim, generator: Any) -> PeriodClaim | None:
    return None if period.clear is None else replace(period, clear=None)


def _dropped(leaf: Leaf, generator: Any) -> Leaf | None:
    """One more row dropped by the last link, and by everything behind it; the box stays as it is."""
    if len(leaf.periods) < 2:
        return None
    before, last = leaf.periods[-2:]
    if not before.kept:
        return None
    place = int(generator.integers(len(before.kept)))

    def less(rows: tuple[Any, ...]) -> tuple[Any, ...]:
        return (*rows[:place], *rows[place + 1 :])

    def moved(products: Products | None) -> Products | None:
        if products is None or place in products.factors:
            return None
        return Products(tuple(f - (f > place) for f in products.factors), products.pairs)

    if (last.observation is not None and moved(last.observation) is None) or any(
        step.products is not None and moved(step.products) is None for step in last.steps
    ):
        return None
    steps = tuple(
        replace(step, products=moved(step.products), end=replace(step.end, rows=less(step.end.rows)))
        for step in last.steps
    )
    action = replace(last.action, rows=less(last.action.rows))
    seen = None if last.seen is None else replace(last.seen, rows=less(last.seen.rows))
    after = replace(last, observation=moved(last.observation), seen=seen, action=action, steps=steps)
    periods = (*leaf.periods[:-2], replace(before, kept=less(before.kept)), after)
    return replace(leaf, periods=periods)


STRUCTURES: list[tuple[str, Callable[[Leaf, Any], Leaf | None]]] = [
    ("periods swapped", _swapped_periods),
    ("parts of periods swapped", _swapped_claims),
    ("a period left out", _fewer_periods),
    ("steps", _of_period(_steps)),
    ("private rows", _of_period(_private)),
    ("products", _of_step(_pairs)),
    ("rows of an end", _of_step(_rows)),
    ("boxes", _of_step(_boxes)),
    ("a-priori guesses", _of_step(_guess)),
    ("slabs", _of_step(_slabs)),
    ("penalty charged", _of_period(_penalty)),
    ("a row dropped", _dropped),
]
