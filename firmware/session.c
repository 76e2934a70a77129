#include "session.h"

#include "answers.h"
#include "greeting.h"
#include "hal.h"
#include "protocol.h"
#include "safety.h"
#include "telemetry.h"
#include "trips.h"

#define REFRESH_US 10000 /* how often duties follow the supply */
#define TEXT_RATE_MAX 100
#define BINARY_RATE_MAX 500
#define BOOT_RATE 100
#define BYTE_US (10 * 1000000UL / BAUD_RATE)

static struct line line;
static uint16_t nonce;
static bool has_nonce; /* a host asked for it since the start */
static uint16_t session;
static uint16_t sequence; /* of the last accepted voltage command */
static uint16_t command_mv[CHANNELS];
static uint32_t refreshed_us;
static uint16_t unloaded, loaded[BOARDS]; /* mV of the supply, without load and during a pulse */
static uint16_t limited_at; /* reference for which the supply's limits were computed */
static uint16_t rejected;

/* --- commands --------------------------------------------------------------------------------- */

/* A new number for the next arming, so that replayed bytes cannot arm. */
static void renew_nonce(void)
{
    uint16_t old = nonce;
    nonce = (uint16_t)(nonce * 25173u + 13849u) ^ entropy();
    if (nonce == old)
        nonce++;
}

static uint8_t state_now(void)
{
    uint8_t state;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        state = safety_now()->state;
    }
    return state;
}

static bool supply_is_good(void)
{
    bool good;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        good = safety_supply_is_good();
    }
    return good;
}

static uint8_t hello(const uint16_t *field)
{
    (void)field;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        safety_disarm();
    }
    renew_nonce();
    has_nonce = true;
    greeting_start(nonce, true);
    return ACCEPTED;
}

static uint8_t arm(const uint16_t *field)
{
    bool armed;
    uint8_t state = state_now();
    if (state != IDLE)
        return state == STOPPED ? IS_STOPPED : IS_ARMED;
    if (!has_nonce || field[0] != nonce)
        return WRONG_SESSION;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        armed = safety_arm();
    }
    if (!armed)
        return NO_SUPPLY;
    sampling_learn_drops();
    session = nonce;
    renew_nonce();
    sequence = 0;
    for (uint8_t channel = 0; channel < CHANNELS; channel++)
        command_mv[channel] = 0;
    answer('K', 'A', session);
    return ACCEPTED;
}

/* Duties for voltages at the last measured supply, and the highest current that they can cause. A
 * duty beyond its limit is OVER_DUTY, but filled in, too. */
static uint8_t work_out(const uint16_t *millivolts, struct drive *drive)
{
    uint8_t reason = ACCEPTED;
    uint16_t least = unloaded - unloaded / 8; /* a larger drop does not reduce the counted heat */
    for (uint8_t board = 0; board < BOARDS; board++) {
        uint32_t duties = 0;
        for (uint8_t channel = 2 * board; channel < 2 * board + 2; channel++) {
            drive->duty[channel] = duty_of(millivolts[channel], loaded[board]);
            if (drive->duty[channel] > DUTY_LIMIT_Q16)
                reason = OVER_DUTY;
            duties += drive->duty[channel];
        }
        uint16_t volts = loaded[board] > least ? loaded[board] : least;
        drive->square[board] = (uint16_t)((uint32_t)(volts >> 6) * (volts >> 6));
        drive->explained[board] = safety_explained(board, unloaded, duties);
    }
    return reason;
}

static uint8_t check(const uint16_t *millivolts, struct drive *drive)
{
    if (!supply_is_good())
        return NO_SUPPLY;
    for (uint8_t channel = 0; channel < CHANNELS; channel++)
        if (millivolts[channel] > safety_limits()->max_mv)
            return OVER_VOLTAGE;
    return work_out(millivolts, drive);
}

static uint8_t drive(const uint16_t *field)
{
    struct drive asked;
    bool driven;
    if (state_now() != ARMED)
        return NOT_ARMED;
    if (field[0] != session)
        return WRONG_SESSION;
    if ((int16_t)(field[1] - sequence) <= 0)
        return OLD_SEQUENCE;
    uint8_t reason = check(field + 2, &asked);
    if (reason != ACCEPTED)
        return reason;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        driven = safety_drive(&asked, true);
    }
    if (!driven)
        return NOT_ARMED;
    sequence = field[1];
    for (uint8_t channel = 0; channel < CHANNELS; channel++)
        command_mv[channel] = field[2 + channel];
    return ACCEPTED;
}

/* The supply in mV, and its limits in 1/32 steps, by the measured reference (USB's voltage). */
static void follow_reference(void)
{
    uint16_t reference = sampling_reference();
    unloaded = supply_mv(sampling_supply(), reference);
    for (uint8_t board = 0; board < BOARDS; board++)
        loaded[board] = unloaded - supply_mv(sampling_drop(board), reference);
    if (reference == limited_at)
        return;
    limited_at = reference;
    /* Volatile, so that the compiler cannot move these divisions to where interrupts are off. */
    volatile uint16_t low = (uint16_t)((uint32_t)SUPPLY_MIN_MV * 10 / SUPPLY_DIVIDER * 32768 / reference);
    volatile uint16_t high = (uint16_t)((uint32_t)SUPPLY_MAX_MV * 10 / SUPPLY_DIVIDER * 32768 / reference);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        safety_supply_range(low, high);
    }
}

/* Same voltages, new supply. A duty beyond the limit is passed on: the interrupt then stops. */
static void follow_supply(void)
{
    struct drive again;
    uint32_t now = clock_us();
    if (now - refreshed_us < REFRESH_US)
        return;
    refreshed_us = now;
    follow_reference();
    if (!supply_is_good() || state_now() != ARMED)
        return;
    work_out(command_mv, &again);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        safety_drive(&again, false);
    }
}

static uint8_t disarm(const uint16_t *field)
{
    (void)field;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        safety_disarm();
    }
    answer('K', 'D', 0);
    return ACCEPTED;
}

static uint8_t reset(const uint16_t *field)
{
    bool forgotten;
    (void)field;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        trips_look(); /* or a stop since the last look would be forgotten */
        forgotten = safety_reset();
    }
    if (!forgotten)
        return CURRENT_FLOWS;
    trips_acknowledge();
    renew_nonce();
    has_nonce = true;
    answer('K', 'R', nonce);
    return ACCEPTED;
}

/* Without turning interrupts off: they use these limits only while armed. */
static uint8_t set_limits(const uint16_t *field)
{
    const struct limits asked = {field[0], field[1], field[2], field[3], field[4], field[5]};
    if (state_now() == ARMED)
        return IS_ARMED;
    if (!safety_limit(&asked))
        return BEYOND_LIMITS;
    answer('K', 'C', 0);
    return ACCEPTED;
}

static uint8_t set_telemetry(bool to_binary, uint16_t rate, uint16_t highest)
{
    if (rate > highest || (rate && 1000 % rate))
        return BAD_RATE;
    answer_in_binary(to_binary);
    sampling_set_period(rate ? 1000 / rate : 0);
    answer('K', to_binary ? 'B' : 'T', rate);
    return ACCEPTED;
}

static uint8_t text(const uint16_t *field)
{
    return set_telemetry(false, field[0], TEXT_RATE_MAX);
}

static uint8_t binary_frames(const uint16_t *field)
{
    return set_telemetry(true, field[0], BINARY_RATE_MAX);
}

/* Two stamps: when the question had arrived, and when the answer will have left, after all bytes
 * that are still queued. */
static uint8_t ping(const uint16_t *field)
{
    begin_message('P');
    add(field[0]);
    uint8_t before = out.length;
    add(serial_line_time());
    uint8_t rest = (uint8_t)(out.length - before + SEAL_TEXT); /* the other stamp is as long */
    add(clock_us() + (uint32_t)(serial_queued() + out.length + rest) * BYTE_US);
    send_message();
    return ACCEPTED;
}

static uint8_t status(const uint16_t *field)
{
    (void)field;
    struct serial_counts counts = serial_counts();
    begin_message('S');
    add_named(PSTR(" rejected="), rejected);
    add_named(PSTR(" overruns="), counts.overruns);
    add_named(PSTR(" dropped="), counts.dropped);
    add_named(PSTR(" lost="), sampling_lost());
    add_named(PSTR(" stack="), stack_never_used());
    add_named(PSTR(" reference_mv="), sampling_reference() / 10);
    add_last_trip();
    send_message();
    return ACCEPTED;
}

static const struct {
    char name;
    uint8_t fields;
    bool open; /* accepted without a checksum, so that it can be typed by hand */
    uint8_t (*run)(const uint16_t *field);
} commands[] = {
    {'?', 0, true, hello},  {'S', 0, true, status},        {'A', 1, false, arm},
    {'V', 6, false, drive}, {'D', 0, true, disarm},        {'R', 0, false, reset},
    {'T', 1, true, text},   {'B', 1, false, binary_frames}, {'P', 1, false, ping},
    {'C', 6, false, set_limits},
};

static uint8_t run(const struct command *command)
{
    for (uint8_t i = 0; i < sizeof commands / sizeof *commands; i++) {
        if (commands[i].name != command->name)
            continue;
        if (commands[i].fields != command->count)
            return BAD_FORMAT;
        if (!command->sealed && !commands[i].open)
            return BAD_CHECKSUM;
        return commands[i].run(command->field);
    }
    return BAD_FORMAT;
}

static void obey(void)
{
    struct command command;
    if (!line.length && !line.overlong)
        return; /* an empty line: a host sends it to end an unfinished one */
    uint8_t reason = parse_command(&line, &command);
    char name = reason == ACCEPTED ? command.name : '-';
    if (reason == ACCEPTED)
        reason = run(&command);
    if (reason == ACCEPTED)
        return;
    rejected++;
    answer('N', name >= '?' && name <= 'Z' ? name : '-', reason);
}

/* --- the loop --------------------------------------------------------------------------------- */

void session_init(void)
{
    line_clear(&line);
    answer_in_binary(false);
    rejected = 0;
    session = 0;
    sequence = 0;
    limited_at = 0;
    has_nonce = false;
    nonce = start_entropy();
    follow_reference();
    serial_send((const uint8_t *)"\n", 1); /* ends a line that the reset cut off */
    greeting_start(0, false);
    sampling_set_period(1000 / BOOT_RATE);
}

/* Up to the next line end. A host that was delayed sends much at once, a byte every 20 us: they must
 * be taken as fast as they arrive. */
static bool listen(void)
{
    uint8_t byte;
    bool busy = false;
    while (serial_take(&byte)) {
        busy = true;
        if (line_add(&line, byte)) {
            obey();
            line_clear(&line);
            break;
        }
    }
    return busy;
}

bool session_run(void)
{
    bool busy = listen();
    sampling_follow();
    follow_supply();
    trips_follow();
    greet();
    return report(sequence) || busy;
}
