"""What a person who drives sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from nermo_bringup.drive.odometer import Odometer
from nermo_bringup.teleop.keyboard import HELP
from nermo_control.driver import SPEED_STEPS, Driver
from nermo_control.types import Posture


@dataclass(frozen=True, slots=True)
class View:
    """What there is to show."""

    title: str
    driver: Driver
    odometer: Odometer
    forward_velocity: float
    """Commanded [m/s], whoever commands."""
    turn_rate: float
    """Commanded [rad/s]."""
    state: str
    """Of the servos, as the twin tells it."""
    fallen: bool
    trouble: Sequence[str]
    """What nodes warn of, newest last."""
    real_time_factor: str


def starting(robot: str, up: int, of: int, seconds: float, keys: Sequence[str]) -> Text:
    """The one line while the graph comes up."""
    typed = f"; typed so far: {' '.join(keys)}" if keys else ""
    return Text(f"bringing up the twin of {robot}: {up} of {of} nodes, {seconds:.0f} s{typed} (q ends)")


def screen(view: View) -> RenderableType:
    """The cockpit: 22 lines, so that it fits the smallest usual terminal."""
    driver, limp = view.driver, view.state.startswith("limp")
    facts = Table.grid(padding=(0, 2))
    facts.add_row("commanded", f"{view.forward_velocity:+.3f} m/s, {view.turn_rate:+.2f} rad/s")
    facts.add_row("real", f"{view.odometer.speed_m_s:+.3f} m/s, {view.odometer}")
    frequency = driver.gait_frequency or driver.default_frequency
    facts.add_row(
        "gait", f"{driver.gait or driver.default_gait or 'its own gait'} at {frequency:g} Hz, {_settings(driver)}"
    )
    if driver.stopped or limp:
        facts.add_row("state", Text(f"EMERGENCY STOP, {view.state}; 1 releases", style="bold red"))
    elif view.fallen:
        facts.add_row("state", Text("FELL OVER; q ends, and the next drive begins on its feet", style="bold red"))
    else:
        facts.add_row("state", f"{_posture(view)}, servos {view.state}")
    facts.add_row("twin", f"{view.real_time_factor} x real time")
    facts.add_row("warning", Text(view.trouble[-1] if view.trouble else "none", overflow="ellipsis", no_wrap=True))
    keys = Table.grid(padding=(0, 2))
    for key, meaning in HELP.items():
        keys.add_row(Text(key, style="bold"), meaning)
    return Group(Text(view.title, style="bold"), facts, Text(""), keys)


def _posture(view: View) -> str:
    if view.driver.posture is not Posture.WALK:
        return view.driver.posture.name.lower().replace("_", " ")
    return "walking" if view.forward_velocity or view.turn_rate else "ready to walk"


def _settings(driver: Driver) -> str:
    """The settings that keys change; those that are off are left out."""
    spine = [name.replace("_", " ") for name in driver.spine_modes.__slots__ if getattr(driver.spine_modes, name)]
    settings = [f"speed {driver.speed}/{SPEED_STEPS}"]
    settings += [f"trim {driver.trim:+.1f} rad/m"] if driver.trim else []
    settings += [f"spine: {', '.join(spine)}"] if spine else []
    settings += ["holding its line"] if driver.straight_line else []
    return ", ".join(settings)
