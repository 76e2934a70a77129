/* The two periodic interrupts, each millisecond (Timer1) and each PWM period (Timer0); time stamps;
 * feeding the watchdog. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/wdt.h>
#include <util/atomic.h>

#include "hal.h"
#include "parts.h"
#include "safety.h"

#define TICK_US 1000
#define COUNTS_PER_US 2 /* 16 MHz / 8 */

_Static_assert(F_CPU == 16000000UL, "timer and baud constants are for 16 MHz");

static uint32_t time_us; /* of the last tick */
static volatile uint8_t loop_lived;

void clock_init(void)
{
    OCR1A = TICK_US * COUNTS_PER_US - 1;
    TCCR1A = 0;
    TCCR1B = _BV(WGM12) | _BV(CS11);
    TIMSK1 = _BV(OCIE1A);
}

void loop_lives(void)
{
    loop_lived = 1;
}

ISR(TIMER0_OVF_vect)
{
    const uint16_t *duty = safety_duties();
    if (duty)
        outputs_follow(duty);
}

/* The watchdog is only fed here, and only if everything runs: this interrupt, the main loop, and
 * the outputs' interrupt (checked by safety_tick). */
ISR(TIMER1_COMPA_vect)
{
    time_us += TICK_US;
    if (loop_lived)
        safety_loop_lives();
    if (safety_tick() && loop_lived)
        wdt_reset();
    loop_lived = 0;
    sampling_tick(time_us);
}

uint32_t clock_us_in_interrupt(void)
{
    uint16_t counts = TCNT1;
    uint32_t us = time_us;
    /* The counter has wrapped, but the tick's interrupt is still pending. */
    if ((TIFR1 & _BV(OCF1A)) && counts < OCR1A / 2)
        us += TICK_US;
    return us + counts / COUNTS_PER_US;
}

uint32_t clock_us(void)
{
    uint32_t us;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        us = clock_us_in_interrupt();
    }
    return us;
}
