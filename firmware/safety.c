#include "safety.h"

#include <stddef.h>

#include "hal.h"

#define MEAN_SHIFT 5 /* 32 samples of a board: 15 ms, many PWM periods */
#define SETTLE_MS 100
#define STALL_MS 30
#define NO_SAMPLES_MS 10
#define NO_PULSE_MS 5
#define OFF_MS 100 /* until a mean no longer contains the current from before */
#define DIFFERENCES 3
#define HEAT_TURN_MS CHANNELS
#define ZERO_SHIFT 4 /* each board every 2 ms: 32 ms, twice as slow as a mean */
#define NEW_ZERO 26 /* 1/32 steps, 40 mA: half of the current that may flow unexplained */

#define CURRENT_STEPS(ma, mv_per_a) ((uint32_t)(ma) * (mv_per_a) / 1000 * ADC_STEPS / REFERENCE_MV)
#define CURRENT_MEAN(ma, mv_per_a) (CURRENT_STEPS((ma) * 16UL, mv_per_a) << (MEAN_SHIFT - 4))
#define SQUARE(mv) ((uint16_t)((uint32_t)((mv) >> 6) * ((mv) >> 6)))

_Static_assert(CHANNELS == 2 * BOARDS, "two channels on each board");
_Static_assert(ADC_STEPS << MEAN_SHIFT <= 65536, "a mean is 16 bit");
_Static_assert(CURRENT_STEPS(PEAK_LIMIT_MA, FRONT_MV_PER_A) < ADC_MIDDLE - 20 &&
                   CURRENT_STEPS(PEAK_LIMIT_MA, BACK_MV_PER_A) < ADC_MIDDLE - 20,
               "the peak limit is beyond the current sensor's range");
_Static_assert(USUAL_MOHM >= LEAST_MOHM, "a usual wire below the floor");
_Static_assert(MEAN_LIMIT_MA < PEAK_LIMIT_MA, "a mean above the peak");
_Static_assert((uint32_t)SUPPLY_MAX_MV < (uint32_t)REFERENCE_MV * SUPPLY_DIVIDER * 95 / 100 &&
                   SUPPLY_MAX_MV <= 16000,
               "the supply limit is beyond the divider's range");
_Static_assert(MAX_COMMAND_MV <= SUPPLY_MAX_MV, "more volts than any supply allowed");
_Static_assert(COMMAND_TIMEOUT_MS > 0 && COMMAND_TIMEOUT_MS <= 2000, "timeout cannot be off");

static const uint16_t mv_per_a[BOARDS] = {FRONT_MV_PER_A, BACK_MV_PER_A};
static const uint16_t extra_mean[BOARDS] = {CURRENT_MEAN(EXTRA_MA, FRONT_MV_PER_A),
                                            CURRENT_MEAN(EXTRA_MA, BACK_MV_PER_A)};
static const uint16_t off_mean[BOARDS] = {CURRENT_MEAN(OFF_LIMIT_MA, FRONT_MV_PER_A),
                                          CURRENT_MEAN(OFF_LIMIT_MA, BACK_MV_PER_A)};

/* The limits, and the same in steps of the converter. */
static struct limits limits;
static uint16_t peak_steps[BOARDS], mean_steps[BOARDS];
static uint16_t hot_square, hot_share;
static uint32_t steps_per_mv[BOARDS]; /* at the lowest resistance, 1/32 step, times 16384 */
static uint16_t supply_low, supply_high;

static struct safety self;
static uint16_t silence_ms;
static uint8_t stall_ms;
static uint8_t unsampled_ms;
static uint8_t settle_ms;
static uint32_t on_turns[CHANNELS]; /* of watch_on_time, 4 ms each */
static uint8_t watched;
static uint8_t closing_ms;   /* until the relay's contact is closed */
static uint8_t off_ms;       /* since the outputs went off */
static uint8_t unpulsed_ms;  /* since the outputs' interrupt */
static uint8_t differences;  /* checks in a row that found another output than was set */
/* Varies in each turn, so that rounding errors cancel: otherwise a mean would stay up to a step off
 * its true value after a pulse. */
static uint8_t rounding;
static uint16_t current_mean[BOARDS]; /* readings times 32 */
static uint16_t zero_mean[BOARDS];    /* the same with the relay open, slower, until arming */
static uint16_t explained[BOARDS];    /* mean current explained by the present duties */
static uint16_t explained_mean[BOARDS]; /* the same, filtered like the measured current */
static uint16_t square[BOARDS];         /* supply voltage squared during a pulse */
static uint32_t heat[CHANNELS];         /* mean square of a wire's voltage, times 65536 */
static uint16_t supply_mean; /* readings times 32 */

void safety_init(void)
{
    static const struct limits usual = {MAX_COMMAND_MV, MEAN_LIMIT_MA, PEAK_LIMIT_MA,
                                        USUAL_MOHM,     HOT_MV,        HOT_MS};
    self = (struct safety){.state = IDLE};
    silence_ms = 0;
    stall_ms = unsampled_ms = unpulsed_ms = 0;
    settle_ms = SETTLE_MS;
    closing_ms = off_ms = differences = 0;
    supply_mean = 0;
    supply_low = UINT16_MAX;
    safety_limit(&usual);
    for (uint8_t channel = 0; channel < CHANNELS; channel++)
        on_turns[channel] = heat[channel] = 0;
    for (uint8_t board = 0; board < BOARDS; board++) {
        current_mean[board] = zero_mean[board] = ADC_MIDDLE << MEAN_SHIFT;
        explained[board] = 0;
        explained_mean[board] = 0;
    }
    outputs_off();
    relay_open();
}

const struct safety *safety_now(void)
{
    return &self;
}

static void let_go(void)
{
    outputs_off();
    relay_open();
    for (uint8_t channel = 0; channel < CHANNELS; channel++)
        self.duty[channel] = 0;
    for (uint8_t board = 0; board < BOARDS; board++)
        explained[board] = 0;
}

void safety_stop(uint8_t cause)
{
    if (self.state == ARMED)
        off_ms = 0;
    let_go();
    if (self.state == STOPPED)
        return;
    self.state = STOPPED;
    self.cause = cause;
    remember_cause(cause);
}

static uint16_t distance(uint16_t a, uint16_t b)
{
    return a > b ? a - b : b - a;
}

bool safety_arm(void)
{
    if (self.state != IDLE || settle_ms || !safety_supply_is_good())
        return false;
    outputs_prepare();
    relay_close();
    closing_ms = RELAY_MS;
    silence_ms = 0;
    differences = 0;
    self.state = ARMED;
    return true;
}

void safety_disarm(void)
{
    if (self.state == ARMED) {
        self.state = IDLE;
        off_ms = 0;
    }
    let_go();
}

bool safety_reset(void)
{
    safety_disarm();
    if (self.flows)
        return false;
    self.state = IDLE;
    self.cause = NO_CAUSE;
    remember_cause(NO_CAUSE);
    return true;
}

bool safety_limit(const struct limits *asked)
{
    if (!asked->max_mv || asked->max_mv > MAX_COMMAND_MV || asked->mean_ma > MEAN_LIMIT_MA ||
        asked->peak_ma > PEAK_LIMIT_MA || asked->mean_ma >= asked->peak_ma ||
        asked->least_mohm < LEAST_MOHM || !asked->hot_mv || asked->hot_mv > HOT_MV ||
        asked->hot_ms < 10 * HEAT_TURN_MS || asked->hot_ms > HOT_MS)
        return false;
    limits = *asked;
    for (uint8_t board = 0; board < BOARDS; board++) {
        peak_steps[board] = (uint16_t)CURRENT_STEPS(limits.peak_ma, mv_per_a[board]);
        mean_steps[board] = (uint16_t)CURRENT_MEAN(limits.mean_ma, mv_per_a[board]);
        steps_per_mv[board] = (ADC_STEPS << (MEAN_SHIFT + 14)) / REFERENCE_MV * mv_per_a[board] /
                              limits.least_mohm;
    }
    hot_square = SQUARE(limits.hot_mv);
    hot_share = (uint16_t)(65536UL * HEAT_TURN_MS / limits.hot_ms);
    return true;
}

const struct limits *safety_limits(void)
{
    return &limits;
}

/* Independent of the reference, because the sensors are ratiometric. */
uint16_t safety_explained(uint8_t board, uint16_t supply_mv, uint32_t duties)
{
    uint32_t steps = (supply_mv * steps_per_mv[board]) >> 14;
    steps = (steps * (duties >> 4)) >> 12;
    return steps > INT16_MAX ? INT16_MAX : (uint16_t)steps;
}

bool safety_drive(const struct drive *drive, bool fresh)
{
    if (self.state != ARMED)
        return false;
    for (uint8_t channel = 0; channel < CHANNELS; channel++)
        self.duty[channel] = drive->duty[channel];
    for (uint8_t board = 0; board < BOARDS; board++) {
        explained[board] = drive->explained[board];
        square[board] = drive->square[board];
    }
    if (fresh)
        silence_ms = 0;
    return true;
}

const uint16_t *safety_duties(void)
{
    unpulsed_ms = 0;
    for (uint8_t channel = 0; channel < CHANNELS; channel++)
        if (self.duty[channel] > DUTY_LIMIT_Q16)
            safety_stop(DUTY_LIMIT);
    if (self.state == ARMED)
        return closing_ms ? NULL : self.duty;
    let_go();
    return NULL;
}

/* --- checks in the interrupts ----------------------------------------------------------------- */

/* Time on minus time off: pauses count as cooling, and a short one does not restart the count. */
static bool on_for_too_long(uint8_t channel)
{
    if (self.duty[channel] > ON_TIME_DUTY_Q16)
        return ++on_turns[channel] > ON_TIME_LIMIT_S * (1000UL / CHANNELS);
    if (on_turns[channel])
        on_turns[channel]--;
    return false;
}

/* Compares the mean square of a wire's voltage, which decays as the wire cools, with its limit. */
static bool too_hot(uint8_t channel)
{
    uint16_t now = (uint16_t)(((uint32_t)self.duty[channel] * square[channel / 2]) >> 16);
    int32_t change = (int32_t)now - (int32_t)(heat[channel] >> 16);
    heat[channel] += (uint32_t)(change * (int32_t)hot_share);
    return heat[channel] >> 16 > hot_square;
}

/* Several checks in a row, as a duty that has just changed needs a period to be applied. */
static bool output_differs(uint8_t channel)
{
    differences = outputs_make(channel, closing_ms ? 0 : self.duty[channel]) ? 0 : differences + 1;
    return differences >= DIFFERENCES;
}

/* A board's reading without current, averaged for longer than current_mean, because its error stays
 * while armed; starts again when the reading jumps. */
static void learn_zero(uint8_t board)
{
    int16_t change = (int16_t)(current_mean[board] - zero_mean[board]);
    bool is_new = change > NEW_ZERO || change < -NEW_ZERO;
    zero_mean[board] += is_new ? change : (change + (rounding >> 1)) >> ZERO_SHIFT;
}

/* One channel each millisecond, so that a serial byte never has to wait; watch_an_output checks the
 * output of one channel several times before the next. */
static void watch_a_channel(void)
{
    watched = (watched + 1) % CHANNELS;
    if (on_for_too_long(watched))
        safety_stop(ON_TIME_LIMIT);
    if (too_hot(watched))
        safety_stop(HEAT_LIMIT);
    if (self.state != ARMED)
        learn_zero(watched % BOARDS);
}

static void watch_an_output(void)
{
    static uint8_t turn;
    turn++;
    if (output_differs(turn / 8 % CHANNELS))
        safety_stop(OUTPUT_DIFFERS);
}

static void count_up(uint8_t *ms)
{
    if (*ms < UINT8_MAX)
        ++*ms;
}

bool safety_tick(void)
{
    if (settle_ms)
        settle_ms--;
    if (closing_ms)
        closing_ms--;
    count_up(&stall_ms);
    count_up(&unsampled_ms);
    count_up(&unpulsed_ms);
    count_up(&off_ms);
    if (stall_ms > STALL_MS)
        safety_stop(LOOP_STALLED);
    if (unsampled_ms > NO_SAMPLES_MS)
        safety_stop(NO_SAMPLES);
    if (unpulsed_ms > NO_PULSE_MS)
        safety_stop(PWM_STALLED);
    if (self.state == ARMED && ++silence_ms > COMMAND_TIMEOUT_MS)
        safety_stop(COMMAND_TIMEOUT);
    watch_a_channel();
    watch_an_output();
    return stall_ms <= STALL_MS && unpulsed_ms <= NO_PULSE_MS;
}

void safety_loop_lives(void)
{
    stall_ms = 0;
}

/* Not armed, yet a current flows: the relay is closed (welded, or by hand) and a switch shorted. */
static bool flows_while_off(uint8_t board)
{
    return self.state != ARMED && off_ms >= OFF_MS &&
           distance(current_mean[board], ADC_MIDDLE << MEAN_SHIFT) > off_mean[board];
}

/* Armed, and the mean current is above what the duties can cause at the lowest resistance (filtered
 * alike): a stuck switch, or a short circuit that clips the sensor. */
static bool unexplained(uint8_t board, uint16_t now)
{
    return self.state == ARMED &&
          distance(current_mean[board], zero_mean[board]) > now + extra_mean[board];
}

void safety_current(uint8_t board, uint16_t reading)
{
    rounding = (uint8_t)((rounding + 13) % (1 << MEAN_SHIFT));
    uint16_t *mean = &current_mean[board];
    *mean += reading - ((*mean + rounding) >> MEAN_SHIFT);
    uint16_t *most = &explained_mean[board];
    *most += (uint16_t)((int16_t)(explained[board] - *most + rounding) >> MEAN_SHIFT);
    if (settle_ms)
        return;
    if (distance(reading, ADC_MIDDLE) > peak_steps[board] ||
        distance(*mean, ADC_MIDDLE << MEAN_SHIFT) > mean_steps[board])
        safety_stop(FRONT_OVER_CURRENT + board);
    if (unexplained(board, *most))
        safety_stop(explained[board] ? UNEXPLAINED_CURRENT : OFF_CURRENT);
    self.flows &= (uint8_t)~(1 << board);
    if (flows_while_off(board)) {
        safety_stop(OFF_CURRENT);
        self.flows |= (uint8_t)(1 << board);
    }
}

bool safety_supply_is_good(void)
{
    return supply_mean >= supply_low && supply_mean <= supply_high;
}

void safety_supply_range(uint16_t low, uint16_t high)
{
    supply_low = low;
    supply_high = high;
}

void safety_supply(uint16_t reading)
{
    unsampled_ms = 0;
    supply_mean += reading - (supply_mean >> MEAN_SHIFT);
    if (self.state == ARMED && !safety_supply_is_good())
        safety_stop(SUPPLY_RANGE);
}
