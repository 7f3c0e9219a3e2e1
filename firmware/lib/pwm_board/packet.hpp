// Packets out of a stream of bytes that may hold anything, and into one. No heap, no exceptions, no hardware.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "constants.hpp"

namespace nermo {

// Where answers go: on the microcontroller the UART, on a host a buffer.
struct Sink {
    void (*write)(void* self, const uint8_t* data, size_t size);
    void* self;
};

// Fields of a payload, little-endian, one after another. Who reads or writes knows that they fit.
class Reader {
public:
    explicit Reader(const uint8_t* data) : at_(data) {}
    uint8_t u8() { return *at_++; }
    uint16_t u16() {
        const uint16_t low = u8();
        return static_cast<uint16_t>(low | u8() << 8);
    }
    int16_t i16() { return static_cast<int16_t>(u16()); }

private:
    const uint8_t* at_;
};

class Writer {
public:
    explicit Writer(uint8_t* data) : begin_(data), at_(data) {}
    void u8(uint8_t value) { *at_++ = value; }
    void u16(uint16_t value) {
        u8(static_cast<uint8_t>(value & 0xFF));
        u8(static_cast<uint8_t>(value >> 8));
    }
    void u32(uint32_t value) {
        u16(static_cast<uint16_t>(value & 0xFFFF));
        u16(static_cast<uint16_t>(value >> 16));
    }
    int size() const { return static_cast<int>(at_ - begin_); }

private:
    uint8_t* begin_;
    uint8_t* at_;
};

// 8-bit sum of all bytes of a packet but its header and the sum itself.
inline uint8_t checksum(const uint8_t* body, int size) {
    unsigned sum = 0;
    for (int place = 0; place < size; ++place) sum += body[place];
    return static_cast<uint8_t>(sum & 0xFF);
}

// CRC-16/CCITT-FALSE, bit by bit: 29 bytes a packet need no table.
inline uint16_t crc16(const uint8_t* data, int size) {
    unsigned crc = 0xFFFF;
    for (int place = 0; place < size; ++place) {
        crc ^= static_cast<unsigned>(data[place]) << 8;
        for (int bit = 0; bit < 8; ++bit) crc = (crc & 0x8000 ? crc << 1 ^ 0x1021 : crc << 1) & 0xFFFF;
    }
    return static_cast<uint16_t>(crc);
}

// Finds packets for this board. A header byte that turns out to be none costs only itself: the search goes on with the
// byte after it. Its buffer never holds more than one packet, so each byte costs a bounded number of steps.
class Parser {
public:
    // Takes a byte; `take(code, payload, size)` is called for each packet that is complete now.
    template <typename Take>
    void feed(uint8_t byte, Take take) {
        buffer_[count_++] = byte;
        scan(take);
    }

    // The line has been quiet for longer than within a packet: what waits will never be complete.
    template <typename Take>
    void flush(Take take) {
        while (count_ > 0) {
            drop(1);
            scan(take);
        }
    }

    uint32_t corrupt = 0;  // packets with a wrong checksum

private:
    static constexpr int CAPACITY = OVERHEAD + REQUEST_SIZE;

    template <typename Take>
    void scan(Take take) {
        while (count_ > 0) {
            if (buffer_[0] != HEADER || (count_ > 1 && buffer_[1] != DEVICE_CLASS) ||
                (count_ > 2 && buffer_[2] != DEVICE_ID) || (count_ > 3 && buffer_[3] > REQUEST_SIZE)) {
                drop(1);
                continue;
            }
            if (count_ < PREAMBLE) return;
            const int size = buffer_[3], whole = OVERHEAD + size;
            if (count_ < whole) return;
            if (checksum(buffer_ + 1, whole - 2) != buffer_[whole - 1]) {
                ++corrupt;
                drop(1);
                continue;
            }
            uint8_t payload[REQUEST_SIZE] = {};
            const uint8_t code = buffer_[4];
            std::memcpy(payload, buffer_ + PREAMBLE, static_cast<size_t>(size));
            drop(whole);
            take(code, payload, size);
        }
    }

    void drop(int bytes) {
        count_ -= bytes;
        std::memmove(buffer_, buffer_ + bytes, static_cast<size_t>(count_));
    }

    uint8_t buffer_[CAPACITY] = {};
    int count_ = 0;
};

}  // namespace nermo
