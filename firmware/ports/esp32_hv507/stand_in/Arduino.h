/* Stands in for Arduino-ESP32, so that the shim can be compiled where there is none. */
#ifndef ARDUINO_STAND_IN_H
#define ARDUINO_STAND_IN_H

#include <stddef.h>
#include <stdint.h>

#define OUTPUT 1
#define LOW 0
#define HIGH 1

void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t value);
void noInterrupts(void);
void interrupts(void);
int64_t esp_timer_get_time(void);
uint32_t esp_random(void);
void spi_write_bytes(const uint8_t *data, size_t size);
void dac_write(uint16_t counts);
void one_shot_us(uint32_t delay_us, void (*call)(void));
size_t serial_read(uint8_t *data, size_t most);
void serial_write(const uint8_t *data, size_t size);

#endif
