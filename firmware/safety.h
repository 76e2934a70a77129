/* The only way to a driven output. Every function is called from interrupts, or with them off.
 * Knows no hardware: compiled on the host too. */
#ifndef SAFETY_H
#define SAFETY_H

#include <stdbool.h>
#include <stdint.h>

#include "config.h"

enum state { IDLE = 0, ARMED = 1, STOPPED = 2 };

enum cause {
    NO_CAUSE = 0,
    STOP_BYTE_SEEN = 1,
    COMMAND_TIMEOUT = 2,
    FRONT_OVER_CURRENT = 3,
    BACK_OVER_CURRENT = 4,
    DUTY_LIMIT = 5,
    ON_TIME_LIMIT = 6,
    SUPPLY_RANGE = 7,
    LOOP_STALLED = 8,
    NO_SAMPLES = 9,
};

struct safety {
    uint8_t state;
    uint8_t cause; /* the first one; stays until reset */
    uint16_t duty[CHANNELS];
};

void safety_init(void);
const struct safety *safety_now(void);

void safety_stop(uint8_t cause);
bool safety_arm(void);
void safety_disarm(void);
void safety_reset(void);

/* New duties in 1/65536. `fresh`: a command came; else the same volts at another supply. */
bool safety_drive(const uint16_t duty[CHANNELS], bool fresh);

/* What the outputs may be now, each PWM period; NULL and off when nothing may be driven. */
const uint16_t *safety_duties(void);

/* Each millisecond; true when the watchdog may be fed. */
bool safety_tick(void);
void safety_loop_lives(void);

/* Raw readings of the converter. */
void safety_current(uint8_t board, uint16_t reading);
void safety_supply(uint16_t reading);
bool safety_supply_is_good(void);
uint16_t safety_supply_mv(void);

#endif
