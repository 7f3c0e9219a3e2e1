// How many exchanges a second this machine takes in, answers and a loop of the board included.
//   rate EXCHANGES      prints `name value` lines
#include <chrono>
#include <cstdio>
#include <cstdlib>

#include "frames.hpp"

using namespace nermo;

int main(int count, char** words) {
    const long exchanges = count > 1 ? std::strtol(words[1], nullptr, 10) : 200000;
    Board board(1, 1, 0);
    int16_t targets[CHANNELS] = {};
    host::Bytes out;
    uint64_t now = 0;
    long driving = 0;
    std::chrono::duration<double> spent{0};
    for (long number = 1; number <= exchanges; ++number) {
        targets[0] = static_cast<int16_t>(number % 1000);
        const host::Bytes raw = host::exchange(1, static_cast<uint16_t>(number & 0xFFFF), FLAGS, 5, targets);
        out.clear();
        now += LOOP_PERIOD_US;
        const auto begin = std::chrono::steady_clock::now();
        board.receive(raw.data(), raw.size(), now, host::into(out));
        spent += std::chrono::steady_clock::now() - begin;
        driving += board.state() == State::DRIVING;
    }
    std::printf("exchanges %ld\ndriving %ld\nnanoseconds_each %.0f\n", exchanges, driving, spent.count() * 1e9 / static_cast<double>(exchanges));
    return driving == exchanges ? 0 : 1;
}
