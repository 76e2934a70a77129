#include "greeting.h"

#include "answers.h"
#include "hal.h"
#include "safety.h"

#define LINES 3

static uint8_t due; /* lines still to be sent, a bit each */
static uint16_t nonce;
static bool tell_nonce;

void greeting_start(uint16_t arming_nonce, bool asked)
{
    nonce = arming_nonce;
    tell_nonce = asked;
    due = (1 << LINES) - 1;
}

static void name_line(void)
{
    begin_message('H');
    add_text(PSTR(" name=" FIRMWARE_NAME " build=" BUILD_HASH));
    add_named(PSTR(" protocol="), PROTOCOL_VERSION);
    add_named(PSTR(" reset="), reset_flags());
    add_named(PSTR(" before="), cause_before());
    if (tell_nonce)
        add_named(PSTR(" nonce="), nonce);
}

static void limit_line(void)
{
    begin_message('L');
    add_named(PSTR(" channels="), CHANNELS);
    add_named(PSTR(" max_mv="), safety_limits()->max_mv);
    add_named(PSTR(" timeout_ms="), COMMAND_TIMEOUT_MS);
    add_named(PSTR(" duty="), DUTY_LIMIT_Q16);
    add_named(PSTR(" mean_ma="), safety_limits()->mean_ma);
    add_named(PSTR(" peak_ma="), safety_limits()->peak_ma);
    add_named(PSTR(" least_mohm="), safety_limits()->least_mohm);
}

static void more_limits_line(void)
{
    begin_message('M');
    add_named(PSTR(" hot_mv="), safety_limits()->hot_mv);
    add_named(PSTR(" hot_ms="), safety_limits()->hot_ms);
    add_named(PSTR(" on_duty="), ON_TIME_DUTY_Q16);
    add_named(PSTR(" on_s="), ON_TIME_LIMIT_S);
    add_named(PSTR(" supply_min_mv="), SUPPLY_MIN_MV);
    add_named(PSTR(" supply_max_mv="), SUPPLY_MAX_MV);
}

/* The rest of an interrupted handshake goes out as soon as there is room. */
void greet(void)
{
    static void (*const lines[LINES])(void) = {name_line, limit_line, more_limits_line};
    for (uint8_t i = 0; i < LINES; i++) {
        if (!(due & (1 << i)) || serial_room() < MESSAGE_MAX)
            continue;
        lines[i]();
        send_message();
        due &= (uint8_t)~(1 << i);
    }
}
