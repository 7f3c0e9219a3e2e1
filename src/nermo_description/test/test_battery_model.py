"""The battery runs down as one does."""

from __future__ import annotations

import pytest

from nermo_description.battery_model import Battery, BatteryModel


def test_battery_runs_down_by_what_is_drawn() -> None:
    battery = Battery(BatteryModel(idle_power=0.0, efficiency=1.0, resistance=0.0, full=7.4, empty=7.4))
    battery.draw(7.4, 1800.0)
    assert battery.current == pytest.approx(1.0)
    assert battery.charge == 0.0
    fresh = Battery()
    fresh.draw(0.0, 60.0)
    assert 0.0 < fresh.charge < 1.0
    assert fresh.model.empty < fresh.voltage < fresh.model.full
