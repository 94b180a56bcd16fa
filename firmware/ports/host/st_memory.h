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
    int16_t current_ua[ST_MOST_ELECTRODES], pulse_ua[ST_MOST_ELECTRODES];
    st_electrode each[ST_MOST_ELECTRODES];
    uint8_t volts[2u * ST_MOST_SLOTS];
} st_memory;

/* Time is played, and a ramp of 0 ms is none: only in tests. */
static inline void st_configure(st_config *config, st_memory *memory, uint16_t electrodes,
                                uint8_t output, uint16_t ramp_ms)
{
    memset(config, 0, sizeof *config);
    config->electrodes = electrodes;
    config->output = output;
    config->features = ST_KERNELS | (output == ST_WEIGHTED ? ST_RECHARGE : 0);
    config->most_slots = ST_MOST_SLOTS;
    config->ramp_ms = ramp_ms;
    config->no_ramp = ramp_ms == 0u;
    config->played = true;
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
    config->pulse_ua = memory->pulse_ua;
    config->each = memory->each;
    config->volts = memory->volts;
    config->name = "SmartTouch firmware 1";
}

/* Net charge that sources have driven through each electrode; what flows back is not counted. */
typedef struct {
    int64_t pc[ST_MOST_ELECTRODES];
    int16_t recharge_ua[ST_MOST_ELECTRODES];
    uint64_t recharge_from_us;
    uint16_t recharge_us; /* 0 if none is under way */
} st_driven;

/* Add a recharge phase that is over, or was cut off then. */
static inline void st_driven_until(st_driven *driven, uint32_t electrodes, uint64_t until_us)
{
    const uint64_t past_us = until_us - driven->recharge_from_us;
    const uint64_t width_us = past_us < driven->recharge_us ? past_us : driven->recharge_us;
    for (uint32_t each = 0; each < electrodes; each++) {
        driven->pc[each] += driven->recharge_ua[each] * (int64_t)width_us;
    }
    driven->recharge_us = 0;
}

/* Add a pulse. What one source splits equally is split so here; what is over is dropped. */
static inline void st_driven_pulse(st_driven *driven, const st_board *board,
                                   const st_pulse *pulse)
{
    const uint32_t electrodes = board->config.electrodes;
    uint32_t poles[2] = { 0, 0 };
    st_driven_until(driven, electrodes, UINT64_MAX);
    for (uint32_t each = 0; each < electrodes; each++) {
        driven->recharge_ua[each] = pulse->current_ua[each];
        poles[0] += pulse->current_ua[each] > 0;
        poles[1] += pulse->current_ua[each] < 0;
    }
    if (pulse->slot == ST_NOTHING) {
        driven->recharge_from_us = pulse->start_us;
        driven->recharge_us = pulse->width_us;
        return;
    }
    for (uint32_t each = 0; each < electrodes; each++) {
        const int32_t ua = pulse->current_ua[each];
        const int64_t one_pc = (int64_t)pulse->source_ua * pulse->width_us;
        if (board->config.output == ST_WEIGHTED || ua == 0) {
            driven->pc[each] += (int64_t)ua * pulse->width_us;
        } else {
            driven->pc[each] += ua > 0 ? one_pc / poles[0] : -(one_pc / poles[1]);
        }
    }
}

#endif
