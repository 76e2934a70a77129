#include "greeting.h"

#include "answers.h"
#include "hal.h"
#include "trips.h"

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

void add_last_trip(void)
{
    struct trip trip = trips_last();
    add_named(PSTR(" trip="), trip.cause);
    add_named(PSTR(" trip_ds="), trip.at);
    add_named(PSTR(" trip_open="), trip.open);
}

static void name_line(void)
{
    begin_message('H');
    add_text(PSTR(" name=" FIRMWARE_NAME " build=" BUILD_HASH));
    add_named(PSTR(" protocol="), PROTOCOL_VERSION);
    add_named(PSTR(" reset="), reset_flags());
    add_named(PSTR(" before="), cause_before());
    add_last_trip();
    if (tell_nonce)
        add_named(PSTR(" nonce="), nonce);
}

static void limit_line(void)
{
    begin_message('L');
    add_named(PSTR(" channels="), CHANNELS);
    add_named(PSTR(" max_mv="), MAX_COMMAND_MV);
    add_named(PSTR(" timeout_ms="), COMMAND_TIMEOUT_MS);
    add_named(PSTR(" duty="), DUTY_LIMIT_Q16);
    add_named(PSTR(" mean_ma="), MEAN_LIMIT_MA);
    add_named(PSTR(" peak_ma="), PEAK_LIMIT_MA);
    add_named(PSTR(" least_mohm="), LEAST_MOHM);
}

static void more_limits_line(void)
{
    begin_message('M');
    add_named(PSTR(" hot_mv="), HOT_MV);
    add_named(PSTR(" hot_ms="), HOT_MS);
    add_named(PSTR(" on_duty="), ON_TIME_DUTY_Q16);
    add_named(PSTR(" on_s="), ON_TIME_LIMIT_S);
    add_named(PSTR(" supply_min_mv="), SUPPLY_MIN_MV);
    add_named(PSTR(" supply_max_mv="), SUPPLY_MAX_MV);
}

/* Lines that did not fit are sent as soon as there is room. */
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
