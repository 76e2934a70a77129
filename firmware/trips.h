/* The last trip, stored in EEPROM: its cause, and how long after a start. Two records in turn, of
 * which only the older is overwritten. Independent of the hardware: also compiled on the host. */
#ifndef TRIPS_H
#define TRIPS_H

#include <stdbool.h>
#include <stdint.h>

struct trip {
    uint8_t cause; /* NO_CAUSE: there was none */
    bool open;     /* not yet acknowledged */
    uint32_t at;   /* 0.1 s, since the start before it */
};

void trips_init(bool outlasted); /* `outlasted`: memory is as it was before a reset */
struct trip trips_last(void);
void trips_look(void); /* note a new trip; the interrupts have already switched off */
void trips_acknowledge(void);
void trips_follow(void); /* in each turn of the loop: looks, writes at most one byte, never waits */

#endif
