// Exchanges as a host sends them, and answers as it judges them.
#pragma once

#include <vector>

#include "board.hpp"

namespace nermo::host {

using Bytes = std::vector<uint8_t>;

inline Sink into(Bytes& bytes) {
    return {[](void* self, const uint8_t* data, size_t size) {
                auto& out = *static_cast<Bytes*>(self);
                out.insert(out.end(), data, data + size);
            },
            &bytes};
}

inline Bytes packet(uint8_t code, const Bytes& payload) {
    Bytes raw{HEADER, DEVICE_CLASS, DEVICE_ID, static_cast<uint8_t>(payload.size()), code};
    raw.insert(raw.end(), payload.begin(), payload.end());
    raw.push_back(checksum(raw.data() + 1, static_cast<int>(raw.size()) - 1));
    return raw;
}

inline Bytes exchange(uint16_t session, uint16_t sequence, uint8_t flags, uint16_t way, const int16_t* targets) {
    Bytes payload(REQUEST_SIZE);
    Writer writer(payload.data());
    writer.u16(session);
    writer.u16(sequence);
    writer.u8(flags);
    writer.u16(way);
    for (int channel = 0; channel < CHANNELS; ++channel) writer.u16(static_cast<uint16_t>(targets[channel]));
    writer.u16(crc16(payload.data(), writer.size()));
    return packet(static_cast<uint8_t>(Instruction::EXCHANGE), payload);
}

}  // namespace nermo::host
