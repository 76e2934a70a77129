/* The hardware as session.c and safety.c need it; tests on the host have their own version. */
#ifndef HAL_H
#define HAL_H

#include <stdbool.h>
#include <stdint.h>

#include "config.h"

#ifdef __AVR__
#include <avr/pgmspace.h>
#include <util/atomic.h>
#define OUTLASTS __attribute__((section(".noinit"))) /* survives a reset, but not a power cut */
#else
#define OUTLASTS
#define PROGMEM
#define PSTR(text) (text)
#define pgm_read_byte(address) (*(const uint8_t *)(address))
#define pgm_read_dword(address) (*(const uint32_t *)(address))
#define ATOMIC_BLOCK(how) for (int once = 1; once; once = 0)
#define ATOMIC_RESTORESTATE
#endif

/* Inputs of the converter; the boards' currents come first. */
enum input { FRONT_CURRENT, BACK_CURRENT, SUPPLY, FRONT_RANGE, BACK_RANGE, INPUTS, BANDGAP };

/* In place of a bit mask of boards whose outputs are on: close to an edge of a pulse. */
#define UNSURE 0xFF

/* Readings of one telemetry window, which ended at time_us. */
struct frame {
    uint16_t sequence;
    uint32_t time_us;
    uint32_t sum[INPUTS];
    uint16_t count[INPUTS];
};

struct serial_counts {
    uint16_t overruns; /* bytes received and lost */
    uint16_t dropped;  /* messages that did not fit into the buffer */
};

/* From interrupts, or with them off. */
void outputs_off(void); /* at once */
void outputs_prepare(void);
uint8_t outputs_register(uint8_t channel); /* what is applied, in 1/256, read back */
bool outputs_make(uint8_t channel, uint16_t duty); /* true: the output fits this duty */
void outputs_gather(uint8_t boards); /* bit mask: join short pulses to ones that can be sampled */
void relay_close(void);
void relay_open(void);

uint32_t clock_us(void);
uint16_t entropy(void);

uint16_t sampling_reference(void); /* 0.1 mV of AVcc */
void sampling_follow(void); /* in each turn of the loop */
uint16_t sampling_supply(void); /* without load, 1/64 of a step */
uint16_t sampling_supply_of_window(void); /* since the last call */
uint16_t sampling_drop(uint8_t board); /* of the supply while the board is on, 1/64 of a step */
void sampling_learn_drops(void); /* again, as the wires may have been changed */

void sampling_set_period(uint16_t milliseconds); /* 0: no telemetry */
const struct frame *sampling_take(void); /* NULL: no window is complete */
void sampling_release(void);             /* after each frame taken */
uint16_t sampling_lost(void); /* windows that were not taken in time */

bool serial_take(uint8_t *byte);
uint32_t serial_line_time(void); /* arrival of the line end that serial_take returned last */
bool serial_send(const uint8_t *bytes, uint8_t length); /* whole, or not at all */
uint8_t serial_room(void);
uint8_t serial_queued(void); /* bytes not yet sent */
struct serial_counts serial_counts(void);

uint8_t reset_flags(void); /* MCUSR's bits */
uint16_t stack_never_used(void);
uint16_t start_entropy(void); /* of memory at power-on and the number of starts */
void remember_cause(uint8_t cause); /* across a reset */
uint8_t cause_before(void); /* of the stop before the reset; 0 for none or unknown */

/* Bytes that survive a power cut. When ready, reading and writing do not wait; it is not ready for
 * 3.4 ms after each written byte. */
bool store_is_ready(void);
uint8_t store_read(uint8_t place);
void store_write(uint8_t place, uint8_t byte);

#endif
