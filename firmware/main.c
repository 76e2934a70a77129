/* Four heated wires on an Uno. This file starts things; safety.c decides, session.c talks. */
#include <avr/interrupt.h>
#include <avr/sleep.h>
#include <avr/wdt.h>

#include "parts.h"
#include "safety.h"
#include "session.h"

int main(void)
{
    pwm_init();
    start_init();
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
            sleep_mode(); /* until the next conversion, within 0.1 ms */
    }
}
