/* The converter runs freely, so that no late interrupt (least of all one of the PWM) shifts its
 * samples, and its averages contain all phases of a PWM period equally. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <stddef.h>
#include <util/atomic.h>

#include "hal.h"
#include "parts.h"
#include "safety.h"

#define SLOTS 8 /* a power of two */

/* Counts of 4 us from one conversion's end to the next; the first takes 25 clocks, not 13. */
#define CONVERSION 26
#define FIRST_CONVERSION 50
#define TOO_LATE 24 /* it is then unknown which conversion a reading belongs to */

/* Every fourth conversion is of the same board, 13/32 of a PWM period later: 32 phases in turn. */
static const uint8_t turns[SLOTS] = {FRONT_CURRENT, BACK_CURRENT, SUPPLY, FRONT_RANGE,
                                     FRONT_CURRENT, BACK_CURRENT, SUPPLY, BACK_RANGE};
/* Analog pin of each input: A0, A1 the boards, A4 the supply, A2, A3 the triangulation sensors. */
static const uint8_t pins[INPUTS] = {
    [FRONT_CURRENT] = 0, [BACK_CURRENT] = 1, [SUPPLY] = 4, [FRONT_RANGE] = 2, [BACK_RANGE] = 3};

/* The chip's 1.1 V reference measures AVcc, but settles slowly after a change of input: now and then
 * a burst of conversions of it, of which only the last count. */
#define BANDGAP_PIN 14
#define BURST 9 /* odd: after it, conversions fall on 32 other phases of the pulses */
#define BURST_COUNTED 4
#define ROUNDS 128
#define BANDGAP_SHIFT 8 /* its mean is over about 256 of those that count */
#define DROP_SHIFT 5
#define DROP_READINGS 8 /* after so many a drop counts as known */
#define TRIES 255 /* give up then: if one board is nearly always on, the other is never on alone */
/* Readings queued for the main loop, which has the time to process them; the oldest are lost. */
#define NOTED 16 /* a power of two */
#define KIND_SHIFT 12
#define OF_BANDGAP 4 /* other kinds: of the supply, a bit mask of the boards that were on */

static uint8_t slot;
static uint8_t running; /* input of the present conversion */
static uint8_t following; /* of the next one: it is chosen while one runs */
static uint8_t ended; /* count of Timer0 at the end of the last one, or up to two before */
static uint8_t burst, rounds;
static uint8_t lit; /* bit mask of boards that are on at the sample, or UNSURE */
static volatile uint16_t noted[NOTED];
static volatile uint8_t noted_in;
static uint8_t noted_out;
static volatile uint16_t entropy_pool;

/* Used by the main loop only; means in 1/1024 step. */
static int32_t bandgap_mean;
static uint16_t reference = REFERENCE_MV * 10U;
static int32_t supply_mean; /* without load */
static int32_t drops[BOARDS]; /* of the supply by a pulse of this board */
static uint8_t learned[BOARDS]; /* readings of that, up to DROP_READINGS */
static uint8_t loaded; /* readings with any board on, up to TRIES */
static uint32_t supply_sum; /* since sampling_supply_of_window, in 1/32 step */
static uint16_t supply_count;

static struct frame frames[2];
static struct frame *growing = &frames[0];
static bool is_ready; /* the other frame holds a complete window */
static uint16_t sequence;
static uint16_t lost;
static uint16_t period_ms;
static uint16_t elapsed_ms;

static void choose(uint8_t input)
{
    following = input;
    ADMUX = (uint8_t)(_BV(REFS0) | (input == BANDGAP ? BANDGAP_PIN : pins[input]));
}

static void start_converter(void)
{
    ADCSRA = 0;
    running = turns[slot];
    lit = UNSURE;
    choose(running);
    ADCSRA = _BV(ADEN) | _BV(ADSC) | _BV(ADATE) | _BV(ADIF) | _BV(ADIE) | _BV(ADPS2) | _BV(ADPS1) |
             _BV(ADPS0);
    ended = (uint8_t)(TCNT0 + FIRST_CONVERSION - CONVERSION);
}

static uint8_t next_input(void)
{
    if (burst) {
        burst--;
        return BANDGAP;
    }
    slot = (slot + 1) % SLOTS;
    if (!slot && ++rounds >= ROUNDS) {
        rounds = 0;
        burst = BURST;
    }
    return turns[slot];
}

static void note(uint16_t reading, uint8_t kind)
{
    noted[noted_in % NOTED] = reading | (uint16_t)kind << KIND_SHIFT;
    noted_in++;
}

/* Rounded: without this a slow mean would stay an eighth of a step too low. */
static int32_t share(int32_t change, uint8_t shift)
{
    return (change + (1L << shift >> 1)) >> shift;
}

/* The first readings weigh more: a mean of few is better than the nominal value. */
static void take_bandgap(int32_t reading)
{
    static uint8_t counted;
    uint8_t shift = BANDGAP_SHIFT;
    if (counted < 64)
        shift = ++counted <= 1 ? 0 : counted < 8 ? 2 : counted < 32 ? 4 : 6;
    bandgap_mean += share(reading - bandgap_mean, shift);
    uint32_t found = BANDGAP_MV * 10UL * ADC_STEPS * 64 / ((uint32_t)share(bandgap_mean, 4) | 1);
    /* Ignore values outside the data sheet's range. */
    if (found > REFERENCE_MV * 8UL && found < REFERENCE_MV * 12UL)
        reference = (uint16_t)found;
}

/* A plain mean of the first readings, later a running mean. */
static uint8_t drop_shift(uint8_t board)
{
    uint8_t count = learned[board];
    if (count == DROP_READINGS)
        return DROP_SHIFT;
    learned[board]++;
    return count < 1 ? 0 : count < 2 ? 1 : count < 4 ? 2 : 3;
}

/* Loads lower the supply only during their pulses: estimate the drop of each board, and correct
 * readings to the supply without load. */
static void take_supply(int32_t reading, uint8_t boards)
{
    for (uint8_t board = 0; board < BOARDS; board++) {
        if (boards == 1 << board) {
            int32_t change = supply_mean - reading - drops[board];
            drops[board] += share(change, drop_shift(board));
            if (drops[board] < 0)
                drops[board] = 0;
        }
        if (boards & 1 << board)
            reading += drops[board];
    }
    if (boards && loaded < TRIES)
        loaded++;
    supply_mean += supply_mean ? share(reading - supply_mean, DROP_SHIFT) : reading;
    supply_sum += (uint32_t)share(reading, 5);
    supply_count++;
}

void sampling_follow(void)
{
    if ((uint8_t)(noted_in - noted_out) > NOTED / 2)
        noted_out = noted_in - NOTED / 2;
    while (noted_out != noted_in) {
        uint16_t entry = noted[noted_out++ % NOTED];
        int32_t reading = (int32_t)(entry & (ADC_STEPS - 1)) << 10;
        if (entry >> KIND_SHIFT == OF_BANDGAP)
            take_bandgap(reading);
        else
            take_supply(reading, (uint8_t)(entry >> KIND_SHIFT));
    }
    uint8_t unknown = 0;
    for (uint8_t board = 0; board < BOARDS; board++)
        if (learned[board] < DROP_READINGS && loaded < TRIES)
            unknown |= (uint8_t)(1 << board);
    outputs_gather(unknown);
}

void sampling_learn_drops(void)
{
    for (uint8_t board = 0; board < BOARDS; board++) {
        learned[board] = 0;
        drops[board] = 0; /* the drop of a short circuit would forbid all voltages from then on */
    }
    loaded = 0;
}

void sampling_init(void)
{
    DIDR0 = 0x3F;
    ADCSRB = 0;
    start_converter();
}

ISR(ADC_vect)
{
    uint16_t reading = ADC;
    uint8_t input = running, was_lit = lit;
    ended += CONVERSION;
    uint8_t late = (uint8_t)(TCNT0 - ended);
    if (late >= TOO_LATE) {
        start_converter();
        return;
    }
    running = following;
    choose(next_input());
    if (running == SUPPLY)
        lit = outputs_at_sample(late);
    entropy_pool = (uint16_t)((entropy_pool << 1 | entropy_pool >> 15) + reading);
    if (input == BANDGAP) {
        if (burst < BURST_COUNTED)
            note(reading, OF_BANDGAP);
        return;
    }
    growing->sum[input] += reading;
    growing->count[input]++;
    if (input < BOARDS)
        safety_current(input, reading);
    if (input == SUPPLY) {
        safety_supply(reading);
        if (was_lit != UNSURE)
            note(reading, was_lit);
    }
}

/* From the converter's noise and the time of the call. */
uint16_t entropy(void)
{
    uint16_t pool;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        pool = entropy_pool ^ TCNT1;
    }
    return pool;
}

uint16_t sampling_reference(void)
{
    return reference;
}

uint16_t sampling_supply(void)
{
    return (uint16_t)(supply_mean >> 4);
}

/* A short window may contain no usable reading; then the running mean. */
uint16_t sampling_supply_of_window(void)
{
    uint16_t q6 = supply_count ? (uint16_t)(2 * supply_sum / supply_count) : sampling_supply();
    supply_sum = 0;
    supply_count = 0;
    return q6;
}

uint16_t sampling_drop(uint8_t board)
{
    return (uint16_t)(drops[board] >> 4);
}

static struct frame *other(void)
{
    return growing == &frames[0] ? &frames[1] : &frames[0];
}

/* The buffers only change roles here, without copying: serial bytes arrive every 20 us. Without a
 * free buffer the window continues, and the missing sequence number shows it. */
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
