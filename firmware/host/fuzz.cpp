// Random and mutated bytes into the board, with exchanges between them that drive it, and a strict judge.
//   fuzz BYTES SEED     prints what was found as `name value` lines; exit status 1 where something is wrong
#include <cstdio>
#include <cstdlib>
#include <random>

#include "frames.hpp"

using namespace nermo;
using host::Bytes;

namespace {

struct Report {
    uint64_t bytes = 0, exchanges = 0, accepted = 0, answers = 0, driving_loops = 0, restarts = 0;
    uint64_t pulses_out_of_range = 0, pulses_too_fast = 0, pulses_without_power = 0, wrong_accepted = 0,
             damaged_answers = 0;

    bool passed() const {
        return pulses_out_of_range + pulses_too_fast + pulses_without_power + wrong_accepted + damaged_answers == 0;
    }
};

class Fuzzer {
public:
    explicit Fuzzer(uint32_t seed) : dice_(seed), board_(1, 1, 0) {}

    Report run(uint64_t bytes) {
        while (report.bytes < bytes) {
            const Bytes chunk = piece();
            report.bytes += chunk.size();
            size_t place = 0;
            while (place < chunk.size()) {
                const size_t step = 1 + roll(OVERHEAD + REQUEST_SIZE);  // never two exchanges together
                send(chunk.data() + place, step < chunk.size() - place ? step : chunk.size() - place);
                place += step;
            }
            pass_time();
        }
        return report;
    }

    Report report;

private:
    static constexpr ptrdiff_t LONG_AGO = 256;

    uint32_t roll(uint32_t sides) { return static_cast<uint32_t>(dice_() % sides); }

    Bytes noise(uint32_t size) {
        Bytes bytes(size);
        for (uint8_t& byte : bytes) byte = static_cast<uint8_t>(roll(256));
        return bytes;
    }

    // An exchange that may be accepted, or is wrong in what it asks for, or old.
    Bytes exchange() {
        ++report.exchanges;
        int16_t targets[CHANNELS];
        const bool wild = roll(4) == 0;
        for (int channel = 0; channel < CHANNELS; ++channel) {
            const Range& range = RANGES[channel];
            targets[channel] = static_cast<int16_t>(
                wild ? static_cast<int>(roll(65536)) - 32768
                     : range.lower + static_cast<int>(roll(static_cast<uint32_t>(range.upper - range.lower + 1))));
        }
        uint8_t flags = POWER | POINT | (roll(8) == 0 ? ACKNOWLEDGE : 0);
        if (roll(20) == 0) flags = static_cast<uint8_t>(roll(256));
        const uint16_t way = static_cast<uint16_t>(roll(20) == 0 ? roll(65536) : 1 + roll(LONGEST_WAY_MS));
        const uint16_t session = static_cast<uint16_t>(roll(20) == 0 ? roll(65536) : board_.session());
        sequence_ = static_cast<uint16_t>(sequence_ + (roll(20) == 0 ? roll(65536) : 1));
        return host::exchange(session, sequence_, flags, way, targets);
    }

    Bytes request() {
        const Bytes known = {0, 1, 2, 3, 4, 5, 6, 7, 0x10, 0x11, 0x12, 0x13, 0x14, 0x18, 0x19, 0x1A, 0x1B, 0xFF};
        Bytes payload{known[roll(static_cast<uint32_t>(known.size()))]};
        if (roll(2)) return host::packet(1, payload);
        const Bytes value = noise(roll(5));
        payload.insert(payload.end(), value.begin(), value.end());
        return host::packet(static_cast<uint8_t>(roll(8) == 0 ? roll(256) : 2), payload);
    }

    Bytes mutated() {
        Bytes raw = roll(3) ? exchange() : request();
        for (uint32_t changes = 1 + roll(3); changes > 0 && !raw.empty(); --changes) {
            const uint32_t place = roll(static_cast<uint32_t>(raw.size())), kind = roll(5);
            const auto at = raw.begin() + place;
            if (kind < 2) *at = static_cast<uint8_t>(*at ^ 1u << roll(8));
            else if (kind == 2) *at = static_cast<uint8_t>(roll(256));
            else if (kind == 3) raw.erase(at);
            else raw.insert(at, static_cast<uint8_t>(roll(256)));
        }
        return raw;
    }

    Bytes piece() {
        switch (roll(10)) {
            case 0: return noise(1 + roll(120));
            case 1: return Bytes(1 + roll(12), HEADER);
            case 2: {  // cut off
                Bytes raw = exchange();
                raw.resize(1 + roll(static_cast<uint32_t>(raw.size()) - 1));
                return raw;
            }
            case 3: return request();
            case 4:
            case 5:
            case 6: return mutated();
            default: return exchange();
        }
    }

    void send(const uint8_t* data, size_t size) {
        Bytes out;
        recent_.insert(recent_.end(), data, data + size);
        if (recent_.size() > LONG_AGO) recent_.erase(recent_.begin(), recent_.end() - LONG_AGO);
        board_.receive(data, size, now_, host::into(out));
        judge_answers(out);
        judge_pulses(0);
    }

    void pass_time() {
        const uint64_t loops = roll(500) == 0 ? 100 + roll(900) : roll(8);
        for (uint64_t loop = 0; loop < loops; ++loop) {
            now_ += LOOP_PERIOD_US;
            board_.advance(now_);
            judge_pulses(LOOP_PERIOD_US);
        }
        if (roll(2000) == 0) {
            board_ = Board(static_cast<uint16_t>(roll(65536)), 1, now_);
            ++report.restarts;
            judge_pulses(0);
        }
        if (roll(200) == 0) board_.supply(static_cast<uint16_t>(roll(10) ? 6700 + roll(1700) : roll(65536)));
    }

    // Packets come whole from the board, and what it says that it accepted has come whole.
    void judge_answers(const Bytes& out) {
        size_t place = 0;
        while (place < out.size()) {
            const uint8_t* raw = out.data() + place;
            const size_t left = out.size() - place;
            const int size = left >= OVERHEAD ? raw[3] : 255;
            if (raw[0] != HEADER || static_cast<size_t>(OVERHEAD + size) > left ||
                checksum(raw + 1, PREAMBLE - 1 + size) != raw[PREAMBLE + size]) {
                ++report.damaged_answers;
                return;
            }
            ++report.answers;
            if (size == ANSWER_SIZE) {
                Reader reader(raw + PREAMBLE + 2);
                const uint16_t echo = reader.u16(), last = reader.u16();
                if (echo == last && last != accepted_) {
                    ++report.accepted;
                    accepted_ = last;
                    if (!came_whole(last)) ++report.wrong_accepted;
                }
            }
            place += static_cast<size_t>(OVERHEAD + size);
        }
    }

    // Whether an exchange of that sequence stands in what was sent last.
    bool came_whole(uint16_t sequence) const {
        constexpr int SIZE = OVERHEAD + REQUEST_SIZE;
        for (size_t place = 0; place + SIZE <= recent_.size(); ++place) {
            const uint8_t* raw = recent_.data() + place;
            if (raw[0] == HEADER && raw[1] == DEVICE_CLASS && raw[2] == DEVICE_ID && raw[3] == REQUEST_SIZE &&
                raw[4] == static_cast<uint8_t>(Instruction::EXCHANGE) && checksum(raw + 1, SIZE - 2) == raw[SIZE - 1] &&
                crc16(raw + PREAMBLE, REQUEST_SIZE - 2) == Reader(raw + SIZE - 3).u16() &&
                Reader(raw + PREAMBLE + 2).u16() == sequence) {
                return true;
            }
        }
        return false;
    }

    void judge_pulses(uint32_t passed) {
        const State state = board_.state();
        if (state == State::DRIVING) ++report.driving_loops;
        for (int channel = 0; channel < CHANNELS; ++channel) {
            const int pulse = board_.pulse(channel), before = before_[channel];
            const Range& range = RANGES[channel];
            const int half = (range.upper - range.lower) * PULSE_PER_RADIAN / (2 * ANGLES_PER_RADIAN) + 1;
            const double most = 1e-6 * passed * range.speed / ANGLES_PER_RADIAN * PULSE_PER_RADIAN + 1.0;
            if (pulse != 0 && (pulse < PULSE_LOWER || pulse > PULSE_UPPER || std::abs(pulse - PULSE_CENTRE) > half)) {
                ++report.pulses_out_of_range;
            }
            if (pulse != 0 && (state == State::FAULT || state == State::LIMP)) ++report.pulses_without_power;
            // Where a stream begins, a servo goes at its own speed.
            if (pulse != 0 && before != 0 && std::abs(pulse - before) > most) ++report.pulses_too_fast;
            before_[channel] = pulse;
        }
    }

    std::mt19937 dice_;
    Board board_;
    uint64_t now_ = 0;
    uint16_t sequence_ = 0;
    uint16_t accepted_ = 0;
    Bytes recent_;
    int before_[CHANNELS] = {};
};

}  // namespace

int main(int count, char** words) {
    const uint64_t bytes = count > 1 ? std::strtoull(words[1], nullptr, 10) : 10000000;
    const uint32_t seed = count > 2 ? static_cast<uint32_t>(std::strtoul(words[2], nullptr, 10)) : 0;
    Fuzzer fuzzer(seed);
    const Report r = fuzzer.run(bytes);
    const struct { const char* name; uint64_t value; } rows[] = {
        {"bytes", r.bytes}, {"exchanges", r.exchanges}, {"accepted", r.accepted}, {"answers", r.answers},
        {"driving_loops", r.driving_loops}, {"restarts", r.restarts},
        {"pulses_out_of_range", r.pulses_out_of_range}, {"pulses_too_fast", r.pulses_too_fast},
        {"pulses_without_power", r.pulses_without_power}, {"wrong_accepted", r.wrong_accepted},
        {"damaged_answers", r.damaged_answers}};
    for (const auto& row : rows) std::printf("%s %llu\n", row.name, static_cast<unsigned long long>(row.value));
    return r.passed() ? 0 : 1;
}
