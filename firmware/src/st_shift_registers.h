/* Boards of one current source and push-pull high-voltage shift registers, as eTactileKit and the
 * 61 electrodes of Kajimoto's kit have: HV507, HV513. Each electrode is one bit of the chain: 1
 * connects it to the source's rail, the anode, 0 to ground, the cathode. POL stays high, and BL low
 * puts all outputs at ground: all electrodes are shorted.
 *
 * A kit is ST_ONE_AGAINST_ALL. Everything here is arithmetic; pins are the port's.
 */
#ifndef ST_KIT_H
#define ST_KIT_H

#include "st_board.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Converters, by the word of 16 bits that sets them. */
enum st_converter {
    ST_AD5452 = 1, /* two zeros, counts, two zeros; taken on falling edges: SPI mode 1 */
    ST_MCP4921 = 2 /* 0x3, unbuffered, once the reference, on; then counts; rising edges: mode 0 */
};

typedef struct {
    const char *name;
    uint16_t electrodes;
    uint16_t chain_bits;   /* outputs of all registers, a multiple of 8 */
    uint16_t na_per_count; /* of the converter and the source's resistor: measure it */
    uint16_t most_counts;  /* of the converter */
    uint8_t converter;     /* ST_AD5452 or ST_MCP4921: the word of one is a strong current of the other */
    const uint16_t *output_of; /* (E,) output of each electrode; NULL: 0, 1, 2 ... */
} st_kit;

/* Kajimoto's 61 electrodes: 4095 counts are 10 mA. */
extern const st_kit st_kajimoto61;
/* eTactileKit with 64 electrodes: 4095 counts are 41 mA. */
extern const st_kit st_etactilekit64;

/* Return what is wrong with a kit, or NULL: its converter must be known and reach 5 mA, and a count
 * be no more than 50 uA. */
const char *st_kit_wrong(const st_kit *kit);
/* Return the converter's counts of a current, rounded down; 0 if that is more than it has. */
uint16_t st_kit_counts(const st_kit *kit, uint16_t source_ua);
/* Return the word that sets the converter to some counts. */
uint16_t st_kit_word(const st_kit *kit, uint16_t counts);
/* Write the bits of a pulse, (chain_bits / 8,), as they go out: the last output first, highest bit
 * first. Outputs without an electrode are 0. */
void st_kit_bits(const st_kit *kit, const st_pulse *pulse, uint8_t *bits);

#ifdef __cplusplus
}
#endif

#endif
