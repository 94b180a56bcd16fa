/* Stands in for the headers of Arduino-ESP32, 3.x, so that the example can be compiled where there
 * are none. */
#ifndef ARDUINO_STAND_IN_H
#define ARDUINO_STAND_IN_H

#include <stddef.h>
#include <stdint.h>

#define OUTPUT 1
#define INPUT_PULLUP 5
#define LOW 0
#define HIGH 1
#define RISING 1
#define IRAM_ATTR
#define MSBFIRST 1
#define SPI_MODE0 0
#define SPI_MODE1 1
#define HSPI 2

typedef int portMUX_TYPE;
#define portMUX_INITIALIZER_UNLOCKED 0
void portENTER_CRITICAL(portMUX_TYPE *mux);
void portEXIT_CRITICAL(portMUX_TYPE *mux);
void portENTER_CRITICAL_ISR(portMUX_TYPE *mux);
void portEXIT_CRITICAL_ISR(portMUX_TYPE *mux);

void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t value);
int digitalRead(uint8_t pin);
void attachInterrupt(uint8_t pin, void (*call)(void), int mode);
int64_t esp_timer_get_time(void);
uint32_t esp_random(void);

struct hw_timer_t;
hw_timer_t *timerBegin(uint32_t frequency);
void timerAttachInterrupt(hw_timer_t *timer, void (*call)(void));
void timerAlarm(hw_timer_t *timer, uint64_t alarm, bool again, uint64_t count);
void timerRestart(hw_timer_t *timer);

struct SPISettings {
    SPISettings(uint32_t clock, uint8_t order, uint8_t mode);
};
struct SPIClass {
    explicit SPIClass(uint8_t bus);
    void begin(int8_t clock = -1, int8_t in = -1, int8_t out = -1);
    void beginTransaction(SPISettings settings);
    void endTransaction();
    void transfer(void *data, uint32_t size);
    void transfer16(uint16_t data);
};
extern SPIClass SPI;
struct SerialClass {
    void begin(unsigned long baud);
    void setRxBufferSize(size_t size);
    size_t available();
    size_t read(uint8_t *data, size_t size);
    size_t write(const uint8_t *data, size_t size);
    void println(const char *text);
};
extern SerialClass Serial;

#endif
