"""Gaits named from touch-downs."""

from __future__ import annotations

import numpy as np
import pytest

from nermo_sim.experiments.footfalls import LAGS, name_gait, touch_down_lags, touch_downs


def feet(lags: tuple[float, float, float], noise: float = 0.0, strides: int = 12) -> list[np.ndarray]:
    """Touch-downs at 2 Hz, from random noise [s]."""
    random = np.random.default_rng(1)
    front_left, front_right, rear_right = lags
    return [
        0.5 * (np.arange(strides) + lag) + noise * random.standard_normal(strides)
        for lag in (front_left, front_right, 0.0, rear_right)
    ]


@pytest.mark.parametrize("name", LAGS)
def test_every_gait_is_known_by_its_footfalls(name: str) -> None:
    assert name_gait(feet(LAGS[name], noise=0.01)) == name


def test_lags_and_frequency_are_told() -> None:
    lags, steadiness, frequency = touch_down_lags(feet((0.25, 0.75, 0.5)))
    np.testing.assert_allclose(lags, [0.25, 0.75, 0.5], atol=1e-9)
    np.testing.assert_allclose(steadiness, 1.0)
    assert frequency == pytest.approx(2.0)


def test_what_is_no_gait_is_not_called_one() -> None:
    assert name_gait(feet((0.25, 0.25, 0.25))) == "between gaits"
    random = np.random.default_rng(0)
    wandering = [np.sort(random.uniform(0.0, 6.0, 12)) for _ in range(2)]
    assert name_gait([wandering[0], wandering[1], feet((0.0, 0.0, 0.0))[2], wandering[0]]) == "unsteady"
    assert name_gait([np.array([1.0])] * 4) == "standing"
    with pytest.raises(ValueError, match="touches down 1 times"):
        touch_down_lags([np.array([1.0])] * 4)


def test_touch_downs_are_found_and_bounces_left_out() -> None:
    time = np.arange(400) * 0.005
    loads = np.zeros((400, 1))
    loads[100:200] = loads[202:210] = loads[300:380] = 1.0
    loads[50:53] = 1.0
    (found,) = touch_downs(loads, time, 0.15)
    np.testing.assert_allclose(found, [0.5, 1.5])
