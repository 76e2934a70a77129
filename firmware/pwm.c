/* Four outputs: Timer0 drives the front board, Timer2 the back one, at 976.56 Hz. */
#include <avr/io.h>

#include "hal.h"
#include "parts.h"

/* Inverting fast PWM: low from the start of a period, high after the compare match. Unlike the
 * other polarity it has a true zero (compare value 255), and the timer loads new compare values
 * between two periods, so that going to zero never cuts a pulse. */
#define FRONT_OUTPUTS (_BV(COM0A1) | _BV(COM0A0) | _BV(COM0B1) | _BV(COM0B0))
#define BACK_OUTPUTS (_BV(COM2A1) | _BV(COM2A0) | _BV(COM2B1) | _BV(COM2B0))
#define D_PINS (_BV(PD6) | _BV(PD5) | _BV(PD3)) /* front_1, front_2, back_2 */
#define B_PINS _BV(PB3)                         /* back_1 */
#define COIL_PINS _BV(PD4)                      /* relay coil */

/* Counts of 4 us from a conversion's start (known within two counts) to its sample, which is 1.5
 * clocks of the converter later; the compare values are dithered by one. */
#define SAMPLE_FIRST 3
#define SAMPLE_LAST 6
#define DITHER 1
/* Counts of a pulse that is long enough for conversions to fall into it often. */
#define LONG_PULSE 24

_Static_assert(DUTY_LIMIT_Q16 + 256UL * LONG_PULSE < 65536, "duty plus carried part overflows");

static uint16_t carried[CHANNELS];
static volatile uint8_t gathering; /* boards, a bit each */

void outputs_off(void)
{
    TCCR0A &= (uint8_t)~FRONT_OUTPUTS;
    TCCR2A &= (uint8_t)~BACK_OUTPUTS;
    PORTD &= (uint8_t)~D_PINS;
    PORTB &= (uint8_t)~B_PINS;
    OCR0A = OCR0B = OCR2A = OCR2B = 255;
}

/* A stop in the middle of a pulse leaves the compare unit's flip-flop high; the pin would show it
 * when the unit is connected again. A forced match, which only works outside PWM, clears it. */
void outputs_prepare(void)
{
    TCCR0A = _BV(COM0A1) | _BV(COM0B1);
    TCCR0B |= _BV(FOC0A) | _BV(FOC0B);
    TCCR2A = _BV(COM2A1) | _BV(COM2B1);
    TCCR2B |= _BV(FOC2A) | _BV(FOC2B);
    TCCR0A = _BV(WGM01) | _BV(WGM00);
    TCCR2A = _BV(WGM21) | _BV(WGM20);
    for (uint8_t channel = 0; channel < CHANNELS; channel++)
        carried[channel] = 0;
}

void outputs_gather(uint8_t boards)
{
    gathering = boards;
}

static bool gathers(uint8_t channel)
{
    return gathering & 1 << channel / 2;
}

void relay_close(void)
{
    PORTD |= COIL_PINS;
}

void relay_open(void)
{
    PORTD &= (uint8_t)~COIL_PINS;
}

static volatile uint8_t *const compare_registers[CHANNELS] = {&OCR0A, &OCR0B, &OCR2A, &OCR2B};

static bool is_connected(uint8_t board)
{
    return board ? TCCR2A & BACK_OUTPUTS : TCCR0A & FRONT_OUTPUTS;
}

uint8_t outputs_register(uint8_t channel)
{
    return is_connected(channel / 2) ? (uint8_t)(255 - *compare_registers[channel]) : 0;
}

bool outputs_make(uint8_t channel, uint16_t duty)
{
    uint8_t set = duty >> 8, applied = outputs_register(channel);
    if (duty && set < LONG_PULSE && gathers(channel))
        return applied < 2 * LONG_PULSE;
    return applied == set || applied == set + 1;
}

/* 1: on at the sample, 0: off. A pulse lasts from its compare match to the end of the period. */
static uint8_t board_at_sample(uint8_t board, uint8_t ago)
{
    if (!is_connected(board))
        return 0;
    uint8_t now = board ? TCNT2 : TCNT0;
    if (now < ago) /* it began in the period before */
        return UNSURE;
    now -= ago;
    uint8_t first = *compare_registers[2 * board], last = *compare_registers[2 * board + 1];
    if (now > 255 - SAMPLE_LAST)
        return UNSURE;
    if (last < first) {
        uint8_t other = last;
        last = first;
        first = other;
    }
    if (now + SAMPLE_LAST + DITHER < first)
        return 0;
    if (last == 255) /* one wire alone, or none */
        last = first;
    return now + SAMPLE_FIRST > last + DITHER ? 1 : UNSURE;
}

uint8_t outputs_at_sample(uint8_t ago)
{
    uint8_t front = board_at_sample(0, ago), back = board_at_sample(1, ago);
    return front == UNSURE || back == UNSURE ? UNSURE : (uint8_t)(front | back << 1);
}

void pwm_init(void)
{
    outputs_off();
    relay_open();
    DDRD |= D_PINS | COIL_PINS;
    DDRB |= B_PINS;
    outputs_prepare();
    TCNT0 = 0;
    TCNT2 = 128; /* the boards switch on half a period apart */
    TCCR0B = _BV(CS01) | _BV(CS00);
    TCCR2B = _BV(CS22);
    TIMSK0 = _BV(TOIE0);
}

/* 16 bit of duty on 8 bit of PWM: the remainder of one period is carried to the next. Conversions
 * may miss the pulses of a small duty: while the supply's drop is unknown, several are joined. */
static uint8_t compare_value(uint8_t channel, uint16_t duty)
{
    uint16_t sum = duty ? duty + carried[channel] : 0; /* fits: the duty limit leaves room */
    if (sum < 256 * LONG_PULSE && gathers(channel)) {
        carried[channel] = sum;
        return 255;
    }
    carried[channel] = (uint8_t)sum;
    return (uint8_t)(255 - (sum >> 8));
}

void outputs_follow(const uint16_t *duty)
{
    OCR0A = compare_value(0, duty[0]);
    OCR0B = compare_value(1, duty[1]);
    OCR2A = compare_value(2, duty[2]);
    OCR2B = compare_value(3, duty[3]);
    TCCR0A |= FRONT_OUTPUTS;
    TCCR2A |= BACK_OUTPUTS;
}
