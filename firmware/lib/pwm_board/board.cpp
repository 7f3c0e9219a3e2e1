#include "board.hpp"

namespace nermo {

namespace {

// A loop that was held up for longer [us] is no reason to move further at once.
constexpr uint64_t LONGEST_STEP_US = 20 * LOOP_PERIOD_US;

constexpr bool is_newer(uint16_t sequence, uint16_t than) {
    return sequence != than && static_cast<uint16_t>(sequence - than) < 0x8000;
}

}  // namespace

Board::Board(uint16_t session, uint32_t serial_number, uint64_t now)
    : serial_number_(serial_number), session_(session), now_(now), started_(now), heard_(now), full_(now) {
    for (int channel = 0; channel < CHANNELS; ++channel) set_points_[channel] = SetPoint(RANGES[channel]);
}

void Board::receive(const uint8_t* data, size_t size, uint64_t now, Sink sink) {
    advance(now);
    auto taken = [&](uint8_t code, const uint8_t* payload, int length) { take(code, payload, length, sink); };
    if (size > 0) {
        if (now_ - heard_ > LARGEST_PAUSE_US) parser_.flush(taken);
        heard_ = now_;
    }
    for (size_t place = 0; place < size; ++place) parser_.feed(data[place], taken);
}

void Board::advance(uint64_t now) {
    if (now < now_) return;
    const uint64_t passed = now - now_;
    now_ = now;
    if (powered_) {
        if (moving_ && now_ - point_ >= HOLD_US) {
            moving_ = false;
            for (SetPoint& servo : set_points_) servo.stop();
        }
        const uint32_t step = static_cast<uint32_t>(passed < LONGEST_STEP_US ? passed : LONGEST_STEP_US);
        for (SetPoint& servo : set_points_) servo.step(step);
        if (now_ - accepted_ >= uint64_t{watchdog_ms_} * 1000) latch(fault::WATCHDOG);
    }
    faults_ = static_cast<uint8_t>(faults_ & ~fault::UNDER_VOLTAGE);
    if (millivolts_ < LOW_MV) faults_ = static_cast<uint8_t>(faults_ | fault::UNDER_VOLTAGE);
    if (millivolts_ >= EMPTY_MV) full_ = now_;
    if (now_ - full_ >= EMPTY_AFTER_US) latch(fault::EMPTY_BATTERY);
}

uint16_t Board::pulse(int channel) const {
    if (channel < 0 || channel >= CHANNELS || !powered_ || !pointed_) return 0;
    return now_ - pulses_ >= uint64_t{STAGGER_US} * static_cast<unsigned>(channel) ? set_points_[channel].pulse() : 0;
}

State Board::state() const {
    if (faults_ & fault::LATCHED) return State::FAULT;
    if (!powered_ || !pointed_) return State::LIMP;
    return moving_ ? State::DRIVING : State::HOLDING;
}

void Board::take(uint8_t code, const uint8_t* payload, int size, Sink sink) {
    switch (static_cast<Instruction>(code)) {
        case Instruction::GET:
            if (size != 1) return answer(Status::WRONG_SIZE, nullptr, 0, sink);
            return get(payload[0], sink);
        case Instruction::SET:
            if (size < 1) return answer(Status::WRONG_SIZE, nullptr, 0, sink);
            return set(payload[0], payload + 1, size - 1, sink);
        case Instruction::RESTART:
            answer(Status::OK, nullptr, 0, sink);
            return restart();
        case Instruction::EXCHANGE:
            if (size != REQUEST_SIZE) return answer(Status::WRONG_SIZE, nullptr, 0, sink);
            return exchange(payload, sink);
    }
    answer(Status::UNKNOWN_INSTRUCTION, nullptr, 0, sink);
}

void Board::get(uint8_t address, Sink sink) const {
    uint8_t value[sizeof ROBOT_NAME] = {};
    Writer writer(value);
    switch (static_cast<Register>(address)) {
        case Register::DEVICE_CLASS: writer.u8(DEVICE_CLASS); break;
        case Register::DEVICE_ID: writer.u8(DEVICE_ID); break;
        case Register::PROTOCOL_VERSION: writer.u16(PROTOCOL_VERSION); break;
        case Register::FIRMWARE_VERSION: writer.u16(FIRMWARE_VERSION); break;
        case Register::SERIAL_NUMBER: writer.u32(serial_number_); break;
        case Register::UPTIME: writer.u32(static_cast<uint32_t>((now_ - started_) / 1000)); break;
        case Register::BAD_PACKETS: writer.u32(parser_.corrupt + wrong_crcs_); break;
        case Register::FAULTS: writer.u16(faults_); break;
        case Register::ROBOT:
            for (size_t place = 0; place + 1 < sizeof ROBOT_NAME; ++place) writer.u8(static_cast<uint8_t>(ROBOT_NAME[place]));
            break;
        case Register::BATTERY_VOLTAGE: writer.u16(millivolts_); break;
        case Register::WATCHDOG: writer.u16(watchdog_ms_); break;
        case Register::SESSION: writer.u16(session_); break;
        case Register::LAST_SEQUENCE: writer.u16(last_sequence_); break;
        case Register::STALE_FRAMES: writer.u32(stale_); break;
        case Register::REFUSED_FRAMES: writer.u32(refused_); break;
        case Register::CLAMPED_TARGETS: writer.u32(clamped_); break;
        default: return answer(Status::UNKNOWN_REGISTER, nullptr, 0, sink);
    }
    answer(Status::OK, value, writer.size(), sink);
}

void Board::set(uint8_t address, const uint8_t* value, int size, Sink sink) {
    switch (static_cast<Register>(address)) {
        case Register::WATCHDOG: {
            if (size != 2) return answer(Status::WRONG_SIZE, nullptr, 0, sink);
            const uint16_t wanted = Reader(value).u16();
            if (wanted < WATCHDOG_LOWER_MS || wanted > WATCHDOG_UPPER_MS) {
                return answer(Status::OUT_OF_RANGE, nullptr, 0, sink);
            }
            watchdog_ms_ = wanted;
            return answer(Status::OK, nullptr, 0, sink);
        }
        case Register::DEVICE_CLASS:
        case Register::DEVICE_ID:
        case Register::PROTOCOL_VERSION:
        case Register::FIRMWARE_VERSION:
        case Register::SERIAL_NUMBER:
        case Register::UPTIME:
        case Register::BAD_PACKETS:
        case Register::FAULTS:
        case Register::ROBOT:
        case Register::BATTERY_VOLTAGE:
        case Register::SESSION:
        case Register::LAST_SEQUENCE:
        case Register::STALE_FRAMES:
        case Register::REFUSED_FRAMES:
        case Register::CLAMPED_TARGETS: return answer(Status::READ_ONLY, nullptr, 0, sink);
    }
    answer(Status::UNKNOWN_REGISTER, nullptr, 0, sink);
}

void Board::exchange(const uint8_t* payload, Sink sink) {
    constexpr int CHECKED = REQUEST_SIZE - 2;
    if (crc16(payload, CHECKED) != Reader(payload + CHECKED).u16()) {
        ++wrong_crcs_;  // whoever sent it cannot be told: it may say anything
        return;
    }
    Reader reader(payload);
    const uint16_t session = reader.u16(), sequence = reader.u16();
    const uint8_t flags = reader.u8();
    const uint16_t way = reader.u16();
    int16_t targets[CHANNELS];
    bool numbers = true;
    for (int16_t& target : targets) {
        target = reader.i16();
        numbers = numbers && target != NO_NUMBER;
    }
    if (session != session_ || (counting_ && !is_newer(sequence, last_sequence_))) {
        ++stale_;
        return answer_exchange(sequence, sink);
    }
    const bool possible = numbers && way >= 1 && way <= LONGEST_WAY_MS;
    if ((flags & ~FLAGS) != 0 || ((flags & POINT) != 0 && !possible)) {
        ++refused_;
        return answer(Status::OUT_OF_RANGE, nullptr, 0, sink);
    }
    last_sequence_ = sequence;
    counting_ = true;
    accept(flags, way, targets);
    answer_exchange(sequence, sink);
}

void Board::accept(uint8_t flags, uint16_t way, const int16_t* targets) {
    accepted_ = now_;
    if (flags & ACKNOWLEDGE) faults_ = static_cast<uint8_t>(faults_ & ~fault::LATCHED);
    if (now_ - full_ >= EMPTY_AFTER_US) latch(fault::EMPTY_BATTERY);
    if ((faults_ & fault::LATCHED) || !(flags & POWER)) return go_limp();
    powered_ = true;
    if (!(flags & POINT)) return;
    if (!pointed_) {
        pulses_ = now_;
        // A servo that has missed no pulse is still where it was.
        if (now_ - limp_ >= PULSE_PERIOD_US) {
            for (SetPoint& servo : set_points_) servo.forget();
        }
    }
    pointed_ = moving_ = true;
    point_ = now_;
    for (int channel = 0; channel < CHANNELS; ++channel) {
        SetPoint& servo = set_points_[channel];
        clamped_ += servo.within(targets[channel]) != targets[channel];
        servo.go(targets[channel], uint32_t{way} * 1000);
    }
}

void Board::restart() {
    const uint16_t next = static_cast<uint16_t>(session_ + 1), supply = millivolts_;
    *this = Board(next, serial_number_, now_);
    millivolts_ = supply;
}

void Board::latch(uint8_t fault) {
    if (faults_ & fault) return;
    faults_ = static_cast<uint8_t>(faults_ | fault);
    ++session_;
    counting_ = false;
    go_limp();
}

void Board::go_limp() {
    if (pointed_) limp_ = now_;
    powered_ = pointed_ = moving_ = false;
    for (SetPoint& servo : set_points_) servo.stop();
}

void Board::answer(Status status, const uint8_t* payload, int size, Sink sink) const {
    uint8_t packet[OVERHEAD + ANSWER_SIZE];
    packet[0] = HEADER;
    packet[1] = DEVICE_CLASS;
    packet[2] = DEVICE_ID;
    packet[3] = static_cast<uint8_t>(size);
    packet[4] = static_cast<uint8_t>(status);
    if (size > 0) std::memcpy(packet + PREAMBLE, payload, static_cast<size_t>(size));
    packet[PREAMBLE + size] = checksum(packet + 1, PREAMBLE - 1 + size);
    sink.write(sink.self, packet, static_cast<size_t>(OVERHEAD + size));
}

void Board::answer_exchange(uint16_t echo, Sink sink) const {
    uint8_t payload[ANSWER_SIZE];
    Writer writer(payload);
    writer.u16(session_);
    writer.u16(echo);
    writer.u16(last_sequence_);
    writer.u8(static_cast<uint8_t>(state()));
    writer.u8(faults_);
    writer.u16(millivolts_);
    writer.u16(static_cast<uint16_t>((parser_.corrupt + wrong_crcs_) & 0xFFFF));
    writer.u16(static_cast<uint16_t>(stale_ & 0xFFFF));
    writer.u16(static_cast<uint16_t>(refused_ & 0xFFFF));
    writer.u16(static_cast<uint16_t>(clamped_ & 0xFFFF));
    writer.u32(static_cast<uint32_t>((now_ - started_) & 0xFFFFFFFF));
    for (int channel = 0; channel < CHANNELS; ++channel) writer.u16(pulse(channel));
    writer.u16(crc16(payload, writer.size()));
    answer(Status::OK, payload, writer.size(), sink);
}

}  // namespace nermo
