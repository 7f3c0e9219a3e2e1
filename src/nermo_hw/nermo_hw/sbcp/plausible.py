"""Which preambles can be meant on Nermo's line: what makes an accidental frame rare enough to forget."""

from __future__ import annotations

from nermo_hw.sbcp import boards, pwm_board, register_tables
from nermo_hw.sbcp.boards import BODY_BOARD, BUS_CONTROLLER, SERVO_BOARDS
from nermo_hw.sbcp.packet import DeviceClass, Status

_ANSWER_SIZES = {
    int(DeviceClass.SERVO_BOARD): boards.SERVO_ANSWER_SIZE,
    int(DeviceClass.BODY_BOARD): boards.BODY_ANSWER_SIZE,
    int(DeviceClass.PWM_BOARD): pwm_board.ANSWER_SIZE,
}
_REGISTER_SIZES = {0, 1, 2, 4, 16}
_STATUSES = {int(status) for status in Status}
_ADDRESSES = {
    BUS_CONTROLLER,
    BODY_BOARD,
    pwm_board.ADDRESS,
    *((int(DeviceClass.SERVO_BOARD), number) for number in SERVO_BOARDS),
}


def plausible_answer(device_class: int, device_id: int, size: int, code: int) -> bool:
    """What can come from a Nermo to its host."""
    if (device_class, device_id) not in _ADDRESSES or code not in _STATUSES:
        return False
    return size == _ANSWER_SIZES.get(device_class) or size in _REGISTER_SIZES


def plausible_request(device_class: int, device_id: int, size: int, code: int) -> bool:
    """What a host can mean. Unknown instructions and IDs of known classes get an answer that says so."""
    largest = pwm_board.REQUEST_SIZE if device_class == DeviceClass.PWM_BOARD else boards.SERVO_REQUEST_SIZE
    return device_class in register_tables.REGISTERS and size <= max(largest, 17)
