/* Hostile bytes against the firmware's logic. `fuzz COUNT [SEED]` makes its own inputs; built with
 * -fsanitize=fuzzer -DLIBFUZZER it takes libFuzzer's. After every input:
 * without arming nothing is driven; armed, no duty exceeds its limit, and silence ends it. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fake_hardware.h"
#include "protocol.h"
#include "safety.h"

#define LONGEST 160

static uint16_t nonce;
static uint64_t executed, driven, stopped;

static void demand(bool claim, const char *what)
{
    if (claim)
        return;
    fprintf(stderr, "input %llu: %s\n", (unsigned long long)executed, what);
    abort();
}

static void say(const char *body)
{
    char text[100];
    int length = snprintf(text, sizeof text, "\n%s*%04X\n", body,
                          crc16((const uint8_t *)body, (uint8_t)strlen(body)));
    fake_receive((const uint8_t *)text, (uint32_t)length);
}

static void ask_nonce(void)
{
    fake_forget_sent();
    say("R");
    say("T 0");
    say("?");
    fake_run_ms(1);
    nonce = fake_nonce();
}

static void demand_sane(void)
{
    const struct safety *safety = safety_now();
    demand(safety->state <= STOPPED, "no such state");
    demand((safety->state == STOPPED) == (safety->cause != NO_CAUSE), "stopped without a cause");
    demand(!fake_any_output() || safety->state == ARMED, "driven while not armed");
    demand(fake_relay() == (safety->state == ARMED), "relay closed while not armed");
    for (uint8_t channel = 0; channel < CHANNELS; channel++)
        demand(fake_output(channel) <= DUTY_LIMIT_Q16, "driven above the duty limit");
}

/* An input may contain the arming nonce by chance. */
static bool guessed(const uint8_t *bytes, uint32_t length)
{
    char arming[20];
    uint16_t announced = fake_nonce();
    uint32_t size = (uint32_t)sprintf(arming, "A %u*", announced ? announced : nonce);
    for (uint32_t i = 0; i + size <= length; i++)
        if (!memcmp(bytes + i, arming, size))
            return true;
    return false;
}

static void attack_idle(const uint8_t *bytes, uint32_t length)
{
    fake_receive(bytes, length);
    fake_run_ms(1);
    demand_sane();
    if (safety_now()->state == ARMED || fake_any_output()) {
        demand(guessed(bytes, length), "armed or driven without the number that arms");
        ask_nonce();
    }
}

static void attack_armed(const uint8_t *bytes, uint32_t length)
{
    char body[64];
    ask_nonce();
    snprintf(body, sizeof body, "A %u", nonce);
    say(body);
    snprintf(body, sizeof body, "V %u 1 5000 1 0 2500", nonce);
    say(body);
    fake_run_ms(RELAY_MS + 1);
    demand(fake_any_output(), "a valid command was not obeyed");
    fake_receive(bytes, length);
    fake_run_ms(1);
    driven += fake_any_output();
    demand_sane();
    if (memchr(bytes, STOP_BYTE, length))
        demand(!fake_any_output(), "driven after the stop byte");
    fake_run_ms(COMMAND_TIMEOUT_MS + 1);
    stopped += safety_now()->state == STOPPED;
    demand(!fake_any_output(), "driven in silence");
}

static void attack(const uint8_t *bytes, uint32_t length, bool armed)
{
    executed++;
    if (armed)
        attack_armed(bytes, length);
    else
        attack_idle(bytes, length);
    if (executed % 64 == 0)
        ask_nonce();
    fake_forget_sent();
}

#ifdef LIBFUZZER
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (size < 1 || size > 4 * LONGEST)
        return 0;
    fake_start(data[0]);
    ask_nonce();
    attack(data + 1, (uint32_t)size - 1, data[0] & 1);
    return 0;
}
#else

/* --- inputs ----------------------------------------------------------------------------------- */

static uint64_t random_state;

static uint32_t below(uint32_t end)
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    random_state ^= random_state << 17;
    return (uint32_t)(random_state >> 32) % end;
}

/* Anything but the arming nonce: guessing it is not tested here. */
static uint32_t some_number(bool armed)
{
    static const uint32_t edges[] = {0, 1, 99, 100, 500, 10000, 10001, 32767, 65535, 65536};
    uint32_t number = below(3) ? below(65536) : edges[below(sizeof edges / sizeof *edges)];
    if (armed && !below(3))
        return nonce;
    return number == nonce ? number + 1 : number;
}

static uint32_t some_line(char *text, bool armed)
{
    static const char names[] = "?SAVDRTBPCVVX*\r!";
    char body[LONGEST];
    int length = snprintf(body, sizeof body, "%c", names[below(sizeof names - 1)]);
    for (uint32_t field = below(8); field; field--)
        length += snprintf(body + length, sizeof body - (size_t)length, " %u", some_number(armed));
    if (below(8))
        return (uint32_t)sprintf(text, "%s*%04X\n", body,
                                 crc16((const uint8_t *)body, (uint8_t)length));
    return (uint32_t)sprintf(text, "%s\n", body);
}

static void damage(uint8_t *bytes, uint32_t *length)
{
    uint32_t at = below(*length);
    switch (below(5)) {
    case 0:
        bytes[at] ^= (uint8_t)(1 << below(8));
        break;
    case 1:
        bytes[at] = (uint8_t)below(256);
        break;
    case 2:
        *length = at + 1;
        break;
    case 3:
        memmove(bytes + at, bytes + at + 1, *length - at - 1);
        *length -= *length > 1;
        break;
    default:
        memcpy(bytes + at, bytes, *length - at > at ? at : *length - at);
    }
}

static uint32_t some_input(uint8_t *bytes, bool armed)
{
    uint32_t length = 0;
    if (!below(4)) {
        for (length = 1 + below(LONGEST); length > 1 && below(2); length /= 2)
            ;
        for (uint32_t i = 0; i < length; i++)
            bytes[i] = (uint8_t)below(256);
        return length;
    }
    for (uint32_t lines = 1 + below(3); lines; lines--)
        length += some_line((char *)bytes + length, armed);
    for (uint32_t wounds = below(4); wounds; wounds--)
        damage(bytes, &length);
    return length;
}

int main(int count, char **arguments)
{
    uint64_t inputs = count > 1 ? strtoull(arguments[1], NULL, 10) : 20000;
    random_state = count > 2 ? strtoull(arguments[2], NULL, 10) : 1;
    random_state = random_state * 0x9E3779B97F4A7C15u + 1;
    fake_start(1);
    ask_nonce();
    for (uint64_t i = 0; i < inputs; i++) {
        uint8_t bytes[4 * LONGEST];
        bool armed = i % 16 == 15;
        attack(bytes, some_input(bytes, armed), armed);
    }
    printf("%llu inputs, %llu drove on, %llu ended stopped\n", (unsigned long long)executed,
           (unsigned long long)driven, (unsigned long long)stopped);
    return 0;
}
#endif
