#include "safety.h"

#include <stddef.h>

#include "hal.h"

#define MEAN_SHIFT 5 /* 32 samples of a board: 15 ms, many PWM periods */
#define SETTLE_MS 100
#define STALL_MS 30
#define NO_SAMPLES_MS 10

#define CURRENT_STEPS(ma, mv_per_a) ((uint32_t)(ma) * (mv_per_a) / 1000 * ADC_STEPS / REFERENCE_MV)
#define SUPPLY_MEAN(mv) \
    ((uint32_t)(mv) * (ADC_STEPS << MEAN_SHIFT) / ((uint32_t)REFERENCE_MV * SUPPLY_DIVIDER))

_Static_assert(CHANNELS == 2 * BOARDS, "two channels on each board");
_Static_assert(ADC_STEPS << MEAN_SHIFT <= 65536, "a mean is 16 bit");
_Static_assert(CURRENT_STEPS(PEAK_LIMIT_MA, FRONT_MV_PER_A) < ADC_MIDDLE - 20 &&
                   CURRENT_STEPS(PEAK_LIMIT_MA, BACK_MV_PER_A) < ADC_MIDDLE - 20,
               "the peak limit is beyond the current sensor's range");
_Static_assert(MEAN_LIMIT_MA < PEAK_LIMIT_MA, "a mean above the peak");
_Static_assert((uint32_t)SUPPLY_MAX_MV < (uint32_t)REFERENCE_MV * SUPPLY_DIVIDER,
               "the supply limit is beyond the divider's range");
_Static_assert(MAX_COMMAND_MV <= SUPPLY_MAX_MV, "more volts than any supply allowed");
_Static_assert(DUTY_LIMIT_Q16 < 65536 - 256, "the PWM's dither needs room above the limit");
_Static_assert(COMMAND_TIMEOUT_MS > 0 && COMMAND_TIMEOUT_MS <= 2000, "timeout cannot be off");

static const uint16_t peak_steps[BOARDS] = {
    CURRENT_STEPS(PEAK_LIMIT_MA, FRONT_MV_PER_A),
    CURRENT_STEPS(PEAK_LIMIT_MA, BACK_MV_PER_A),
};
static const uint16_t mean_steps[BOARDS] = {
    CURRENT_STEPS(MEAN_LIMIT_MA, FRONT_MV_PER_A) << MEAN_SHIFT,
    CURRENT_STEPS(MEAN_LIMIT_MA, BACK_MV_PER_A) << MEAN_SHIFT,
};

static struct safety self;
static uint16_t silence_ms;
static uint8_t stall_ms;
static uint8_t unsampled_ms;
static uint8_t settle_ms;
static uint32_t on_turns[CHANNELS]; /* of watch_on_time, 4 ms each */
static uint8_t watched;
static uint16_t current_mean[BOARDS]; /* readings times 32 */
static uint16_t supply_mean;

void safety_init(void)
{
    self = (struct safety){.state = IDLE};
    silence_ms = 0;
    stall_ms = 0;
    unsampled_ms = 0;
    settle_ms = SETTLE_MS;
    supply_mean = 0;
    for (uint8_t channel = 0; channel < CHANNELS; channel++)
        on_turns[channel] = 0;
    for (uint8_t board = 0; board < BOARDS; board++)
        current_mean[board] = ADC_MIDDLE << MEAN_SHIFT;
    outputs_off();
}

const struct safety *safety_now(void)
{
    return &self;
}

static void let_go(void)
{
    outputs_off();
    for (uint8_t channel = 0; channel < CHANNELS; channel++)
        self.duty[channel] = 0;
}

void safety_stop(uint8_t cause)
{
    let_go();
    if (self.state == STOPPED)
        return;
    self.state = STOPPED;
    self.cause = cause;
}

bool safety_arm(void)
{
    if (self.state != IDLE || settle_ms || !safety_supply_is_good())
        return false;
    outputs_prepare();
    silence_ms = 0;
    self.state = ARMED;
    return true;
}

void safety_disarm(void)
{
    let_go();
    if (self.state == ARMED)
        self.state = IDLE;
}

void safety_reset(void)
{
    let_go();
    self.state = IDLE;
    self.cause = NO_CAUSE;
}

bool safety_drive(const uint16_t duty[CHANNELS], bool fresh)
{
    if (self.state != ARMED)
        return false;
    for (uint8_t channel = 0; channel < CHANNELS; channel++)
        self.duty[channel] = duty[channel];
    if (fresh)
        silence_ms = 0;
    return true;
}

const uint16_t *safety_duties(void)
{
    for (uint8_t channel = 0; channel < CHANNELS; channel++)
        if (self.duty[channel] > DUTY_LIMIT_Q16)
            safety_stop(DUTY_LIMIT);
    if (self.state == ARMED)
        return self.duty;
    let_go();
    return NULL;
}

/* --- what the interrupts watch ---------------------------------------------------------------- */

/* Time on, less time off: pauses count as cooling, and a dip does not start it anew. */
static bool on_for_too_long(uint8_t channel)
{
    if (self.duty[channel] > ON_TIME_DUTY_Q16)
        return ++on_turns[channel] > ON_TIME_LIMIT_S * (1000UL / CHANNELS);
    if (on_turns[channel])
        on_turns[channel]--;
    return false;
}

/* One channel each millisecond, so that this never keeps a serial byte waiting. */
static void watch_on_time(void)
{
    watched = (watched + 1) % CHANNELS;
    if (on_for_too_long(watched))
        safety_stop(ON_TIME_LIMIT);
}

bool safety_tick(void)
{
    if (settle_ms)
        settle_ms--;
    if (stall_ms < UINT8_MAX)
        stall_ms++;
    if (stall_ms > STALL_MS)
        safety_stop(LOOP_STALLED);
    if (unsampled_ms < UINT8_MAX)
        unsampled_ms++;
    if (unsampled_ms > NO_SAMPLES_MS)
        safety_stop(NO_SAMPLES);
    if (self.state == ARMED && ++silence_ms > COMMAND_TIMEOUT_MS)
        safety_stop(COMMAND_TIMEOUT);
    watch_on_time();
    return stall_ms <= STALL_MS;
}

void safety_loop_lives(void)
{
    stall_ms = 0;
}

static uint16_t distance(uint16_t a, uint16_t b)
{
    return a > b ? a - b : b - a;
}

/* Watched while idle too: a current then is a switch that does not open, or no sensor. */
void safety_current(uint8_t board, uint16_t reading)
{
    uint16_t *mean = &current_mean[board];
    *mean += reading - (*mean >> MEAN_SHIFT);
    if (settle_ms)
        return;
    if (distance(reading, ADC_MIDDLE) > peak_steps[board] ||
        distance(*mean, ADC_MIDDLE << MEAN_SHIFT) > mean_steps[board])
        safety_stop(FRONT_OVER_CURRENT + board);
}

bool safety_supply_is_good(void)
{
    return supply_mean >= SUPPLY_MEAN(SUPPLY_MIN_MV) && supply_mean <= SUPPLY_MEAN(SUPPLY_MAX_MV);
}

void safety_supply(uint16_t reading)
{
    unsampled_ms = 0;
    supply_mean += reading - (supply_mean >> MEAN_SHIFT);
    if (self.state == ARMED && !safety_supply_is_good())
        safety_stop(SUPPLY_RANGE);
}

uint16_t safety_supply_mv(void)
{
    return (uint16_t)((uint32_t)supply_mean * REFERENCE_MV / ADC_STEPS * SUPPLY_DIVIDER >>
                      MEAN_SHIFT);
}
