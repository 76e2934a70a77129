/* What session.c and safety.c need of the hardware; the host's tests bring their own. */
#ifndef HAL_H
#define HAL_H

#include <stdbool.h>
#include <stdint.h>

#include "config.h"

#ifdef __AVR__
#include <avr/pgmspace.h>
#include <util/atomic.h>
#else
#define PROGMEM
#define PSTR(text) (text)
#define pgm_read_byte(address) (*(const uint8_t *)(address))
#define ATOMIC_BLOCK(how) for (int once = 1; once; once = 0)
#define ATOMIC_RESTORESTATE
#endif

/* Inputs of the converter; the boards' currents come first. */
enum input { FRONT_CURRENT, BACK_CURRENT, SUPPLY, FRONT_RANGE, BACK_RANGE, INPUTS };

/* Readings of one telemetry window, which ended at time_us. */
struct frame {
    uint16_t sequence;
    uint32_t time_us;
    uint32_t sum[INPUTS];
    uint16_t count[INPUTS];
};

struct serial_counts {
    uint16_t overruns; /* bytes received and lost */
    uint16_t dropped;  /* messages for which there was no room */
};

/* From interrupts, or with them off. */
void outputs_off(void); /* at once */
void outputs_prepare(void);

uint32_t clock_us(void);
uint16_t entropy(void);

void sampling_set_period(uint16_t milliseconds); /* 0: no telemetry */
const struct frame *sampling_take(void); /* NULL: no window is complete */
void sampling_release(void);             /* after each frame taken */
uint16_t sampling_lost(void); /* windows that nobody took in time */

bool serial_take(uint8_t *byte);
uint32_t serial_line_time(void); /* of the line end that serial_take gave last */
bool serial_send(const uint8_t *bytes, uint8_t length); /* whole, or not at all */
uint8_t serial_room(void);
uint8_t serial_queued(void); /* bytes not yet sent */
struct serial_counts serial_counts(void);

uint8_t reset_flags(void); /* MCUSR's bits */
uint16_t stack_never_used(void);

#endif
