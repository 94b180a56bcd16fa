/* Memory of a board on a machine that has plenty, and what goes into its books. */
#ifndef ST_MEMORY_H
#define ST_MEMORY_H

#include <string.h>

#include "st_board.h"

#define ST_MOST_ELECTRODES 1024u
#define ST_PACKET_BYTES (1u << 20)
#define ST_KERNEL_BYTES (1u << 23)
#define ST_MOST_KERNELS 4096u
#define ST_MOST_SLOTS 4096u

typedef struct {
    uint8_t buffer[ST_BUFFERS][ST_PACKET_BYTES];
    uint8_t kernels[ST_KERNEL_BYTES];
    uint32_t kernel_at[ST_MOST_KERNELS];
    int32_t sums[ST_MOST_ELECTRODES];
    int16_t current_ua[ST_MOST_ELECTRODES];
    st_electrode each[ST_MOST_ELECTRODES];
    uint8_t volts[2u * ST_MOST_SLOTS];
} st_memory;

/* A ramp of 0 ms is none: only in tests. */
static inline void st_configure(st_config *config, st_memory *memory, uint16_t electrodes,
                                uint8_t output, uint16_t ramp_ms)
{
    memset(config, 0, sizeof *config);
    config->electrodes = electrodes;
    config->output = output;
    config->features = ST_KERNELS | (output == ST_WEIGHTED ? ST_RECHARGE : 0);
    config->most_slots = ST_MOST_SLOTS;
    config->ramp_ms = ramp_ms == 0u ? ST_NO_RAMP : ramp_ms;
    config->most_kernels = ST_MOST_KERNELS;
    config->packet_bytes = ST_PACKET_BYTES;
    config->kernel_bytes = ST_KERNEL_BYTES;
    for (unsigned index = 0; index < ST_BUFFERS; index++) {
        config->buffer[index] = memory->buffer[index];
    }
    config->kernels = memory->kernels;
    config->kernel_at = memory->kernel_at;
    config->sums = memory->sums;
    config->current_ua = memory->current_ua;
    config->each = memory->each;
    config->volts = memory->volts;
    config->name = "SmartTouch firmware 1";
}

#endif
