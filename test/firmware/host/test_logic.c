/* Tests of protocol.c, safety.c, trips.c and session.c; `test_logic NAME` runs one, `--list` names all. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fake_hardware.h"
#include "protocol.h"
#include "safety.h"
#include "trips.h"

#define CHECK(claim)                                                        \
    do {                                                                    \
        if (!(claim)) {                                                     \
            fprintf(stderr, "%s:%d: not so: %s\n", __FILE__, __LINE__, #claim); \
            exit(1);                                                        \
        }                                                                   \
    } while (0)

/* Defines a test, which adds itself to the list before main runs. */
#define TEST(function)                                                      \
    static void function(void);                                             \
    static struct test listed_##function = {#function, function, NULL};     \
    __attribute__((constructor)) static void list_##function(void)          \
    {                                                                       \
        *list_end = &listed_##function;                                     \
        list_end = &listed_##function.next;                                 \
    }                                                                       \
    static void function(void)

static struct test {
    const char *name;
    void (*run)(void);
    struct test *next;
} *tests, **list_end = &tests;
static uint16_t open_session;

/* --- helpers ---------------------------------------------------------------------------------- */

static void say(const char *body)
{
    char text[200];
    int length = snprintf(text, sizeof text, "%s*%04X\n", body,
                          crc16((const uint8_t *)body, (uint8_t)strlen(body)));
    fake_receive((const uint8_t *)text, (uint32_t)length);
}

/* True if the answer to `body` contains `expected`. */
static bool answers(const char *body, const char *expected)
{
    char sent[4096];
    fake_forget_sent();
    say(body);
    uint32_t length = fake_take_sent((uint8_t *)sent, sizeof sent - 1);
    sent[length] = 0;
    return strstr(sent, expected) != NULL;
}

static const char *arming(unsigned nonce)
{
    static char body[40];
    snprintf(body, sizeof body, "A %u", nonce);
    return body;
}

static void arm(void)
{
    fake_forget_sent();
    say("?");
    fake_run_ms(1);
    open_session = fake_nonce();
    CHECK(answers(arming(open_session), "K A"));
    CHECK(safety_now()->state == ARMED);
}

static const char *volts(unsigned sequence, unsigned a, unsigned b, unsigned c, unsigned d)
{
    static char body[64];
    snprintf(body, sizeof body, "V %u %u %u %u %u %u", open_session, sequence, a, b, c, d);
    return body;
}

static void start_driving(void)
{
    fake_start(1);
    arm();
    say(volts(1, 6000, 0, 0, 3000));
    fake_run_ms(RELAY_MS + 2);
    CHECK(fake_output(0) > 16000 && fake_output(0) < 16700); /* a quarter */
    CHECK(!fake_output(1) && !fake_output(2) && fake_output(3));
}

static bool is_off_for(uint8_t cause)
{
    return !fake_any_output() && safety_now()->state == STOPPED && safety_now()->cause == cause;
}

static uint8_t parsed(const char *text, struct command *command)
{
    struct line line;
    line_clear(&line);
    for (; *text; text++)
        line_add(&line, (uint8_t)*text);
    return parse_command(&line, command);
}

/* --- protocol --------------------------------------------------------------------------------- */

TEST(crc_has_the_published_check_value)
{
    CHECK(crc16((const uint8_t *)"123456789", 9) == 0x29B1);
}

TEST(well_formed_lines_are_understood)
{
    struct command c;
    CHECK(parsed("?", &c) == ACCEPTED && c.name == '?' && !c.sealed && c.count == 0);
    CHECK(parsed("V 1 2 65535 0 10 7*F8D7", &c) == BAD_CHECKSUM);
    CHECK(parsed("T 100\r", &c) == ACCEPTED && c.count == 1 && c.field[0] == 100);
    CHECK(parsed("V 65535 1 2 3 4 5", &c) == ACCEPTED && c.field[0] == 65535 && c.count == 6);
}

TEST(malformed_lines_are_refused)
{
    static const char *const lines[] = {"V  1", "V 1 ", "V -1", "V 01", "V 65536", "V 4294967297",
                                        "V 1.5", "V 1e3", "V\t1", " V", "V nan", "V 1 2 3 4 5 6 7",
                                        "V1", "", "\r", "V 1\r\r"};
    struct command c;
    for (size_t i = 0; i < sizeof lines / sizeof *lines; i++)
        CHECK(parsed(lines[i], &c) == BAD_FORMAT);
}

TEST(checksums_are_upper_case)
{
    struct command c;
    char line[20], lower[20];
    snprintf(line, sizeof line, "T 10*%04X", crc16((const uint8_t *)"T 10", 4));
    snprintf(lower, sizeof lower, "T 10*%04x", crc16((const uint8_t *)"T 10", 4));
    CHECK(strcmp(line, lower)); /* it has a letter, or this proves nothing */
    CHECK(parsed(line, &c) == ACCEPTED && c.sealed);
    CHECK(parsed(lower, &c) == BAD_CHECKSUM);
}

TEST(every_single_bit_error_is_noticed)
{
    struct command c;
    const char *body = "V 4711 12 2500 0 0 9999";
    char good[64], bad[64];
    snprintf(good, sizeof good, "%s*%04X", body, crc16((const uint8_t *)body, 23));
    CHECK(parsed(good, &c) == ACCEPTED);
    for (size_t bit = 0; bit < 8 * strlen(good); bit++) {
        memcpy(bad, good, sizeof bad);
        bad[bit / 8] = (char)(bad[bit / 8] ^ (1 << bit % 8));
        CHECK(!(parsed(bad, &c) == ACCEPTED && c.sealed));
    }
}

TEST(overlong_lines_are_refused_whole)
{
    fake_start(1);
    arm();
    char body[200];
    memset(body, ' ', sizeof body);
    strcpy(body + 120, "D");
    CHECK(answers(body, "N - 3"));
    CHECK(safety_now()->state == ARMED);
}

TEST(frames_have_no_zero_inside_and_decode_to_the_body)
{
    for (int length = 0; length < 130; length++) {
        for (int zero_every = 1; zero_every < 7; zero_every++) {
            struct message m;
            uint8_t body[140], decoded[300];
            message_clear(&m);
            for (int i = 0; i < length; i++) {
                body[i] = (uint8_t)(i % zero_every ? i * 7 + 1 : 0);
                put_byte(&m, body[i]);
            }
            CHECK(seal_binary(&m));
            CHECK(m.bytes[m.length - 1] == 0);
            CHECK(memchr(m.bytes, 0, m.length) == m.bytes + m.length - 1);
            int out = 0;
            for (int at = 0; at < m.length - 1;) {
                int code = m.bytes[at++];
                for (int k = 1; k < code; k++)
                    decoded[out++] = m.bytes[at++];
                decoded[out++] = 0;
            }
            CHECK(out - 1 == length + 2); /* the last zero is the delimiter's */
            CHECK(!memcmp(decoded, body, (size_t)length));
            CHECK((decoded[length] | decoded[length + 1] << 8) == crc16(body, (uint8_t)length));
        }
    }
}

TEST(messages_that_do_not_fit_are_not_sealed)
{
    struct message m;
    for (int length = MESSAGE_MAX - 8; length < MESSAGE_MAX + 20; length++) {
        message_clear(&m);
        for (int i = 0; i < length; i++)
            put_byte(&m, 'x');
        CHECK(seal_text(&m) == (length + 6 <= MESSAGE_MAX));
        message_clear(&m);
        for (int i = 0; i < length; i++)
            put_byte(&m, 'x');
        CHECK(seal_binary(&m) == (length + 4 <= MESSAGE_MAX));
    }
}

TEST(numbers_are_written_in_full)
{
    static const uint32_t values[] = {0, 9, 10, 99, 65535, 1000000000, 4294967295};
    for (size_t i = 0; i < sizeof values / sizeof *values; i++) {
        struct message m;
        char expected[20];
        message_clear(&m);
        put_decimal(&m, values[i]);
        snprintf(expected, sizeof expected, "%lu", (unsigned long)values[i]);
        CHECK(m.length == strlen(expected) && !memcmp(m.bytes, expected, m.length));
    }
    struct message m;
    message_clear(&m);
    put_signed(&m, INT16_MIN);
    CHECK(m.length == 6 && !memcmp(m.bytes, "-32768", 6));
}

TEST(duty_is_the_square_of_the_voltage_ratio)
{
    CHECK(duty_of(0, 12000) == 0);
    CHECK(duty_of(0, 0) == 0);
    CHECK(duty_of(6000, 12000) == 16384);
    CHECK(duty_of(12000, 12000) == 65535);
    CHECK(duty_of(12001, 12000) == 65535);
    for (uint32_t mv = 0; mv < 12000; mv += 7) {
        double exact = 65536.0 * mv * mv / (12000.0 * 12000.0);
        CHECK(fabs(duty_of((uint16_t)mv, 12000) - exact) < 2.6);
    }
}

/* --- session ---------------------------------------------------------------------------------- */

TEST(nothing_is_driven_before_arming)
{
    fake_start(1);
    CHECK(answers("V 0 1 5000 5000 5000 5000", "N V 4"));
    fake_run_ms(10);
    CHECK(!fake_any_output());
    CHECK(answers("A 0", "N A 5"));
    CHECK(safety_now()->state == IDLE);
}

TEST(arming_alone_drives_nothing)
{
    fake_start(1);
    arm();
    fake_run_ms(100);
    CHECK(!fake_any_output());
}

TEST(a_person_may_ask_but_not_drive_without_checksum)
{
    uint8_t sent[4096];
    fake_start(1);
    fake_receive((const uint8_t *)"?\r\n", 3);
    fake_run_ms(1);
    CHECK(fake_take_sent(sent, sizeof sent) > 100);
    arm();
    char line[64];
    int length = snprintf(line, sizeof line, "%s\n", volts(1, 5000, 0, 0, 0));
    fake_receive((const uint8_t *)line, (uint32_t)length);
    fake_run_ms(2);
    CHECK(!fake_any_output());
}

TEST(replayed_bytes_drive_nothing)
{
    char driving[64];
    start_driving();
    unsigned nonce = open_session;
    strcpy(driving, volts(2, 9000, 0, 0, 0));
    say(driving);
    CHECK(answers(driving, "N V 6"));
    CHECK(answers("D", "K D"));
    CHECK(answers(arming(nonce), "N A 5"));
    CHECK(answers(driving, "N V 4"));
    arm(); /* anew: the old session's commands stay dead */
    CHECK(answers(driving, "N V 5"));
    fake_run_ms(5);
    CHECK(!fake_any_output());
}

TEST(sequence_may_wrap_but_not_go_back)
{
    start_driving();
    CHECK(!answers(volts(32000, 1, 1, 1, 1), "N V"));
    CHECK(!answers(volts(64000, 1, 1, 1, 1), "N V"));
    CHECK(!answers(volts(5, 1, 1, 1, 1), "N V"));
    CHECK(answers(volts(64000, 1, 1, 1, 1), "N V 6"));
    CHECK(answers(volts(5, 1, 1, 1, 1), "N V 6"));
}

TEST(commands_out_of_limits_change_nothing)
{
    start_driving();
    uint16_t before = fake_output(0);
    CHECK(answers(volts(2, MAX_COMMAND_MV + 1, 0, 0, 0), "N V 7"));
    CHECK(answers(volts(2, 0, 0, 0, 65535), "N V 7"));
    fake_set_supply(500); /* 9.77 V: 9.5 V would be a duty of 0.95 */
    fake_run_ms(150);
    say(volts(3, 6000, 0, 0, 0));
    fake_run_ms(1);
    CHECK(answers(volts(4, 9500, 0, 0, 0), "N V 8"));
    CHECK(safety_now()->state == ARMED && fake_output(0) > before);
}

TEST(duty_follows_the_supply)
{
    start_driving();
    fake_set_supply(512); /* 10 V */
    for (unsigned turn = 2; turn < 20; turn++) {
        say(volts(turn, 6000, 0, 0, 0));
        fake_run_ms(20);
    }
    CHECK(abs((int)fake_output(0) - (int)(0.36 * 65536)) < 100);
}

TEST(duties_follow_the_supply_each_ten_milliseconds)
{
    start_driving();
    fake_set_supply(450);
    int steps = 0;
    for (int ms = 0; ms < 60; ms++) {
        uint16_t before = fake_output(0);
        fake_run_ms(1);
        steps += fake_output(0) != before;
    }
    CHECK(steps >= 5);
}

TEST(handshake_and_disarm_switch_off)
{
    start_driving();
    say("?");
    fake_run_ms(1);
    CHECK(!fake_any_output() && safety_now()->state == IDLE);
    arm();
    say(volts(1, 6000, 0, 0, 0));
    fake_run_ms(RELAY_MS + 1);
    CHECK(fake_any_output());
    CHECK(answers("D", "K D"));
    fake_run_ms(1);
    CHECK(!fake_any_output() && safety_now()->state == IDLE);
}

TEST(telemetry_rates_are_checked)
{
    fake_start(1);
    CHECK(answers("T 100", "K T 100"));
    CHECK(answers("T 101", "N T 10"));
    CHECK(answers("T 200", "N T 10"));
    CHECK(answers("B 600", "N B 10"));
    CHECK(answers("B 333", "N B 10"));
    CHECK(answers("T 0", "K T 0"));
    fake_forget_sent();
    fake_run_ms(100);
    uint8_t sent[100];
    CHECK(fake_take_sent(sent, sizeof sent) == 0);
}

/* --- safety ----------------------------------------------------------------------------------- */

TEST(silence_stops_after_the_timeout)
{
    start_driving();
    fake_run_ms(COMMAND_TIMEOUT_MS - RELAY_MS - 7);
    CHECK(fake_any_output());
    fake_run_ms(10);
    CHECK(is_off_for(COMMAND_TIMEOUT));
}

TEST(commands_keep_it_driving)
{
    start_driving();
    for (unsigned turn = 2; turn < 100; turn++) {
        say(volts(turn, 6000, 0, 0, 0));
        fake_run_ms(COMMAND_TIMEOUT_MS / 2);
    }
    CHECK(fake_any_output() && safety_now()->state == ARMED);
}

TEST(refused_commands_do_not_hold_off_the_timeout)
{
    start_driving();
    for (int turn = 0; turn < 30; turn++) {
        say(volts(2, 60000, 0, 0, 0));
        fake_run_ms(10);
    }
    CHECK(is_off_for(COMMAND_TIMEOUT));
}

TEST(stop_byte_stops_in_the_middle_of_a_line)
{
    start_driving();
    fake_receive((const uint8_t *)"V 1 2!", 6);
    CHECK(is_off_for(STOP_BYTE_SEEN));
}

TEST(stop_stays_until_reset_and_arming)
{
    start_driving();
    fake_receive((const uint8_t *)"!", 1);
    CHECK(answers(volts(2, 1000, 0, 0, 0), "N V 4"));
    say("?");
    fake_run_ms(500);
    CHECK(is_off_for(STOP_BYTE_SEEN));
    CHECK(answers(arming(fake_nonce()), "N A 11"));
    CHECK(answers("R", "K R"));
    CHECK(safety_now()->state == IDLE && safety_now()->cause == NO_CAUSE);
    CHECK(answers(volts(3, 1000, 0, 0, 0), "N V 4"));
    arm();
}

TEST(arming_again_does_not_resume_earlier_commands)
{
    start_driving();
    uint16_t before = open_session;
    fake_receive((const uint8_t *)"!", 1);
    fake_forget_sent();
    say("R");
    CHECK(fake_nonce() && fake_nonce() != before);
    arm();
    for (int ms = 0; ms < 150; ms++) {
        fake_run_ms(1);
        CHECK(!fake_any_output());
    }
    say(volts(1, 6000, 0, 0, 0));
    fake_run_ms(2);
    CHECK(fake_output(0) > 16000 && !fake_output(3));
}

TEST(an_output_that_comes_on_by_itself_goes_off_and_a_restart_opens_the_relay)
{
    start_driving();
    CHECK(fake_relay());
    fake_start(1);
    CHECK(!fake_relay() && !fake_any_output() && safety_now()->state == IDLE);
    fake_set_output(1, 30000);
    fake_run_ms(1);
    CHECK(!fake_any_output());
}

TEST(first_cause_is_kept)
{
    start_driving();
    fake_set_current(1, 1023);
    fake_run_ms(1);
    fake_receive((const uint8_t *)"!", 1);
    fake_run_ms(300);
    CHECK(is_off_for(BACK_OVER_CURRENT));
}

TEST(one_reading_above_the_peak_stops)
{
    start_driving();
    fake_set_current(0, 512 + PEAK_LIMIT_MA * FRONT_MV_PER_A / 5000UL * 1024 / 1000 + 2);
    fake_run_ms(1);
    CHECK(is_off_for(FRONT_OVER_CURRENT));
}

TEST(current_the_wrong_way_stops_too)
{
    start_driving();
    fake_set_current(1, 20);
    fake_run_ms(1);
    CHECK(is_off_for(BACK_OVER_CURRENT));
}

TEST(a_mean_above_its_limit_stops)
{
    start_driving();
    say(volts(2, 9500, 9500, 0, 0));
    fake_run_ms(100);
    fake_set_current(0, 512 + 145); /* 7.1 A, below the peak */
    fake_run_ms(5);
    CHECK(fake_any_output());
    fake_run_ms(60);
    CHECK(is_off_for(FRONT_OVER_CURRENT));
}

TEST(a_mean_just_below_its_limit_does_not_stop_and_one_just_above_stops_in_both_directions)
{
    for (int way = -1; way <= 1; way += 2) {
        fake_start(1);
        CHECK(answers("C 10000 5970 12000 1900 8000 2000", "K C 0")); /* 122 1/4 steps */
        arm();
        say(volts(1, 9500, 9500, 0, 0));
        fake_run_ms(50);
        fake_set_current(0, (uint16_t)(512 + way * 122));
        fake_run_ms(100);
        CHECK(fake_any_output());
        say(volts(2, 9500, 9500, 0, 0));
        fake_set_current(0, (uint16_t)(512 + way * 123));
        fake_run_ms(100);
        CHECK(is_off_for(FRONT_OVER_CURRENT));
    }
}

TEST(current_while_idle_stops_too)
{
    fake_start(1);
    fake_set_current(0, 1000);
    fake_run_ms(1);
    CHECK(is_off_for(FRONT_OVER_CURRENT));
    say("R");
    fake_run_ms(1);
    CHECK(is_off_for(FRONT_OVER_CURRENT));
}

TEST(lost_supply_stops)
{
    start_driving();
    fake_set_supply(0);
    fake_run_ms(40);
    CHECK(is_off_for(SUPPLY_RANGE));
    say("R");
    say("?");
    fake_run_ms(1);
    CHECK(answers(arming(fake_nonce()), "N A 9"));
}

TEST(nothing_arms_in_the_first_tenth_of_a_second_and_what_is_refused_is_counted)
{
    fake_start(1);
    safety_init();
    safety_supply_range(0, UINT16_MAX);
    CHECK(answers("S", " rejected=0 "));
    fake_run_ms(90);
    say("?");
    fake_run_ms(1);
    CHECK(answers(arming(fake_nonce()), "N A 9"));
    CHECK(answers("S", " rejected=1 "));
    fake_run_ms(20);
    arm();
}

TEST(sagging_supply_stops_at_the_duty_limit)
{
    start_driving();
    say(volts(2, 9900, 0, 0, 0));
    fake_run_ms(1);
    fake_set_supply(517); /* 10.1 V */
    fake_run_ms(120);
    CHECK(is_off_for(DUTY_LIMIT));
}

TEST(on_for_too_long_stops_even_with_short_dips)
{
    start_driving();
    unsigned sequence = 2;
    uint32_t begin = fake_time_us();
    for (uint32_t s = 0; s < 2 * ON_TIME_LIMIT_S && fake_any_output(); s++) {
        for (int i = 0; i < 10; i++) {
            say(volts(sequence++, s % 10 || i ? 6000 : 0, 0, 0, 1));
            fake_run_ms(100);
            fake_forget_sent();
        }
    }
    CHECK(is_off_for(ON_TIME_LIMIT));
    double seconds = (uint32_t)(fake_time_us() - begin) / 1e6;
    CHECK(seconds > ON_TIME_LIMIT_S && seconds < 1.03 * ON_TIME_LIMIT_S);
}

TEST(pauses_count_as_cooling)
{
    start_driving();
    unsigned sequence = 2;
    for (uint32_t s = 0; s < 3 * ON_TIME_LIMIT_S; s++) {
        for (int i = 0; i < 10; i++) {
            say(volts(sequence++, s % 60 < 30 ? 6000 : 0, 0, 0, 1));
            fake_run_ms(100);
            fake_forget_sent();
        }
    }
    CHECK(safety_now()->state == ARMED);
}

TEST(hung_loop_stops_before_the_watchdog)
{
    start_driving();
    fake_hang_ms(35);
    CHECK(is_off_for(LOOP_STALLED));
    CHECK(!safety_tick());
}

TEST(stuck_converter_stops)
{
    start_driving();
    fake_set_converter(false);
    fake_run_ms(15);
    CHECK(is_off_for(NO_SAMPLES));
}

TEST(no_nonce_is_told_before_it_is_asked_for)
{
    fake_start(1);
    CHECK(!fake_nonce());
    CHECK(answers(arming(1), "N A 5")); /* what the start's number would be */
    say("?");
    fake_run_ms(1);
    CHECK(fake_nonce());
}

TEST(a_new_nonce_differs_whatever_the_converter_reads)
{
    const uint16_t same = 3915; /* 25173 times it and 13849 is 0 */
    fake_start(same);
    say("?");
    fake_run_ms(1);
    CHECK(fake_nonce() && fake_nonce() != same);
}

TEST(limits_are_set_within_the_ceilings_and_not_while_armed)
{
    fake_start(1);
    CHECK(answers("C 5000 2000 9000 1900 6000 200", "K C 0"));
    CHECK(answers("C 10001 2000 9000 1900 6000 200", "N C 14"));
    CHECK(answers("C 5000 6501 9000 1900 6000 200", "N C 14"));
    CHECK(answers("C 5000 2000 12001 1900 6000 200", "N C 14"));
    CHECK(answers("C 5000 2000 2000 1900 6000 200", "N C 14"));
    CHECK(answers("C 5000 2000 9000 999 6000 200", "N C 14"));
    CHECK(answers("C 5000 2000 9000 1900 8001 200", "N C 14"));
    CHECK(answers("C 5000 2000 9000 1900 6000 2001", "N C 14"));
    CHECK(answers("C 5000 2000 9000 1900 6000 39", "N C 14"));
    CHECK(safety_limits()->max_mv == 5000 && safety_limits()->hot_ms == 200);
    arm();
    CHECK(answers("C 6000 2000 9000 1900 6000 200", "N C 12"));
    CHECK(answers(volts(1, 5001, 0, 0, 0), "N V 7"));
    CHECK(!answers(volts(1, 5000, 0, 0, 0), "N V"));
}

TEST(the_relay_is_closed_while_armed_only_and_before_anything_is_driven)
{
    fake_start(1);
    CHECK(!fake_relay());
    arm();
    CHECK(fake_relay());
    say(volts(1, 6000, 0, 0, 0));
    fake_run_ms(RELAY_MS - 2);
    CHECK(!fake_any_output());
    fake_run_ms(4);
    CHECK(fake_any_output());
    fake_receive((const uint8_t *)"!", 1);
    CHECK(!fake_relay());
}

TEST(a_switch_that_does_not_open_stops_and_is_reported_until_it_opens)
{
    fake_start(1);
    fake_set_current(0, 512 + 91); /* 4.44 A */
    fake_run_ms(150);
    CHECK(is_off_for(OFF_CURRENT) && safety_now()->flows == 1);
    CHECK(answers("R", "N R 13"));
    fake_set_current(0, 512);
    fake_run_ms(150);
    CHECK(is_off_for(OFF_CURRENT) && !safety_now()->flows);
    CHECK(answers("R", "K R"));
    CHECK(safety_now()->state == IDLE);
}

TEST(half_an_ampere_more_through_either_board_that_is_off_stops)
{
    for (uint8_t board = 0; board < BOARDS; board++) {
        fake_start(1);
        fake_set_current(board, 512 + 8); /* 0.4 A */
        fake_run_ms(300);
        CHECK(safety_now()->state == IDLE);
        fake_set_current(board, 512 + 13); /* 0.63 A */
        fake_run_ms(300);
        CHECK(is_off_for(OFF_CURRENT) && safety_now()->flows == 1 << board);
        fake_set_current(board, 512);
        fake_run_ms(300);
    }
}

TEST(current_until_a_stop_is_no_stuck_switch)
{
    start_driving();
    fake_set_current(0, 512 + 30); /* 1.5 A */
    fake_run_ms(60);
    fake_receive((const uint8_t *)"!", 1);
    fake_set_current(0, 512);
    for (int ms = 0; ms < 150; ms++) {
        fake_run_ms(1);
        CHECK(!safety_now()->flows);
    }
    CHECK(is_off_for(STOP_BYTE_SEEN));
    fake_set_current(0, 512);
    say("R");
    start_driving();
    fake_set_current(0, 512 + 30);
    fake_run_ms(60);
    fake_receive((const uint8_t *)"!", 1);
    fake_run_ms(120);
    CHECK(is_off_for(STOP_BYTE_SEEN) && safety_now()->flows == 1);
}

TEST(a_seventh_of_an_ampere_more_than_at_arming_stops_either_board)
{
    for (uint8_t board = 0; board < BOARDS; board++) {
        fake_start(1);
        fake_set_current(board, 512 + 8); /* its offset */
        fake_run_ms(100);
        arm();
        fake_set_current(board, 512 + 11);
        fake_run_ms(120);
        CHECK(is_off_for(OFF_CURRENT));
    }
}

TEST(noise_in_the_moment_of_arming_is_no_offset)
{
    fake_start(1);
    fake_set_current(1, 512 + 1); /* 49 mA */
    fake_run_ms(20);
    arm();
    fake_set_current(1, 512 - 1);
    fake_run_ms(200);
    CHECK(safety_now()->state == ARMED);
}

TEST(an_offset_from_just_before_arming_counts_in_both_directions)
{
    for (int way = -1; way <= 1; way += 2) {
        fake_start(1);
        fake_set_current(0, (uint16_t)(512 + 6 * way)); /* 0.29 A */
        fake_run_ms(45);
        arm();
        fake_run_ms(200);
        CHECK(safety_now()->state == ARMED);
    }
    fake_start(1);
    fake_run_ms(200);
    fake_set_current(0, 512 - 3); /* 0.15 A, and then noise of a step beside it */
    fake_run_ms(35);
    arm();
    for (int k = 0; k < 100; k++) {
        fake_set_current(0, (uint16_t)(512 - 3 - (k & 1)));
        fake_run_ms(2);
    }
    CHECK(safety_now()->state == ARMED);
}

TEST(current_until_disarming_is_no_offset)
{
    start_driving();
    fake_set_current(0, 512 + 26); /* 1.27 A */
    fake_run_ms(30);
    say("D");
    fake_set_current(0, 512);
    fake_run_ms(110);
    arm();
    fake_run_ms(200);
    CHECK(safety_now()->state == ARMED);
}

TEST(a_sensors_offset_is_no_current)
{
    fake_start(1);
    fake_set_current(0, 512 + 8); /* 0.4 A, 40 mV */
    fake_run_ms(300);
    CHECK(safety_now()->state == IDLE);
    arm();
    for (unsigned sequence = 1; sequence < 10; sequence++) {
        say(volts(sequence, 500, 0, 0, 0));
        fake_run_ms(100);
    }
    CHECK(safety_now()->state == ARMED);
}

TEST(current_behind_a_closed_relay_with_nothing_driven_stops)
{
    fake_start(1);
    arm();
    fake_set_current(1, 512 + 91);
    fake_run_ms(20);
    CHECK(is_off_for(OFF_CURRENT));
    CHECK(fake_remembered_cause() == OFF_CURRENT);
}

TEST(current_beyond_what_the_duties_explain_stops)
{
    fake_start(1);
    CHECK(answers("C 10000 6500 12000 1900 8000 2000", "K C 0"));
    arm();
    say(volts(1, 1000, 0, 0, 0));
    fake_run_ms(100);
    CHECK(fake_any_output());
    fake_set_current(0, 512 + 4); /* 0.2 A: a dead short that the sensor clips */
    fake_run_ms(60);
    CHECK(is_off_for(UNEXPLAINED_CURRENT));
}

TEST(long_pulses_of_a_small_duty_are_no_fault)
{
    fake_start(1);
    arm();
    for (unsigned sequence = 1; sequence < 20; sequence++) {
        say(volts(sequence, 500, 0, 0, 0));
        fake_set_current(0, 512 + 26); /* now and then a long pulse, of a small duty */
        fake_run_ms(1);
        fake_set_current(0, 512);
        fake_run_ms(60);
    }
    CHECK(safety_now()->state == ARMED);
}

TEST(a_current_that_follows_a_step_down_is_explained)
{
    start_driving();
    say(volts(2, 9000, 0, 0, 0));
    fake_set_current(0, 512 + 51); /* 2.5 A */
    fake_run_ms(150);
    say(volts(3, 0, 0, 0, 0));
    fake_set_current(0, 512);
    fake_run_ms(150);
    CHECK(safety_now()->state == ARMED);
}

TEST(heat_beyond_its_limit_stops_and_short_pulses_do_not)
{
    fake_start(1);
    CHECK(answers("C 10000 6500 12000 1900 6000 200", "K C 0"));
    arm();
    unsigned sequence = 1;
    for (int pulse = 0; pulse < 10; pulse++) {
        say(volts(sequence++, pulse % 4 ? 0 : 8000, 0, 0, 0));
        fake_run_ms(80);
    }
    CHECK(safety_now()->state == ARMED);
    say(volts(sequence++, 8000, 0, 0, 0));
    fake_run_ms(150);
    say(volts(sequence++, 8000, 0, 0, 0));
    fake_run_ms(150);
    CHECK(is_off_for(HEAT_LIMIT));
}

/* The state after 7.9 V for 10 s at a supply of 12 V that a board's pulse lowers by so many mV. */
static uint8_t state_of_a_board_whose_pulse_takes(unsigned mv)
{
    fake_start(1);
    CHECK(answers("C 10000 6500 12000 1890 8000 2000", "K C 0"));
    arm();
    fake_set_drop(1, (uint16_t)(mv * 64 * 1024 / REFERENCE_MV / SUPPLY_DIVIDER));
    for (unsigned sequence = 1; sequence < 100; sequence++) {
        say(volts(sequence, 0, 0, 0, 7900));
        fake_run_ms(100);
    }
    return safety_now()->state;
}

TEST(a_supply_that_sags_in_a_pulse_heats_less_but_a_sag_of_more_than_an_eighth_is_not_used)
{
    CHECK(state_of_a_board_whose_pulse_takes(0) == ARMED);
    CHECK(state_of_a_board_whose_pulse_takes(1000) == ARMED);
    CHECK(state_of_a_board_whose_pulse_takes(2000) == STOPPED);
    CHECK(is_off_for(HEAT_LIMIT));
}

TEST(a_lost_output_interrupt_stops)
{
    start_driving();
    fake_lose_pwm_interrupt();
    fake_run_ms(8);
    CHECK(is_off_for(PWM_STALLED));
    CHECK(!safety_tick());
}

TEST(an_output_that_is_not_as_set_stops)
{
    start_driving();
    fake_lose_pwm_interrupt(); /* which would set it right each millisecond */
    for (int ms = 0; ms < 40 && safety_now()->state == ARMED; ms++) {
        safety_duties();
        fake_set_output(1, 30000);
        fake_run_ms(1);
    }
    CHECK(is_off_for(OUTPUT_DIFFERS));
}

/* One channel after the other is looked at, eight times: whoever is lucky is seen at the third. */
TEST(an_output_that_differs_in_three_checks_stops)
{
    int soonest = 100;
    for (int begin = 0; begin < 40; begin++) {
        start_driving();
        fake_lose_pwm_interrupt();
        for (int ms = 0; ms < begin; ms++) {
            safety_duties();
            fake_run_ms(1);
        }
        int ms = 0;
        for (; ms < 40 && safety_now()->state == ARMED; ms++) {
            safety_duties();
            fake_set_output(1, 30000);
            fake_run_ms(1);
        }
        CHECK(is_off_for(OUTPUT_DIFFERS));
        soonest = ms < soonest ? ms : soonest;
    }
    CHECK(soonest == 3);
}

/* --- trips ------------------------------------------------------------------------------------ */

static bool last_is(uint8_t cause, bool open, uint32_t at)
{
    struct trip last = trips_last();
    return last.cause == cause && last.open == open && last.at == at;
}

static bool same(struct trip a, struct trip b)
{
    return a.cause == b.cause && a.open == b.open && a.at == b.at;
}

/* A stop for this cause, and what is then to be kept. */
static struct trip trip(uint8_t cause)
{
    safety_reset();
    trips_look();
    safety_stop(cause);
    trips_look();
    return trips_last();
}

/* Until nothing is left to be stored, or so many bytes were and one more is under way. */
static unsigned store_bytes(unsigned most)
{
    for (unsigned stored = 0;; stored++) {
        trips_follow();
        if (!fake_byte_is_under_way() || stored == most)
            return stored;
        fake_end_byte();
    }
}

/* The power fails while a byte is being stored, and comes back. */
static struct trip found_after_cut(uint8_t garbage)
{
    fake_lose_byte(garbage);
    safety_init();
    trips_init(false);
    return trips_last();
}

TEST(a_trip_outlasts_the_power_until_it_is_acknowledged_and_so_does_that)
{
    start_driving();
    fake_run_ms(1100 - RELAY_MS);
    uint8_t cause = COMMAND_TIMEOUT;
    CHECK(is_off_for(cause));
    for (int cuts = 0; cuts < 3; cuts++) {
        fake_cut_power(0);
        CHECK(last_is(cause, true, 4)); /* 0.43 s after the start */
        CHECK(safety_now()->state == IDLE && safety_now()->cause == NO_CAUSE);
    }
    CHECK(answers("S", " trip=2 trip_ds=4 trip_open=1*"));
    say("?");
    CHECK(answers("R", "K R"));
    CHECK(answers("S", " trip=2 trip_ds=4 trip_open=0*"));
    fake_run_ms(40);
    fake_cut_power(0);
    CHECK(last_is(cause, false, 4));
}

TEST(a_requested_stop_without_drive_is_no_trip_but_a_fault_is)
{
    fake_start(1);
    fake_receive((const uint8_t *)"!", 1);
    fake_run_ms(100);
    CHECK(is_off_for(STOP_BYTE_SEEN) && last_is(NO_CAUSE, false, 0));
    say("R");
    fake_set_current(0, 512 + 91);
    fake_run_ms(200);
    CHECK(last_is(OFF_CURRENT, true, 3));
    CHECK(answers("R", "N R 13") && last_is(OFF_CURRENT, true, 3));
}

TEST(a_hung_loop_and_a_restart_while_armed_are_kept_by_the_next_start)
{
    start_driving();
    fake_run_ms(100);
    fake_hang_ms(64); /* nothing can be stored */
    CHECK(is_off_for(LOOP_STALLED));
    fake_restart();
    CHECK(last_is(LOOP_STALLED, true, 3));
    fake_cut_power(0);
    CHECK(last_is(LOOP_STALLED, true, 3));
    say("R");
    arm();
    fake_run_ms(150);
    fake_restart();
    CHECK(last_is(RESTARTED, true, 3));
    fake_cut_power(0);
    CHECK(last_is(RESTARTED, true, 3));
    say("R");
    arm();
    say("D");
    fake_run_ms(50);
    fake_restart(); /* idle */
    CHECK(last_is(RESTARTED, false, 3));
}

/* Before the power fails: nothing, a trip of which everybody knows, an open one. After it: the trip
 * or acknowledgement that was being stored, what was before, or that something was lost. */
TEST(a_cut_at_any_byte_leaves_the_old_or_the_new_reason_or_reports_a_lost_one)
{
    const struct trip lost = {REASON_LOST, true, 0};
    unsigned kept = 0, old = 0, losses = 0;
    fake_start(1);
    for (unsigned cut = 0; cut < 3 * 9 * 256; cut++) {
        unsigned before = cut % 3, bytes = cut / 3 % 9, garbage = cut / 27;
        fake_fill_store(0xFF);
        found_after_cut(0);
        fake_run_ms(before ? 97 : 1); /* another time */
        if (before) {
            trip(SUPPLY_RANGE);
            store_bytes(99);
        }
        if (before == 1) {
            trips_acknowledge();
            store_bytes(99);
        }
        const struct trip was = trips_last();
        CHECK(was.cause == (before ? SUPPLY_RANGE : NO_CAUSE) && was.open == (before == 2));

        if (was.open)
            trips_acknowledge();
        else
            trip(UNEXPLAINED_CURRENT);
        const struct trip is = trips_last();
        if (store_bytes(bytes) < bytes)
            continue; /* some bytes are right already */
        const struct trip found = found_after_cut((uint8_t)garbage);
        CHECK(same(found, was) || same(found, is) || (same(found, lost) && !was.open));
        CHECK(!same(found, was) || was.open || !bytes); /* from the second byte on it is not missed */
        kept += same(found, is);
        old += same(found, was);
        losses += same(found, lost);

        store_bytes(99); /* whatever it is, it stays so */
        CHECK(same(found_after_cut(0), found));
    }
    CHECK(kept >= 3 && old > 1000 && losses > 2000);
}

/* Of all that there was since a cut, what was stored as a whole or came later may be found. */
TEST(no_sequence_of_power_cuts_makes_up_a_reason)
{
    static struct trip noted[1000];
    uint32_t draw = 1, cuts = 0, losses = 0;
    unsigned newest = 0, stored = 0;
    fake_start(1);
    noted[0] = trips_last();
    while (cuts < 20000) {
        draw = draw * 1664525u + 1013904223u;
        uint8_t what = draw >> 24;
        if (what < 10) {
            noted[++newest] = trip(COMMAND_TIMEOUT + (draw >> 8 & 0xFFFF) % 13);
        } else if (what < 20) {
            trips_acknowledge();
            noted[++newest] = trips_last();
        } else if (what < 25) {
            fake_run_ms(97);
        } else if (what < 35) {
            const struct trip found = found_after_cut((uint8_t)(draw >> 16));
            bool lost = found.cause == REASON_LOST && found.open && !found.at;
            while (!same(found, noted[newest]) && !lost) {
                CHECK(newest > stored);
                newest--;
            }
            losses += lost;
            cuts++;
            newest = stored = 0;
            noted[0] = found;
        } else {
            trips_follow();
            if (!fake_byte_is_under_way())
                stored = newest;
            fake_end_byte();
        }
        CHECK(newest < 999);
    }
    CHECK(losses > cuts / 20);
}

TEST(memory_of_another_program_is_no_reason)
{
    for (unsigned byte = 0; byte <= 0xFF; byte++) {
        fake_start(1);
        fake_fill_store((uint8_t)byte);
        fake_cut_power(0);
        CHECK(last_is(byte == 0xFF ? NO_CAUSE : REASON_LOST, byte != 0xFF, 0));
    }
}

TEST(records_are_counted_on_and_on)
{
    fake_start(1);
    for (unsigned number = 1; number < 1000; number++) {
        uint8_t cause = (uint8_t)(COMMAND_TIMEOUT + number % 13);
        trip(cause);
        store_bytes(99);
        CHECK(found_after_cut(0).cause == cause);
    }
}

int main(int count, char **arguments)
{
    for (struct test *test = tests; test; test = test->next) {
        if (count == 2 && !strcmp(arguments[1], "--list"))
            puts(test->name);
        else if (count == 1 || !strcmp(arguments[1], test->name))
            test->run();
    }
    return 0;
}
