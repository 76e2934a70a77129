/* The converter runs on its own clock, not the PWM's: its averages see every phase of a period. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <stddef.h>
#include <util/atomic.h>

#include "hal.h"
#include "parts.h"
#include "safety.h"

#define SLOTS 8 /* a power of two */

/* Every fourth conversion of a board: 7/16 of a PWM period on, so 16 phases in turn. */
static const uint8_t turns[SLOTS] = {FRONT_CURRENT, BACK_CURRENT, SUPPLY, FRONT_RANGE,
                                     FRONT_CURRENT, BACK_CURRENT, SUPPLY, BACK_RANGE};
/* Analog pin of each input: A0, A1 the boards, A4 the supply, A2, A3 the triangulation sensors. */
static const uint8_t pins[INPUTS] = {
    [FRONT_CURRENT] = 0, [BACK_CURRENT] = 1, [SUPPLY] = 4, [FRONT_RANGE] = 2, [BACK_RANGE] = 3};

static uint8_t slot;
static struct frame frames[2];
static struct frame *growing = &frames[0];
static bool is_ready; /* the one that is not growing holds a whole window */
static uint16_t sequence;
static uint16_t lost;
static uint16_t period_ms;
static uint16_t elapsed_ms;

static void start_conversion(void)
{
    ADMUX = (uint8_t)(_BV(REFS0) | pins[turns[slot]]);
    ADCSRA |= _BV(ADSC);
}

void sampling_init(void)
{
    DIDR0 = 0x3F;
    ADCSRA = _BV(ADEN) | _BV(ADIE) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);
    start_conversion();
}

ISR(ADC_vect)
{
    uint16_t reading = ADC;
    uint8_t input = turns[slot];
    slot = (slot + 1) % SLOTS;
    start_conversion();
    growing->sum[input] += reading;
    growing->count[input]++;
    if (input < BOARDS)
        safety_current(input, reading);
    else if (input == SUPPLY)
        safety_supply(reading);
}

static struct frame *other(void)
{
    return growing == &frames[0] ? &frames[1] : &frames[0];
}

/* The buffers only change roles here, no byte is copied: serial bytes come every 20 us. Without a
 * free buffer the window goes on, and the missing sequence number tells. */
void sampling_tick(uint32_t time_us)
{
    if (!period_ms || ++elapsed_ms < period_ms)
        return;
    elapsed_ms = 0;
    sequence++;
    if (is_ready) {
        lost++;
        return;
    }
    growing->time_us = time_us;
    growing->sequence = sequence;
    growing = other();
    is_ready = true;
}

void sampling_set_period(uint16_t milliseconds)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        period_ms = milliseconds;
        elapsed_ms = 0;
    }
}

const struct frame *sampling_take(void)
{
    const struct frame *frame;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        frame = is_ready ? other() : NULL;
    }
    return frame;
}

void sampling_release(void)
{
    struct frame *frame = other();
    for (uint8_t input = 0; input < INPUTS; input++) {
        frame->sum[input] = 0;
        frame->count[input] = 0;
    }
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        is_ready = false;
    }
}

uint16_t sampling_lost(void)
{
    uint16_t count;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        count = lost;
    }
    return count;
}
