"""Who drives from the page, and when the mouse stops."""

from __future__ import annotations

import pytest

from nermo_control.driver import Driver, Limits
from nermo_control.types import ControlCommand, Posture
from nermo_description.silence import OWNER, STICK
from nermo_web.door import Settings, Stick, Take
from nermo_web.who_drives import WhoDrives

FULL_SPEED = Limits().max_forward_velocity
ANNA, BERT = 1, 2


class Page:
    """A page, and the browsers before it, whose clocks began at other times."""

    def __init__(self) -> None:
        self.driver = Driver(Limits(), gaits=("trot", "bound"), speed=10)
        self.who_drives = WhoDrives(self.driver)
        self.now = 1000.0
        for viewer in (ANNA, BERT):
            self.who_drives.join(viewer)

    def press(self, viewer: int, press: int = 1, forward: float = 1.0, late: float = 0.0) -> str:
        sent = 1e3 * (self.now - late - 300.0 * viewer)
        stick = Stick(kind="stick", sent=sent, press=press, forward=forward if press else 0.0, turn=0.0)
        return self.who_drives.stick(viewer, stick, self.now)

    def command(self) -> ControlCommand | None:
        return self.who_drives.command(self.now, 7)

    def speed(self) -> float | None:
        command = self.command()
        return None if command is None else command.forward_velocity


@pytest.fixture
def page() -> Page:
    return Page()


def test_the_stick_drives_while_it_is_pressed_and_not_after(page: Page) -> None:
    assert page.command() is None
    assert page.press(ANNA) == ""
    assert page.speed() == pytest.approx(FULL_SPEED)
    page.press(ANNA, press=0)
    assert page.who_drives.ends
    assert page.speed() == 0.0
    assert page.command() is None


def test_silence_stops_the_mouse_and_a_hand_that_still_presses_goes_on(page: Page) -> None:
    page.press(ANNA)
    page.now += STICK.after
    assert page.speed() == pytest.approx(FULL_SPEED)
    page.now += 0.001
    assert page.speed() == 0.0
    assert page.command() is None
    page.press(ANNA)
    assert page.speed() == pytest.approx(FULL_SPEED)


def test_a_page_that_closes_stops_the_mouse(page: Page) -> None:
    page.press(ANNA)
    assert page.speed() == pytest.approx(FULL_SPEED)
    page.who_drives.leave(ANNA, page.now)
    assert page.speed() == 0.0
    assert page.command() is None


def test_nobody_waits_for_a_page_that_is_closed(page: Page) -> None:
    page.press(ANNA)
    assert page.speed() == pytest.approx(FULL_SPEED)
    page.who_drives.leave(ANNA, page.now)
    assert page.who_drives.holder(page.now) is None
    assert page.speed() == 0.0
    assert page.press(BERT) == ""
    assert page.speed() == pytest.approx(FULL_SPEED)


def test_what_comes_late_does_not_drive(page: Page) -> None:
    page.press(ANNA)
    page.now += 2.0
    assert page.speed() is None
    for _ in range(20):  # held up somewhere, and all there at once
        page.press(ANNA, late=1.0)
    assert page.speed() is None
    page.press(ANNA)
    assert page.speed() == pytest.approx(FULL_SPEED)


def test_one_drives_at_a_time(page: Page) -> None:
    page.press(ANNA)
    assert "viewer 1 drives" in page.press(BERT)
    page.now += 0.1
    assert "viewer 1 drives" in page.who_drives.change(BERT, Settings(kind="settings", speed=1), page.now)
    assert "viewer 1 drives" in page.who_drives.take(BERT, Take(kind="posture", posture="sit"), page.now)
    page.press(ANNA, press=0)
    assert "viewer 1 drives" in page.press(BERT, press=2)
    page.now += OWNER.after + 0.001
    assert page.press(BERT, press=2) == ""
    assert page.command() is None, "a press that was refused drives no more"
    assert page.press(BERT, press=3) == ""
    assert page.speed() == pytest.approx(FULL_SPEED)
    assert "viewer 2 drives" in page.press(ANNA, press=2)


def test_a_stop_by_anybody_ends_the_press_and_only_a_release_the_stop(page: Page) -> None:
    page.press(ANNA)
    page.who_drives.stop(page.now)
    assert page.command().posture is Posture.STOP
    assert "emergency stop" in page.press(ANNA, press=2)
    assert "emergency stop" in page.who_drives.take(ANNA, Take(kind="posture", posture="stand"), page.now)
    page.who_drives.leave(BERT, page.now)
    page.now += 3600.0
    assert page.driver.stopped
    assert page.command().posture is Posture.STOP
    page.who_drives.release(page.now)
    assert not page.driver.stopped
    assert page.driver.release_wanted
    page.press(ANNA, press=2)
    assert page.speed() == 0.0, "the hand that pressed through the stop presses anew"
    page.press(ANNA, press=3)
    assert page.speed() == pytest.approx(FULL_SPEED)


def test_a_posture_is_commanded_for_a_moment(page: Page) -> None:
    assert page.who_drives.take(BERT, Take(kind="posture", posture="sit"), page.now) == ""
    assert page.command().posture is Posture.SIT
    page.now += 1.0
    assert page.command() is None
    page.press(ANNA)
    assert page.who_drives.take(ANNA, Take(kind="posture", posture="sit"), page.now) == "let the stick go first"
    assert page.command().posture is Posture.WALK


def test_settings_are_those_that_there_are(page: Page) -> None:
    change = page.who_drives.change
    assert "there is no gait 'moonwalk'" in change(ANNA, Settings(kind="settings", gait="moonwalk"), page.now)
    assert "there is no spine function 'x'" in change(ANNA, Settings(kind="settings", spine={"x": True}), page.now)
    wanted = Settings(kind="settings", gait="bound", frequency=1.5, speed=3, spine={"turning": True})
    assert change(ANNA, wanted, page.now) == ""
    page.press(ANNA)
    command = page.command()
    assert (command.gait, command.gait_frequency, command.spine_modes.turning) == ("bound", 1.5, True)
    assert command.forward_velocity == pytest.approx(0.3 * FULL_SPEED)
