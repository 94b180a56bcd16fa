/* Kits of shift registers: states into bits, current into counts. */
#include <string.h>

#include "st_shift_registers.h"

#define MOST_UA 5000u

const st_kit st_kajimoto61 = { "Kajimoto 61", 61, 64, 2442, 4095, ST_AD5452, NULL };
const st_kit st_etactilekit64 = { "eTactileKit 64", 64, 64, 9990, 4095, ST_AD5452, NULL };

/* Check that a kit's numbers fit together; touches nothing. */
const char *st_kit_wrong(const st_kit *kit)
{
    if (kit->electrodes == 0u || kit->chain_bits % 8u != 0u || kit->chain_bits < kit->electrodes) {
        return "kit.electrodes or chain_bits is missing or does not fit";
    }
    if (kit->na_per_count == 0u || kit->na_per_count > 50000u
        || (uint32_t)kit->na_per_count * kit->most_counts < 1000u * MOST_UA) {
        return "kit.na_per_count or most_counts is missing, or too small for 5 mA";
    }
    if ((kit->converter != ST_AD5452 && kit->converter != ST_MCP4921)
        || kit->most_counts > 4095u) {
        return "kit.converter is missing: ST_AD5452 or ST_MCP4921, of 4095 counts at most";
    }
    for (uint32_t each = 0; kit->output_of != NULL && each < kit->electrodes; each++) {
        if (kit->output_of[each] >= kit->chain_bits) {
            return "kit.output_of names an output beyond the chain";
        }
    }
    return NULL;
}

/* Divide a current by that of a count, rounded down. */
uint16_t st_kit_counts(const st_kit *kit, uint16_t source_ua)
{
    const uint32_t counts = 1000u * (uint32_t)source_ua / kit->na_per_count;
    return counts > kit->most_counts ? 0u : (uint16_t)counts;
}

/* Place counts as the kit's converter reads them; touches nothing. */
uint16_t st_kit_word(const st_kit *kit, uint16_t counts)
{
    const uint32_t word = kit->converter == ST_MCP4921 ? 0x3000u | counts : (uint32_t)counts << 2;
    return (uint16_t)word;
}

/* Write one bit for each output: 1 for an anode. */
void st_kit_bits(const st_kit *kit, const st_pulse *pulse, uint8_t *bits)
{
    const uint32_t last = kit->chain_bits / 8u - 1u;
    (void)memset(bits, 0, last + 1u);
    for (uint32_t each = 0; each < kit->electrodes; each++) {
        const uint32_t output = kit->output_of != NULL ? kit->output_of[each] : each;
        if (pulse->current_ua[each] < 0) {
            bits[last - output / 8u] |= (uint8_t)(1u << (output % 8u));
        }
    }
}
