#pragma once

#include "Arduino.h"

struct WiFiClient {
    void setNoDelay(bool on);
    int available();
    int read();
    size_t write(const uint8_t* data, size_t size);
};

struct WiFiServer {
    explicit WiFiServer(uint16_t port);
    void begin();
    bool hasClient();
    WiFiClient available();
};

struct WiFiClass {
    void begin(const char* name, const char* password);
};
extern WiFiClass WiFi;
