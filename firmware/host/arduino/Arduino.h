// Names of Arduino-ESP32 that src/main.cpp uses, so that a compiler of this machine can read it. Nothing of it does anything.
#pragma once

#include <cstddef>
#include <cstdint>

#define HIGH 1
#define LOW 0
#define OUTPUT 3

void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t value);
uint32_t analogReadMilliVolts(uint8_t pin);
uint32_t esp_random();
uint32_t millis();
[[noreturn]] void esp_restart();
#if ESP_ARDUINO_VERSION_MAJOR >= 3
bool ledcAttach(uint8_t pin, uint32_t frequency, uint8_t bits);
bool ledcWrite(uint8_t pin, uint32_t duty);
#else
uint32_t ledcSetup(uint8_t channel, uint32_t frequency, uint8_t bits);
void ledcAttachPin(uint8_t pin, uint8_t channel);
void ledcWrite(uint8_t channel, uint32_t duty);
#endif

struct HardwareSerial {
    size_t setTxBufferSize(size_t size);
    void begin(unsigned long baud);
    int available();
    int read();
    size_t write(const uint8_t* data, size_t size);
};
extern HardwareSerial Serial;

struct EspClass {
    uint64_t getEfuseMac();
};
extern EspClass ESP;
