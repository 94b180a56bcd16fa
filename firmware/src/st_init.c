/* What a board is given: checked before anything flows. */
#include <string.h>

#include "st_inside.h"

/* Return what is wrong with what a board is, or NULL. */
static const char *wrong_config(const st_config *config)
{
    const unsigned known = ST_VOLTAGE | ST_FORCE | ST_RECHARGE | ST_KERNELS | ST_SWITCH;
    if (config->electrodes == 0u || config->electrodes == ST_NOTHING) {
        return "config.electrodes is missing";
    }
    if (config->output < ST_WEIGHTED || config->output > ST_ONE_AGAINST_ALL) {
        return "config.output is missing: ST_WEIGHTED, ST_THREE_STATE or ST_ONE_AGAINST_ALL";
    }
    if ((config->features & ~known) != 0u
        || (config->output != ST_WEIGHTED && (config->features & ST_RECHARGE) != 0u)) {
        return "config.features has one that this board cannot have";
    }
    if (config->most_slots == 0u || config->most_slots > ST_MAX_SLOTS) {
        return "config.most_slots is not from 1 to 8000";
    }
    if (config->packet_bytes < 64u + 8u * (uint32_t)config->electrodes) {
        return "config.packet_bytes is below 64 + 8 for each electrode";
    }
    for (unsigned index = 0; index < ST_BUFFERS; index++) {
        for (unsigned other = 0; other < index; other++) {
            if (config->buffer[index] == config->buffer[other]) {
                return "config.buffer has the same memory twice";
            }
        }
        if (config->buffer[index] == NULL) {
            return "config.buffer is missing";
        }
    }
    if (config->current_ua == NULL || config->pulse_ua == NULL || config->each == NULL
        || config->current_ua == config->pulse_ua) {
        return "config.current_ua, pulse_ua or each is missing, or two are the same";
    }
    if ((config->features & ST_KERNELS) != 0u
        && (config->kernels == NULL || config->kernel_at == NULL || config->sums == NULL
            || config->kernel_bytes == 0u || config->most_kernels == 0u)) {
        return "with ST_KERNELS config.kernels, kernel_at, sums, kernel_bytes or most_kernels is "
               "missing";
    }
    if ((config->features & ST_VOLTAGE) != 0u && config->volts == NULL) {
        return "with ST_VOLTAGE config.volts is missing";
    }
    return config->name == NULL ? "config.name is missing" : NULL;
}

/* Return what is wrong with a port, or NULL. */
static const char *wrong_port(const st_config *config, const st_port *port)
{
    if (port->now_us == NULL || port->draw == NULL || port->send == NULL || port->pulse == NULL
        || port->shorted == NULL) {
        return "port.now_us, draw, send, pulse or shorted is missing";
    }
    if ((config->features & ST_FORCE) != 0u && port->force_mn == NULL) {
        return "with ST_FORCE port.force_mn is missing";
    }
    if ((config->features & ST_VOLTAGE) != 0u && port->volts == NULL) {
        return "with ST_VOLTAGE port.volts is missing";
    }
    if ((config->features & ST_SWITCH) != 0u && port->emergency_open == NULL) {
        return "with ST_SWITCH port.emergency_open is missing";
    }
    return NULL;
}

#define CLOCK_READS 1000000u
#define CLOCK_STEPS 8u
#define CLOCK_STEP_US 50u

/* Return what is wrong with the port's clock, or NULL; waits for a few of its steps. */
static const char *wrong_clock(const st_port *port)
{
    uint64_t before_us = port->now_us(port->self);
    uint64_t least_us = UINT64_MAX;
    unsigned steps = 0;
    for (uint32_t read = 0; read < CLOCK_READS && steps < CLOCK_STEPS; read++) {
        const uint64_t now_us = port->now_us(port->self);
        if (now_us < before_us) {
            return "port.now_us goes back";
        }
        if (now_us > before_us) {
            least_us = now_us - before_us < least_us ? now_us - before_us : least_us;
            before_us = now_us;
            steps++;
        }
    }
    if (steps < CLOCK_STEPS) {
        return "port.now_us stands still";
    }
    return least_us > CLOCK_STEP_US ? "port.now_us goes in steps above 50 us" : NULL;
}

/* Check what is given, clear the board's memory, short all electrodes; waits for steps of the
 * clock. */
const char *st_init(st_board *board, const st_config *config, const st_port *port)
{
    (void)memset(board, 0, sizeof *board);
    board->config = *config;
    board->port = *port;
    board->last_number = -1;
    board->refusing = ST_NOT_BEGUN;
    board->port_us = UINT32_MAX;
    if (port->shorted != NULL) {
        port->shorted(port->self, "start");
    }
    const char *wrong = wrong_config(config);
    wrong = wrong == NULL ? wrong_port(config, port) : wrong;
    wrong = wrong == NULL && !st_is_played(board) ? wrong_clock(port) : wrong;
    if (wrong == NULL) {
        if (config->ramp_ms == 0u) {
            board->config.ramp_ms = ST_SAFE_RAMP_MS;
        }
        (void)memset(config->each, 0, config->electrodes * sizeof *config->each);
        st_session_init(board);
        board->right = true;
    }
    return wrong;
}
