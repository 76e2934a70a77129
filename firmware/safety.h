/* The only way to a driven output. Every function is called from interrupts, or with them off.
 * Knows no hardware: compiled on the host too. */
#ifndef SAFETY_H
#define SAFETY_H

#include <stdbool.h>
#include <stdint.h>

#include "config.h"

/* The last is only reported: stopped, and current flows though every output is off. */
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
    /* Of an earlier start, known from trips.c alone. */
    RESTARTED = 15,
    REASON_LOST = 16,
};

struct safety {
    uint8_t state;
    uint8_t cause; /* the first one; stays until reset */
    uint8_t flows; /* boards with a current though their outputs are off, a bit each */
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

/* One command at the present supply: duties in 1/65536, and what they make at most. */
struct drive {
    uint16_t duty[CHANNELS];
    uint16_t explained[BOARDS]; /* mean current through the least resistance, 1/32 step */
    uint16_t square[BOARDS];    /* of the supply in a board's pulse, in (64 mV)^2 */
};

void safety_init(void);
const struct safety *safety_now(void);

void safety_stop(uint8_t cause);
bool safety_arm(void);
void safety_disarm(void);
bool safety_reset(void); /* false while current flows */

/* False beyond config.h; not while armed. Takes long: with interrupts on. */
bool safety_limit(const struct limits *limits);
const struct limits *safety_limits(void);

/* Mean current that a board's duties make at most, in 1/32 step of the converter. */
uint16_t safety_explained(uint8_t board, uint16_t supply_mv, uint32_t duties);

/* `fresh`: a command came; else the same volts at another supply. */
bool safety_drive(const struct drive *drive, bool fresh);

/* What the outputs may be now, each PWM period; NULL and off when nothing may be driven. */
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
