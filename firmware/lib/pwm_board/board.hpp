// What the board does with bytes and with time. Pulses are all that comes out, beside answers.
//
// It starts limp. An exchange that acknowledges, and says the session that the board is in, lets the servos have pulses.
// Silence, a restart or an empty battery make it limp by itself, which ends the session: no frame from before counts.
#pragma once

#include <cstddef>
#include <cstdint>

#include "constants.hpp"
#include "packet.hpp"
#include "set_point.hpp"

namespace nermo {

class Board {
public:
    // session: of the start; one that the start before did not have. now: [us], on a clock that never runs backwards.
    Board(uint16_t session, uint32_t serial_number, uint64_t now);

    // Bytes from the line; answers are written to the sink.
    void receive(const uint8_t* data, size_t size, uint64_t now, Sink sink);

    // Time has come to now. Call it once a loop.
    void advance(uint64_t now);

    // The supply [mV]; until it is told, it counts as not measured.
    void supply(uint16_t millivolts) { millivolts_ = millivolts; }

    // Width of a channel's pulse [0.1 us]; 0 where there shall be none.
    uint16_t pulse(int channel) const;

    State state() const;

    // What an exchange must say to be accepted.
    uint16_t session() const { return session_; }

private:
    void take(uint8_t code, const uint8_t* payload, int size, Sink sink);
    void get(uint8_t address, Sink sink) const;
    void set(uint8_t address, const uint8_t* value, int size, Sink sink);
    void exchange(const uint8_t* payload, Sink sink);
    void accept(uint8_t flags, uint16_t way, const int16_t* targets);
    void restart();
    void latch(uint8_t fault);
    void go_limp();
    void answer(Status status, const uint8_t* payload, int size, Sink sink) const;
    void answer_exchange(uint16_t echo, Sink sink) const;

    Parser parser_;
    SetPoint set_points_[CHANNELS];
    uint32_t serial_number_;
    uint16_t session_;
    uint16_t last_sequence_ = 0;
    bool counting_ = false;  // whether an exchange of this session was accepted
    uint8_t faults_ = fault::RESTARTED;
    bool powered_ = false;
    bool pointed_ = false;  // whether there was a point since there is power
    bool moving_ = false;   // whether the last point is young
    uint16_t millivolts_ = NO_READING;
    uint16_t watchdog_ms_ = WATCHDOG_MS;
    uint64_t now_;
    uint64_t started_;
    uint64_t heard_;        // the last byte
    uint64_t accepted_ = 0; // the last exchange
    uint64_t point_ = 0;    // the last point
    uint64_t pulses_ = 0;   // the first pulse
    uint64_t limp_ = 0;     // the last pulse
    uint64_t full_;         // when the battery was not empty last
    uint32_t wrong_crcs_ = 0;
    uint32_t stale_ = 0;
    uint32_t refused_ = 0;
    uint32_t clamped_ = 0;
};

}  // namespace nermo
