"""The tangent that bounds the residual of tanh encloses it from every place, and costs nothing behind a rising end."""

from __future__ import annotations

import numpy as np
import pytest

from setrl.verify.relaxations import _tangent_bound

COUNT = 4000


def intervals() -> tuple[np.ndarray, ...]:
    """Slopes, intervals [start, stop] of the concave part, and places in them that are not where f' = m."""
    generator = np.random.default_rng(17)
    start, width = generator.exponential(0.7, COUNT), generator.exponential(0.7, COUNT)
    share = generator.choice([0.0, 1.0, 0.3, 0.8], COUNT)
    return generator.uniform(0.0, 1.0, COUNT), start, start + width, start + share * width


def test_a_tangent_at_any_place_is_above_every_sample():
    slope, start, stop, place = intervals()
    bound = _tangent_bound(np.clip(place, start, stop), slope, start, stop, np)
    for share in np.linspace(0.0, 1.0, 41):
        x = start + share * (stop - start)
        assert (np.tanh(x) - slope * x <= bound).all()


@pytest.mark.parametrize("rising", [True, False])
def test_a_tangent_at_the_end_where_the_residual_is_largest_has_no_slack(rising):
    _, start, stop, _ = intervals()
    place = stop if rising else start
    slope = (1.0 - np.tanh(place) ** 2) * (0.9 if rising else 1.0) + (0.0 if rising else 0.05)
    bound = _tangent_bound(place, slope, start, stop, np)
    assert np.abs(bound - (np.tanh(place) - slope * place)).max() < 1e-13
