// The board on stdin and stdout, in a time that it is told. Little-endian records:
//   in:  u8 what, u64 now [us], u16 size, size bytes
//   out: u16 size, size bytes for the line, u8 state, u16 session, CHANNELS x u16 pulse [0.1 us]
// what: 'b' bytes from the line (none: time goes on), 'v' supply (u16 [mV]), 'r' power comes back (u16 session).
// Time goes on in loops of the firmware, so that a jump is what the loops between would have made of it.
#include <cstdio>

#include "frames.hpp"

using namespace nermo;

namespace {

constexpr uint64_t LONGEST_SLEEP_US = 60000000;  // of this machine, through which every loop is run

bool read(uint8_t* data, size_t size) { return std::fread(data, 1, size, stdin) == size; }

void put16(host::Bytes& bytes, uint16_t value) {
    bytes.push_back(static_cast<uint8_t>(value & 0xFF));
    bytes.push_back(static_cast<uint8_t>(value >> 8));
}

}  // namespace

int main() {
    uint16_t session = 1;
    uint64_t loop = 0;
    Board board(session, 1, 0);
    uint8_t head[11];
    host::Bytes data, out, line;
    while (read(head, sizeof head)) {
        uint64_t now = 0;
        for (int byte = 8; byte > 0; --byte) now = now << 8 | head[byte];
        data.resize(Reader(head + 9).u16());
        if (!data.empty() && !read(data.data(), data.size())) break;
        if (now > loop + LONGEST_SLEEP_US) loop = now - LONGEST_SLEEP_US;
        for (; loop + LOOP_PERIOD_US <= now; board.advance(loop)) loop += LOOP_PERIOD_US;
        line.clear();
        if (head[0] == 'r' && data.size() == 2) {
            board = Board(Reader(data.data()).u16(), 1, now);
        } else if (head[0] == 'v' && data.size() == 2) {
            board.supply(Reader(data.data()).u16());
        } else if (head[0] == 'b') {
            board.receive(data.data(), data.size(), now, host::into(line));
        } else {
            std::fprintf(stderr, "record %u with %zu bytes is unknown\n", head[0], data.size());
            return 2;
        }
        out.clear();
        put16(out, static_cast<uint16_t>(line.size()));
        out.insert(out.end(), line.begin(), line.end());
        out.push_back(static_cast<uint8_t>(board.state()));
        put16(out, board.session());
        for (int channel = 0; channel < CHANNELS; ++channel) put16(out, board.pulse(channel));
        std::fwrite(out.data(), 1, out.size(), stdout);
        std::fflush(stdout);
    }
    return 0;
}
