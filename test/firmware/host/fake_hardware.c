#include "fake_hardware.h"

#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "hal.h"
#include "protocol.h"
#include "safety.h"
#include "session.h"
#include "trips.h"

#define SENT_SIZE 65536
#define QUEUE_SIZE 128
#define STORE_SIZE 256
#define BYTE_US 3400

static uint32_t now_us;
static uint16_t entropy_value;
static uint16_t outputs[CHANNELS];
static uint16_t readings[INPUTS];
static uint16_t unloaded, drops[BOARDS];
void (*fake_before_conversion)(void);
static bool converting, pulsing, relay_is_closed, prepared;
static uint32_t supply_mean;
static uint8_t remembered, before;

static uint8_t store[STORE_SIZE];
static struct {
    bool is_under_way;
    uint8_t place, byte;
    uint32_t since_us;
} storing;

static uint8_t queue[QUEUE_SIZE];
static uint8_t queued;
static uint32_t line_time;
static uint8_t sent[SENT_SIZE];
static uint32_t sent_length;

static struct frame window;
static bool is_ready;
static uint16_t period_ms, elapsed_ms, sequence;

/* --- hal.h ------------------------------------------------------------------------------------ */

void outputs_off(void)
{
    memset(outputs, 0, sizeof outputs);
    prepared = false;
}

/* Without it a pulse cut off by a stop would continue when its output is connected again. */
void outputs_prepare(void)
{
    prepared = true;
}

uint8_t outputs_register(uint8_t channel)
{
    return (uint8_t)(outputs[channel] >> 8);
}

bool outputs_make(uint8_t channel, uint16_t duty)
{
    uint8_t set = (uint8_t)(duty >> 8);
    return outputs[channel] >> 8 == set || outputs[channel] >> 8 == set + 1;
}

void sampling_learn_drops(void)
{
}

void relay_close(void)
{
    relay_is_closed = true;
}

void relay_open(void)
{
    relay_is_closed = false;
}

uint16_t sampling_reference(void)
{
    return REFERENCE_MV * 10;
}

uint16_t sampling_supply(void)
{
    return (uint16_t)(supply_mean >> 4);
}

uint16_t sampling_supply_of_window(void)
{
    return sampling_supply();
}

void sampling_follow(void)
{
}

uint16_t sampling_drop(uint8_t board)
{
    return drops[board];
}

uint16_t start_entropy(void)
{
    return entropy_value;
}

void remember_cause(uint8_t cause)
{
    remembered = cause;
}

uint8_t cause_before(void)
{
    return before;
}

bool store_is_ready(void)
{
    return !storing.is_under_way;
}

/* On the chip this would wait, or do nothing. */
uint8_t store_read(uint8_t place)
{
    if (!store_is_ready())
        abort();
    return store[place];
}

void store_write(uint8_t place, uint8_t byte)
{
    if (!store_is_ready())
        abort();
    storing.is_under_way = true;
    storing.place = place;
    storing.byte = byte;
    storing.since_us = now_us;
}

uint32_t clock_us(void)
{
    return now_us;
}

uint16_t entropy(void)
{
    return entropy_value;
}

void sampling_set_period(uint16_t milliseconds)
{
    period_ms = milliseconds;
    elapsed_ms = 0;
}

const struct frame *sampling_take(void)
{
    return is_ready ? &window : NULL;
}

void sampling_release(void)
{
    is_ready = false;
}

uint16_t sampling_lost(void)
{
    return 0;
}

bool serial_take(uint8_t *byte)
{
    if (!queued)
        return false;
    *byte = queue[0];
    memmove(queue, queue + 1, --queued);
    return true;
}

uint32_t serial_line_time(void)
{
    return line_time;
}

uint8_t serial_room(void)
{
    return 255;
}

uint8_t serial_queued(void)
{
    return 0;
}

bool serial_send(const uint8_t *bytes, uint8_t length)
{
    if (length > SENT_SIZE - sent_length)
        return false;
    memcpy(sent + sent_length, bytes, length);
    sent_length += length;
    return true;
}

struct serial_counts serial_counts(void)
{
    return (struct serial_counts){0, 0};
}

uint8_t reset_flags(void)
{
    return 1;
}

uint16_t stack_never_used(void)
{
    return 999;
}

/* --- the simulated bench ---------------------------------------------------------------------- */

static void start(bool outlasted)
{
    static const uint16_t quiet[INPUTS] = {512, 512, 614, 300, 300};
    now_us = 0;
    memcpy(readings, quiet, sizeof readings);
    unloaded = quiet[SUPPLY];
    memset(drops, 0, sizeof drops);
    converting = pulsing = true;
    supply_mean = (uint32_t)quiet[SUPPLY] << 10;
    queued = 0;
    sent_length = 0;
    is_ready = false;
    sequence = 0;
    before = outlasted ? remembered : 0;
    remembered = 0;
    trips_init(outlasted);
    safety_init();
    session_init();
    fake_run_ms(200);
    fake_forget_sent();
}

void fake_start(uint16_t value)
{
    entropy_value = value;
    storing.is_under_way = false;
    fake_fill_store(0xFF);
    start(false);
}

void fake_restart(void)
{
    fake_end_byte();
    start(true);
}

void fake_cut_power(uint8_t garbage)
{
    fake_lose_byte(garbage);
    start(false);
}

void fake_lose_byte(uint8_t garbage)
{
    storing.byte = garbage;
    fake_end_byte();
}

bool fake_byte_is_under_way(void)
{
    return storing.is_under_way;
}

void fake_end_byte(void)
{
    if (storing.is_under_way)
        store[storing.place] = storing.byte;
    storing.is_under_way = false;
}

void fake_fill_store(uint8_t byte)
{
    memset(store, byte, sizeof store);
}

void fake_receive(const uint8_t *bytes, uint32_t length)
{
    for (uint32_t i = 0; i < length; i++) {
        if (bytes[i] == STOP_BYTE) {
            safety_stop(STOP_BYTE_SEEN);
            continue;
        }
        queue[queued++] = bytes[i];
        if (bytes[i] == '\n')
            line_time = now_us;
        session_run();
    }
}

static void convert_twice(void)
{
    for (uint8_t turn = 0; converting && turn < 2; turn++) {
        if (fake_before_conversion)
            fake_before_conversion();
        safety_current(0, readings[FRONT_CURRENT]);
        safety_current(1, readings[BACK_CURRENT]);
        supply_mean += ((uint32_t)unloaded << 10) / 32 - supply_mean / 32;
        safety_supply(readings[SUPPLY]);
    }
}

static void close_window(void)
{
    if (!period_ms || ++elapsed_ms < period_ms)
        return;
    elapsed_ms = 0;
    sequence++;
    window.sequence = sequence;
    window.time_us = now_us;
    for (uint8_t input = 0; input < INPUTS; input++) {
        window.sum[input] = readings[input];
        window.count[input] = 1;
    }
    is_ready = true;
}

static void pass_millisecond(bool loop_lives)
{
    now_us += 1000;
    if (now_us - storing.since_us >= BYTE_US)
        fake_end_byte();
    if (loop_lives)
        safety_loop_lives();
    safety_tick();
    convert_twice();
    close_window();
    const uint16_t *duty = pulsing ? safety_duties() : NULL;
    if (duty)
        memcpy(outputs, duty, sizeof outputs);
    if (duty && !prepared)
        memset(outputs, 0xFF, sizeof outputs);
}

void fake_run_ms(uint32_t milliseconds)
{
    while (milliseconds--) {
        pass_millisecond(true);
        session_run();
    }
}

void fake_hang_ms(uint32_t milliseconds)
{
    while (milliseconds--)
        pass_millisecond(false);
}

uint32_t fake_take_sent(uint8_t *bytes, uint32_t size)
{
    uint32_t length = sent_length < size ? sent_length : size;
    memcpy(bytes, sent, length);
    fake_forget_sent();
    return length;
}

void fake_forget_sent(void)
{
    sent_length = 0;
}

void fake_set_supply(uint16_t reading)
{
    readings[SUPPLY] = unloaded = reading;
}

void fake_set_loaded_supply(uint16_t reading)
{
    readings[SUPPLY] = reading;
}

void fake_set_drop(uint8_t board, uint16_t sixty_fourths)
{
    drops[board] = sixty_fourths;
}

void fake_set_current(uint8_t board, uint16_t reading)
{
    readings[board] = reading;
}

void fake_set_converter(bool runs)
{
    converting = runs;
}

void fake_lose_pwm_interrupt(void)
{
    pulsing = false;
}

void fake_set_output(uint8_t channel, uint16_t duty)
{
    outputs[channel] = duty;
}

bool fake_relay(void)
{
    return relay_is_closed;
}

uint8_t fake_remembered_cause(void)
{
    return remembered;
}

uint16_t fake_output(uint8_t channel)
{
    return outputs[channel];
}

bool fake_any_output(void)
{
    for (uint8_t channel = 0; channel < CHANNELS; channel++)
        if (outputs[channel])
            return true;
    return false;
}

uint32_t fake_time_us(void)
{
    return now_us;
}

uint16_t fake_nonce(void)
{
    static const char *const keys[] = {" nonce=", "K R "};
    uint32_t value = 0;
    for (uint32_t i = 0; i < sent_length; i++) {
        for (int k = 0; k < 2; k++) {
            uint32_t at = i + (uint32_t)strlen(keys[k]);
            if (at > sent_length || memcmp(sent + i, keys[k], strlen(keys[k])))
                continue;
            for (value = 0; at < sent_length && sent[at] >= '0' && sent[at] <= '9'; at++)
                value = value * 10 + (sent[at] - '0');
        }
    }
    return (uint16_t)value;
}
