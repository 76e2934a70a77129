/* A bench without faults under safety.c and session.c: four wires that warm and change phase, pulses
 * as the sensors see them, a supply that sags and dips. Prints `seconds cause` of every stop, then
 * continues.
 *
 *   soak SEED SECONDS SUPPLY SOURCE DIP NOISE OFFSET DRIFT RESISTANCE AUSTENITE ROOM LOSS CAPACITY
 *        HIGHEST COMMAND
 *
 * in V, ohm, A, K, W/K, J/K; DIP and AUSTENITE are shares; COMMAND is the C that sets the limits. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fake_hardware.h"
#include "protocol.h"
#include "safety.h"

#define PHASES 32
#define STEP 13 /* of 32: from one conversion of a board to the next */
#define STEPS_PER_A (FRONT_MV_PER_A * 1024.0 / 5000.0)
#define STEPS_PER_V (1024.0 / 5.0 / SUPPLY_DIVIDER)
#define PERIOD 1.024e-3
#define FILTER 0.5e-3
#define REARM_S 300
#define NORMALS (1 << 14)

static double supply, source, dip, noise, offset, drift, resistance, austenite, room, loss, capacity,
    highest;
static uint64_t state;
static double kelvin[CHANNELS], ohm[CHANNELS], level[CHANNELS];
static uint32_t level_until[CHANNELS];
static double seen[BOARDS][PHASES], drawn[BOARDS][PHASES]; /* A behind the filter, and now */
static double open_volts, sensor_offset;
static uint32_t conversion, now_ms, dip_until;
static double dip_share;
static unsigned session, sequence;

static uint64_t draw(void)
{
    state ^= state >> 12;
    state ^= state << 25;
    state ^= state >> 27;
    return state * 2685821657736338717u;
}

static double uniform(void)
{
    return (double)(draw() >> 11) / 9007199254740992.0;
}

static double normal(void)
{
    static float drawn_before[NORMALS];
    while (drawn_before[0] == 0.0f)
        for (int k = 0; k < NORMALS; k++)
            drawn_before[k] = (float)(sqrt(-2.0 * log(1.0 - uniform())) * cos(2.0 * M_PI * uniform()));
    return drawn_before[draw() >> 32 & (NORMALS - 1)];
}

static uint16_t converted(double steps)
{
    return (uint16_t)fmin(fmax(floor(steps + 0.5), 0.0), 1023.0);
}

/* Readings of both boards and the supply at the times of the conversions. */
static void measure(void)
{
    uint32_t at = conversion++ * STEP % PHASES;
    double taken = 0.0;
    for (uint8_t board = 0; board < BOARDS; board++) {
        double ampere = seen[board][(at + 16 * board) % PHASES] + sensor_offset;
        fake_set_current(board, converted(512.0 + STEPS_PER_A * (ampere + noise * normal())));
        taken += drawn[board][(at + 7 + 16 * board) % PHASES];
    }
    double jitter = 0.4 * normal();
    fake_set_supply(converted(STEPS_PER_V * open_volts + jitter));
    fake_set_loaded_supply(converted(STEPS_PER_V * (open_volts - source * taken) + jitter));
}

/* A wire's pulse ends with its period; the sensor's filter has settled to it. */
static void pulses_of(uint8_t board)
{
    memset(seen[board], 0, sizeof seen[board]);
    memset(drawn[board], 0, sizeof drawn[board]);
    double longest = 0.0, mean = 0.0;
    for (uint8_t channel = 2 * board; channel < 2 * board + 2; channel++) {
        double duty = fake_output(channel) / 65536.0;
        if (duty == 0.0)
            continue;
        double ampere = open_volts / (ohm[channel] + source);
        double end = -expm1(-duty * PERIOD / FILTER) / -expm1(-PERIOD / FILTER);
        double start = end * exp(-(1.0 - duty) * PERIOD / FILTER);
        double grown = (1.0 - start) * exp((1.0 - duty) * PERIOD / FILTER);
        double forgotten = 1.0, step = exp(-PERIOD / FILTER / PHASES);
        for (int phase = 0; phase < PHASES; phase++, forgotten *= step) {
            bool on = phase >= (1.0 - duty) * PHASES;
            seen[board][phase] += ampere * (on ? 1.0 - grown * forgotten : end * forgotten);
            drawn[board][phase] += on ? ampere : 0.0;
        }
        longest = fmax(longest, duty);
        mean += duty * ampere;
    }
    double lost = longest > 0.0 ? source * mean / longest : 0.0;
    fake_set_drop(board, (uint16_t)(64.0 * STEPS_PER_V * lost + 0.5));
}

static void warm(uint8_t channel)
{
    double duty = fake_output(channel) / 65536.0;
    double ampere = open_volts / (ohm[channel] + source);
    double power = duty * ampere * ampere * ohm[channel];
    kelvin[channel] += 1e-3 / capacity * (power - loss * (kelvin[channel] - room));
    double share = fmin(fmax((kelvin[channel] - 335.0) / 20.0, 0.0), 1.0);
    ohm[channel] = resistance * (1.0 + austenite * share);
}

static void follow_supply_and_sensors(void)
{
    static double slow;
    double seconds = 1e-3 * now_ms;
    if (now_ms >= dip_until) {
        dip_share = dip_share == 0.0 ? dip * uniform() : 0.0;
        dip_until = now_ms + (uint32_t)(dip_share > 0.0 ? 20 + 580 * uniform() : 30000 * uniform());
    }
    if (now_ms % 16 == 0) {
        slow = 0.3 * dip * sin(seconds / 97.0);
        sensor_offset = offset + drift * sin(seconds / 190.0);
    }
    open_volts = supply * (1.0 - dip_share) * (1.0 - slow);
}

/* Time passes for the supply, the wires, the sensors and the device. */
static void pass_ms(uint32_t milliseconds)
{
    static uint16_t before[CHANNELS];
    static double volts_before;
    while (milliseconds--) {
        follow_supply_and_sensors();
        bool same = fabs(open_volts - volts_before) < 2e-3 * open_volts;
        for (uint8_t channel = 0; channel < CHANNELS; channel++) {
            same &= abs(before[channel] - fake_output(channel)) < 32; /* a two thousandth */
            warm(channel);
        }
        if (!same || now_ms % 16 == 0) {
            volts_before = open_volts;
            for (uint8_t channel = 0; channel < CHANNELS; channel++)
                before[channel] = fake_output(channel);
            for (uint8_t board = 0; board < BOARDS; board++)
                pulses_of(board);
        }
        fake_run_ms(1);
        now_ms++;
    }
}

static void say(const char *body)
{
    char text[200];
    int length = snprintf(text, sizeof text, "%s*%04X\n", body,
                          crc16((const uint8_t *)body, (uint8_t)strlen(body)));
    fake_receive((const uint8_t *)text, (uint32_t)length);
}

static void arm(const char *limits)
{
    char body[40];
    say("R");
    say("T 10");
    say(limits);
    fake_forget_sent();
    say("?");
    pass_ms(1);
    session = fake_nonce();
    snprintf(body, sizeof body, "A %u", session);
    say(body);
    sequence = 0;
    for (uint8_t channel = 0; channel < CHANNELS; channel++) {
        level[channel] = 0.0;
        level_until[channel] = now_ms + 200;
    }
}

/* At rest for more than half of the time, as heating for 15 minutes at a stretch is cut, rightly. */
static void command(void)
{
    char body[64];
    for (uint8_t channel = 0; channel < CHANNELS; channel++) {
        if (now_ms < level_until[channel])
            continue;
        level[channel] = uniform() < 0.55 ? 0.0 : highest * sqrt(uniform());
        level_until[channel] = now_ms + (uint32_t)(100.0 * pow(200.0, uniform()));
    }
    sequence++;
    snprintf(body, sizeof body, "V %u %u %.0f %.0f %.0f %.0f", session, sequence, 1e3 * level[0],
             1e3 * level[1], 1e3 * level[2], 1e3 * level[3]);
    say(body);
}

int main(int count, char **arguments)
{
    double *const numbers[] = {&supply, &source, &dip, &noise, &offset, &drift, &resistance,
                               &austenite, &room, &loss, &capacity, &highest};
    if (count != 3 + (int)(sizeof numbers / sizeof *numbers) + 1)
        return 2;
    state = 0x9E3779B97F4A7C15u * ((uint64_t)atof(arguments[1]) + 1);
    uint32_t end_ms = (uint32_t)(1e3 * atof(arguments[2])), due = 0, rearm = 0;
    for (size_t k = 0; k < sizeof numbers / sizeof *numbers; k++)
        *numbers[k] = atof(arguments[3 + k]);
    const char *limits = arguments[count - 1];
    for (uint8_t channel = 0; channel < CHANNELS; channel++) {
        kelvin[channel] = room;
        ohm[channel] = resistance;
    }
    follow_supply_and_sensors();
    fake_before_conversion = measure;
    fake_start(1);
    while (now_ms < end_ms) {
        if (safety_now()->state == STOPPED)
            printf("%.3f %d\n", 1e-3 * now_ms, safety_now()->cause);
        if (safety_now()->state == STOPPED || now_ms >= rearm) {
            say("D");
            pass_ms(150);
            arm(limits);
            rearm = now_ms + 1000 * REARM_S;
        }
        if (now_ms >= due) {
            command();
            due = now_ms + (draw() % 400 ? 20 : 20 + draw() % 130);
            fake_forget_sent();
        }
        pass_ms(1);
    }
    return 0;
}
