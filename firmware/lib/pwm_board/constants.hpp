// Made by `python -m nermo_hw.firmware.header` out of nermo_hw/sbcp/ and nermo_lite.yaml. Change those.
#pragma once

#include <cstdint>

namespace nermo {

constexpr uint8_t HEADER = 165;  // first byte of a packet
constexpr uint8_t DEVICE_CLASS = 4;
constexpr uint8_t DEVICE_ID = 1;
constexpr int PREAMBLE = 5;  // bytes before the payload
constexpr int OVERHEAD = 6;  // bytes beside the payload
constexpr int REQUEST_SIZE = 31;  // payload of an exchange
constexpr int ANSWER_SIZE = 46;  // payload of its answer
constexpr uint32_t BAUD = 921600;  // bit/s
constexpr uint16_t PROTOCOL_VERSION = 258;  // major and minor, a byte each
constexpr uint16_t FIRMWARE_VERSION = 256;  // likewise
constexpr uint8_t POWER = 1;  // flag of an exchange
constexpr uint8_t POINT = 16;  // likewise
constexpr uint8_t ACKNOWLEDGE = 32;  // likewise
constexpr uint8_t FLAGS = 49;  // all that there are
constexpr int16_t NO_NUMBER = -32768;  // target that is none
constexpr uint16_t NO_READING = 65535;  // voltage that is not measured
constexpr uint16_t LONGEST_WAY_MS = 200;  // to a target
constexpr uint32_t HOLD_US = 200000;  // without a point, then the servos hold
constexpr uint16_t WATCHDOG_MS = 500;  // without an exchange, then the servos are limp
constexpr uint16_t WATCHDOG_LOWER_MS = 20;  // what may be set
constexpr uint16_t WATCHDOG_UPPER_MS = 10000;  // likewise
constexpr uint32_t LARGEST_PAUSE_US = 2000;  // within a packet
constexpr uint32_t LOOP_PERIOD_US = 1000;  // of the firmware
constexpr uint32_t PULSE_PERIOD_US = 20000;  // from pulse to pulse
constexpr uint32_t STAGGER_US = 20000;  // from the first pulse of one servo to the next's
constexpr uint16_t LOW_MV = 6600;  // below: UNDER_VOLTAGE
constexpr uint16_t EMPTY_MV = 6000;  // below: limp
constexpr uint32_t EMPTY_AFTER_US = 500000;  // for so long
constexpr int32_t FINE = 1000;  // a set-point's increments in one of an angle (0.1 mrad)
constexpr int32_t PULSE_CENTRE = 15000;  // 0.1 us, in the middle of a servo's range
constexpr int32_t PULSE_LOWER = 5000;  // 0.1 us
constexpr int32_t PULSE_UPPER = 25000;  // 0.1 us
constexpr int32_t PULSE_PER_RADIAN = 6366;  // 0.1 us/rad
constexpr int32_t ANGLES_PER_RADIAN = 10000;  // increments of an angle in a radian

enum class Instruction : uint8_t {
    GET = 0x01,
    SET = 0x02,
    RESTART = 0x03,
    EXCHANGE = 0x10,
};

enum class Status : uint8_t {
    OK = 0x00,
    UNKNOWN_INSTRUCTION = 0x01,
    WRONG_SIZE = 0x02,
    UNKNOWN_REGISTER = 0x03,
    READ_ONLY = 0x04,
    OUT_OF_RANGE = 0x05,
    NO_ANSWER = 0x10,
    DAMAGED_ANSWER = 0x11,
};

enum class State : uint8_t {
    LIMP = 0x00,
    HOLDING = 0x01,
    DRIVING = 0x02,
    FAULT = 0x03,
};

namespace fault {
constexpr uint8_t WATCHDOG = 0x01;
constexpr uint8_t RESTARTED = 0x02;
constexpr uint8_t UNDER_VOLTAGE = 0x04;
constexpr uint8_t OVER_CURRENT = 0x08;
constexpr uint8_t SILENT_SERVO = 0x10;
constexpr uint8_t EMPTY_BATTERY = 0x20;
constexpr uint8_t LATCHED = 0x2B;
}

constexpr char ROBOT_NAME[17] = "nermo_lite";

enum class Register : uint8_t {
    DEVICE_CLASS = 0x00,  // U8, read only
    DEVICE_ID = 0x01,  // U8, read only
    PROTOCOL_VERSION = 0x02,  // U16, read only
    FIRMWARE_VERSION = 0x03,  // U16, read only
    SERIAL_NUMBER = 0x04,  // U32, read only
    UPTIME = 0x05,  // U32, read only
    BAD_PACKETS = 0x06,  // U32, read only
    FAULTS = 0x07,  // U16, read only
    ROBOT = 0x10,  // TEXT, read only
    BATTERY_VOLTAGE = 0x11,  // U16, read only
    WATCHDOG = 0x12,  // U16, read, write
    SESSION = 0x13,  // U16, read only
    LAST_SEQUENCE = 0x14,  // U16, read only
    STALE_FRAMES = 0x18,  // U32, read only
    REFUSED_FRAMES = 0x19,  // U32, read only
    CLAMPED_TARGETS = 0x1A,  // U32, read only
};

struct Range {
    int16_t lower;   // 0.1 mrad
    int16_t upper;   // 0.1 mrad
    int32_t speed;   // 0.1 mrad/s
};

constexpr int CHANNELS = 11;
constexpr Range RANGES[CHANNELS] = {
    {-7500, 23500, 149600},  // front_left_hip
    {-18500, 12500, 149600},  // front_left_knee
    {-7500, 23500, 149600},  // front_right_hip
    {-18500, 12500, 149600},  // front_right_knee
    {-25000, 6000, 149600},  // rear_left_hip
    {-23500, 7500, 149600},  // rear_left_knee
    {-25000, 6000, 149600},  // rear_right_hip
    {-23500, 7500, 149600},  // rear_right_knee
    {-10000, 10000, 149600},  // spine_lateral
    {-12000, 12000, 149600},  // tail
    {-12000, 12000, 149600},  // head_pan
};

}  // namespace nermo
