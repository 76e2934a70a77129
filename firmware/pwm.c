/* Four outputs: Timer0 drives the front board, Timer2 the back one, at 976.56 Hz. */
#include <avr/interrupt.h>
#include <avr/io.h>

#include "hal.h"
#include "parts.h"
#include "safety.h"

/* Inverting fast PWM: low from the start of a period, high after the compare match. Unlike the
 * other polarity it knows a true zero (compare value 255), and the timer takes new compare values
 * over between two periods, so that a level of zero needs no switching in the middle of a pulse. */
#define FRONT_OUTPUTS (_BV(COM0A1) | _BV(COM0A0) | _BV(COM0B1) | _BV(COM0B0))
#define BACK_OUTPUTS (_BV(COM2A1) | _BV(COM2A0) | _BV(COM2B1) | _BV(COM2B0))
#define D_PINS (_BV(PD6) | _BV(PD5) | _BV(PD3)) /* front_1, front_2, back_2 */
#define B_PINS _BV(PB3)                         /* back_1 */

static uint8_t carried[CHANNELS];

void outputs_off(void)
{
    TCCR0A &= (uint8_t)~FRONT_OUTPUTS;
    TCCR2A &= (uint8_t)~BACK_OUTPUTS;
    PORTD &= (uint8_t)~D_PINS;
    PORTB &= (uint8_t)~B_PINS;
    OCR0A = OCR0B = OCR2A = OCR2B = 255;
}

/* A stop in the middle of a pulse leaves the compare unit's own flip-flop high, unseen at the pin
 * until the unit is connected again. A forced match, which only works outside PWM, clears it. */
void outputs_prepare(void)
{
    TCCR0A = _BV(COM0A1) | _BV(COM0B1);
    TCCR0B |= _BV(FOC0A) | _BV(FOC0B);
    TCCR2A = _BV(COM2A1) | _BV(COM2B1);
    TCCR2B |= _BV(FOC2A) | _BV(FOC2B);
    TCCR0A = _BV(WGM01) | _BV(WGM00);
    TCCR2A = _BV(WGM21) | _BV(WGM20);
}

void pwm_init(void)
{
    outputs_off();
    DDRD |= D_PINS;
    DDRB |= B_PINS;
    outputs_prepare();
    TCNT0 = 0;
    TCNT2 = 128; /* the boards switch on half a period apart */
    TCCR0B = _BV(CS01) | _BV(CS00);
    TCCR2B = _BV(CS22);
    TIMSK0 = _BV(TOIE0);
}

/* 16 bit of duty on 8 bit of PWM: what one period cannot give goes to the next. */
static uint8_t compare_value(uint8_t channel, uint16_t duty)
{
    uint16_t sum = duty + carried[channel]; /* fits: the duty limit leaves room */
    carried[channel] = (uint8_t)sum;
    return (uint8_t)(255 - (sum >> 8));
}

ISR(TIMER0_OVF_vect)
{
    const uint16_t *duty = safety_duties();
    if (!duty)
        return;
    OCR0A = compare_value(0, duty[0]);
    OCR0B = compare_value(1, duty[1]);
    OCR2A = compare_value(2, duty[2]);
    OCR2B = compare_value(3, duty[3]);
    TCCR0A |= FRONT_OUTPUTS;
    TCCR2A |= BACK_OUTPUTS;
}
