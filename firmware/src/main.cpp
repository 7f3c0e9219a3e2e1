// The board on an ESP32 with Arduino's names: pins, pulses, the line and the supply. Everything else is in lib/pwm_board.
#include <Arduino.h>
#include <board.hpp>
#include <esp_timer.h>
#ifdef NERMO_WIFI_SSID
#include <WiFi.h>
#endif

namespace {

// Servo of each channel in the order of nermo::RANGES; see README.md for the wiring.
constexpr uint8_t SERVO_PINS[nermo::CHANNELS] = {13, 14, 16, 17, 18, 19, 21, 22, 23, 25, 26};
constexpr uint8_t SUPPLY_PIN = 34;   // ADC1, behind the divider
constexpr uint8_t SWITCH_PIN = 27;   // high: the servos have their supply
constexpr uint32_t DIVIDER = 4;      // supply over what the pin sees: 30 kohm above 10 kohm
constexpr uint32_t SUPPLY_EVERY = 10;  // loops between two looks at the supply
constexpr uint8_t PULSE_BITS = 16;
constexpr uint32_t PULSE_FREQUENCY = 1000000 / nermo::PULSE_PERIOD_US;

constexpr uint32_t LONGEST_LOOP_MS = 100;
constexpr uint64_t WATCH_EVERY_US = 20000;

nermo::Board board(0, 0, 0);
uint64_t next_loop = 0;
uint32_t loops = 0;
volatile uint32_t alive_ms = 0;

uint64_t now() { return static_cast<uint64_t>(esp_timer_get_time()); }

#ifdef NERMO_WIFI_SSID
// The line is one TCP connection, the newest: whoever may join the network may drive. See README.md.
WiFiServer server(3333);
WiFiClient line;

void open_line() {
    WiFi.begin(NERMO_WIFI_SSID, NERMO_WIFI_PASSWORD);
    server.begin();
}

void look_at_line() {
    if (!server.hasClient()) return;
    line = server.available();
    line.setNoDelay(true);
}
#else
HardwareSerial& line = Serial;

void open_line() {
    Serial.setTxBufferSize(256);  // an answer never waits for the UART
    Serial.begin(nermo::BAUD);
}

void look_at_line() {}
#endif

void write_line(void*, const uint8_t* data, size_t size) { line.write(data, size); }

void attach(int channel) {
#if ESP_ARDUINO_VERSION_MAJOR >= 3
    ledcAttach(SERVO_PINS[channel], PULSE_FREQUENCY, PULSE_BITS);
#else
    ledcSetup(static_cast<uint8_t>(channel), PULSE_FREQUENCY, PULSE_BITS);
    ledcAttachPin(SERVO_PINS[channel], static_cast<uint8_t>(channel));
#endif
}

// width: [0.1 us]. The hardware takes it over at the begin of the next period.
void put_out(int channel, uint16_t width) {
    const uint32_t duty = (static_cast<uint32_t>(width) << PULSE_BITS) / (nermo::PULSE_PERIOD_US * 10);
#if ESP_ARDUINO_VERSION_MAJOR >= 3
    ledcWrite(SERVO_PINS[channel], duty);
#else
    ledcWrite(static_cast<uint8_t>(channel), duty);
#endif
}

// In a task of its own: pulses go on by themselves, so a loop that hangs would leave the servos where they are.
void watch(void*) {
    if (millis() - alive_ms <= LONGEST_LOOP_MS) return;
    digitalWrite(SWITCH_PIN, LOW);
    esp_restart();
}

}  // namespace

void setup() {
    pinMode(SWITCH_PIN, OUTPUT);
    digitalWrite(SWITCH_PIN, LOW);
    for (int channel = 0; channel < nermo::CHANNELS; ++channel) attach(channel);
    open_line();
    const uint32_t serial_number = static_cast<uint32_t>(ESP.getEfuseMac());
    board = nermo::Board(static_cast<uint16_t>(esp_random()), serial_number, now());
    next_loop = now();
    alive_ms = millis();
    esp_timer_create_args_t arguments = {};
    arguments.callback = watch;
    arguments.name = "watch";
    esp_timer_handle_t timer = nullptr;
    esp_timer_create(&arguments, &timer);
    esp_timer_start_periodic(timer, WATCH_EVERY_US);
}

void loop() {
    alive_ms = millis();
    look_at_line();
    uint8_t bytes[64];
    size_t size = 0;
    while (size < sizeof bytes && line.available() > 0) bytes[size++] = static_cast<uint8_t>(line.read());
    board.receive(bytes, size, now(), {write_line, nullptr});
    if (now() < next_loop) return;
    next_loop += nermo::LOOP_PERIOD_US;
    board.advance(now());
    bool pulses = false;
    for (int channel = 0; channel < nermo::CHANNELS; ++channel) {
        put_out(channel, board.pulse(channel));
        pulses = pulses || board.pulse(channel) != 0;
    }
    digitalWrite(SWITCH_PIN, pulses ? HIGH : LOW);
    if (loops++ % SUPPLY_EVERY == 0) board.supply(static_cast<uint16_t>(analogReadMilliVolts(SUPPLY_PIN) * DIVIDER));
}
