/* All outputs are driven through this file. Every function is called from interrupts, or with them
 * off. Independent of the hardware: also compiled on the host. */
#ifndef SAFETY_H
#define SAFETY_H

#include <stdbool.h>
#include <stdint.h>

#include "config.h"

/* STILL_FLOWING is only reported: stopped, but current flows with all outputs off. */
enum state { IDLE = 0, ARMED = 1, STOPPED = 2, STILL_FLOWING = 3 };

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
    OFF_CURRENT = 10,
    UNEXPLAINED_CURRENT = 11,
    HEAT_LIMIT = 12,
    PWM_STALLED = 13,
    OUTPUT_DIFFERS = 14,
    /* Only from trips.c, about an earlier start. */
    RESTARTED = 15,
    REASON_LOST = 16,
};

struct safety {
    uint8_t state;
    uint8_t cause; /* the first one; stays until reset */
    uint8_t flows; /* bit mask of boards with a current though their outputs are off */
    uint16_t duty[CHANNELS];
};

/* What the host may set for its rig, within config.h. */
struct limits {
    uint16_t max_mv;
    uint16_t mean_ma;
    uint16_t peak_ma;
    uint16_t least_mohm;
    uint16_t hot_mv;
    uint16_t hot_ms;
};

/* One command at the present supply: duties in 1/65536, and their highest possible effects. */
struct drive {
    uint16_t duty[CHANNELS];
    uint16_t explained[BOARDS]; /* mean current at the lowest resistance, 1/32 step */
    uint16_t square[BOARDS];    /* supply voltage squared during a board's pulse, in (64 mV)^2 */
};

void safety_init(void);
const struct safety *safety_now(void);

void safety_stop(uint8_t cause);
bool safety_arm(void);
void safety_disarm(void);
bool safety_reset(void); /* false while current flows */

/* False beyond config.h. Not to be called while armed. Slow, so call it with interrupts on. */
bool safety_limit(const struct limits *limits);
const struct limits *safety_limits(void);

/* Highest mean current that a board's duties can cause, in 1/32 step of the converter. */
uint16_t safety_explained(uint8_t board, uint16_t supply_mv, uint32_t duties);

/* `fresh`: a new command; otherwise the same voltages at another supply. */
bool safety_drive(const struct drive *drive, bool fresh);

/* The duties to apply, each PWM period; NULL, with outputs off, when nothing may be driven. */
const uint16_t *safety_duties(void);

/* Each millisecond; true when the watchdog may be fed. */
bool safety_tick(void);
void safety_loop_lives(void);

/* Raw readings of the converter. */
void safety_current(uint8_t board, uint16_t reading);
void safety_supply(uint16_t reading);
bool safety_supply_is_good(void);
void safety_supply_range(uint16_t low, uint16_t high); /* 1/32 steps */

#endif
