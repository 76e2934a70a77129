/* Four heated wires on an Uno. This file starts things; safety.c decides, session.c talks. */
#include <avr/interrupt.h>
#include <avr/sleep.h>
#include <avr/wdt.h>

#include "hal.h"
#include "parts.h"
#include "safety.h"
#include "session.h"

#define RAM_FIRST 0x100
#define PAINT 0xA5

static uint8_t flags_at_reset __attribute__((section(".noinit")));
extern uint8_t _end;

/* Before the C runtime: a watchdog stays on after its reset, and would bite during start-up.
 * Optiboot clears MCUSR and hands its value over in r2. */
void first_of_all(void) __attribute__((naked, used, section(".init3")));
void first_of_all(void)
{
    uint8_t from_loader;
    __asm__ volatile("mov %0, r2" : "=r"(from_loader));
    flags_at_reset = MCUSR ? MCUSR : from_loader;
    MCUSR = 0;
    wdt_disable();
    for (uint8_t *at = &_end; at <= (uint8_t *)RAMEND; at++)
        *at = PAINT;
}

uint8_t reset_flags(void)
{
    return flags_at_reset & (_BV(PORF) | _BV(EXTRF) | _BV(BORF) | _BV(WDRF));
}

/* To four bytes: looking at every one would take half a millisecond. */
uint16_t stack_never_used(void)
{
    uint16_t free = 0;
    for (const uint8_t *at = &_end; at <= (uint8_t *)RAMEND && *at == PAINT; at += 4)
        free += 4;
    return free;
}

int main(void)
{
    pwm_init();
    safety_init();
    serial_init();
    clock_init();
    sampling_init();
    session_init();
    wdt_enable(WDTO_60MS);
    set_sleep_mode(SLEEP_MODE_IDLE);
    sei();
    for (;;) {
        loop_lives();
        if (!session_run())
            sleep_mode(); /* the next conversion wakes it, 0.1 ms on */
    }
}
