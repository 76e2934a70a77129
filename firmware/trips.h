/* The last trip, kept where it outlasts the power: why, and how long after a start. Two records in
 * turn, of which only the older one is ever written on. Knows no hardware: compiled on the host too. */
#ifndef TRIPS_H
#define TRIPS_H

#include <stdbool.h>
#include <stdint.h>

struct trip {
    uint8_t cause; /* NO_CAUSE: there was none */
    bool open;     /* nobody has acknowledged it */
    uint32_t at;   /* 0.1 s after the start before it */
};

void trips_init(bool outlasted); /* memory is as it was before a reset */
struct trip trips_last(void);
void trips_look(void); /* whether there is a new one; the interrupts have switched off before */
void trips_acknowledge(void);
void trips_follow(void); /* in each turn of the loop: looks, and begins a byte at most, never waits */

#endif
