/* A kit's board on an ESP32 (Arduino-ESP32 3.x), with the pins of Kajimoto's own sketches: registers
 * at 13 and 14, converter at 18, 23 and 22.
 *
 * NOT SEEN on hardware. Check the pins and na_per_count (in st_shift_registers.c) against your own board, and go
 * through the checklist of firmware/README.md on a dummy load first. A timer's interrupt ends
 * each pulse here: let a monostable on BL end it as well, for when the processor stands still.
 */
#include <Arduino.h>
#include <SPI.h>

#include <st_shift_registers.h>

static const st_kit &kit = st_kajimoto61;

enum { DATA = 13, CLOCK = 14, BL = 25, LE = 26, POL = 27, SELECT = 22, SWITCH = 33 };
static const uint16_t ELECTRODES = 64;
static const uint32_t PACKET_BYTES = 8192;

static st_board board;
static uint8_t buffer[ST_BUFFERS][PACKET_BYTES];
static int16_t current_ua[ELECTRODES], pulse_ua[ELECTRODES];
static st_electrode electrodes[ELECTRODES];
static SPIClass registers(HSPI);
static hw_timer_t *timer;
static portMUX_TYPE lock = portMUX_INITIALIZER_UNLOCKED;

static void convert(uint16_t counts)
{
    digitalWrite(SELECT, LOW);
    SPI.transfer16(st_kit_word(&kit, counts));
    digitalWrite(SELECT, HIGH);
}

/* Ground all outputs; the converter follows from the loop, as SPI is not for interrupts. */
static void IRAM_ATTR end_pulse()
{
    digitalWrite(BL, LOW);
}

static void IRAM_ATTR on_switch()
{
    st_zero(&board, "emergency");
}

static uint64_t now_us(void *)
{
    return (uint64_t)esp_timer_get_time();
}

static uint32_t draw(void *)
{
    return esp_random() | 1u;
}

static void send(void *, const uint8_t *data, size_t size)
{
    Serial.write(data, size);
}

static uint64_t pulse(void *, const st_pulse *given)
{
    uint8_t bits[ELECTRODES / 8];
    uint64_t begun_us = ST_NOT_BEGUN_US;
    digitalWrite(BL, LOW);
    convert(0);
    st_kit_bits(&kit, given, bits);
    registers.transfer(bits, kit.chain_bits / 8);
    digitalWrite(LE, HIGH);
    digitalWrite(LE, LOW);
    timerAlarm(timer, given->width_us, false, 0);
    portENTER_CRITICAL(&lock);
    if (st_may_pulse(&board)) {
        begun_us = now_us(nullptr);
        timerRestart(timer);
        digitalWrite(BL, HIGH);
        convert(st_kit_counts(&kit, given->source_ua));
    }
    portEXIT_CRITICAL(&lock);
    return begun_us;
}

static void IRAM_ATTR shorted(void *, const char *)
{
    end_pulse();
}

static bool emergency_open(void *)
{
    return digitalRead(SWITCH) == HIGH;
}

void setup()
{
    digitalWrite(BL, LOW);
    pinMode(BL, OUTPUT);
    digitalWrite(POL, HIGH);
    pinMode(POL, OUTPUT);
    pinMode(LE, OUTPUT);
    pinMode(SELECT, OUTPUT);
    pinMode(SWITCH, INPUT_PULLUP);
    digitalWrite(SELECT, HIGH);
    registers.begin(CLOCK, -1, DATA);
    registers.beginTransaction(SPISettings(8000000, MSBFIRST, SPI_MODE0));
    SPI.begin();
    const uint8_t mode = kit.converter == ST_AD5452 ? SPI_MODE1 : SPI_MODE0;
    SPI.beginTransaction(SPISettings(10000000, MSBFIRST, mode));
    convert(0);
    Serial.setRxBufferSize(4096);
    Serial.begin(921600);
    timer = timerBegin(1000000);
    timerAttachInterrupt(timer, end_pulse);

    st_port port = {};
    port.now_us = now_us;
    port.draw = draw;
    port.send = send;
    port.pulse = pulse;
    port.shorted = shorted;
    port.emergency_open = emergency_open;
    st_config config = {};
    config.electrodes = kit.electrodes;
    config.output = ST_ONE_AGAINST_ALL;
    config.features = ST_SWITCH;
    config.most_slots = 1024;
    config.ramp_ms = 500;
    config.packet_bytes = PACKET_BYTES;
    for (unsigned index = 0; index < ST_BUFFERS; index++) {
        config.buffer[index] = buffer[index];
    }
    config.current_ua = current_ua;
    config.pulse_ua = pulse_ua;
    config.each = electrodes;
    config.name = kit.name;
    const char *wrong = st_kit_wrong(&kit);
    wrong = wrong == nullptr ? st_init(&board, &config, &port) : wrong;
    if (wrong != nullptr) {
        Serial.println(wrong);
    }
    attachInterrupt(SWITCH, on_switch, RISING);
}

void loop()
{
    uint8_t data[256];
    const size_t waiting = Serial.available();
    if (waiting > 0) {
        st_feed(&board, data, Serial.read(data, waiting < sizeof data ? waiting : sizeof data));
    } else {
        st_advance(&board);
    }
}
