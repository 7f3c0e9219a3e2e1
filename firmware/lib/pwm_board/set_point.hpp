// Where one servo shall be: within its range, no faster than it turns, and on its way from target to target.
#pragma once

#include <cstdint>

#include "constants.hpp"

namespace nermo {

class SetPoint {
public:
    SetPoint() = default;
    explicit SetPoint(const Range& range) : range_(range) {}

    // Brings an angle [0.1 mrad] into the range.
    int16_t within(int16_t angle) const {
        return angle < range_.lower ? range_.lower : angle > range_.upper ? range_.upper : angle;
    }

    // Nobody knows where the servo is: the next target is where it goes at its own speed.
    void forget() { known_ = false; }
    bool known() const { return known_; }

    // Goes to an angle [0.1 mrad] in a time [us].
    void go(int16_t angle, uint32_t time) {
        goal_ = within(angle) * FINE;
        if (!known_) position_ = goal_;
        known_ = true;
        start_ = position_;
        time_ = time;
        passed_ = 0;
    }

    // Stays where it is.
    void stop() { goal_ = start_ = position_; }

    // Some time has passed [us], at most LONGEST_STEP_US.
    void step(uint32_t passed) {
        if (!known_) return;
        passed_ = passed_ + passed < time_ ? passed_ + passed : time_;
        int32_t wanted = goal_;
        if (passed_ < time_) {
            wanted = start_ + static_cast<int32_t>(int64_t{goal_ - start_} * passed_ / time_);
        }
        const int32_t most = static_cast<int32_t>(int64_t{range_.speed} * FINE * passed / 1000000);
        const int32_t way = wanted - position_;
        position_ += way > most ? most : way < -most ? -most : way;
    }

    // Width of the pulse [0.1 us].
    uint16_t pulse() const {
        const int64_t middle = int64_t{range_.lower + range_.upper} * FINE / 2;
        const int64_t width = PULSE_CENTRE + (position_ - middle) * PULSE_PER_RADIAN / (int64_t{ANGLES_PER_RADIAN} * FINE);
        return static_cast<uint16_t>(width < PULSE_LOWER ? PULSE_LOWER : width > PULSE_UPPER ? PULSE_UPPER : width);
    }

private:
    Range range_ = {};
    bool known_ = false;
    int32_t position_ = 0;  // 0.1 mrad / FINE, as start_ and goal_
    int32_t start_ = 0;
    int32_t goal_ = 0;
    uint32_t time_ = 0;    // us, from start to goal
    uint32_t passed_ = 0;  // us
};

}  // namespace nermo
