#include "protocol.h"

#include "hal.h"

#define CHECKSUM_DIGITS 4

_Static_assert(LINE_MAX < 255 && MESSAGE_MAX <= 254, "lengths are bytes, one COBS block");
_Static_assert(FIELDS_MAX >= 2 + CHANNELS, "a voltage command has session, sequence, voltages");

/* CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF), a byte at a time without a table. */
uint16_t crc16(const uint8_t *bytes, uint8_t length)
{
    uint16_t crc = 0xFFFF;
    while (length--) {
        uint8_t x = (uint8_t)((crc >> 8) ^ *bytes++);
        x ^= x >> 4;
        crc = (uint16_t)((crc << 8) ^ ((uint16_t)x << 12) ^ ((uint16_t)x << 5) ^ x);
    }
    return crc;
}

/* --- lines from the host ---------------------------------------------------------------------- */

void line_clear(struct line *line)
{
    line->length = 0;
    line->overlong = false;
}

bool line_add(struct line *line, uint8_t byte)
{
    if (byte == '\n')
        return true;
    if (line->length < LINE_MAX)
        line->text[line->length++] = (char)byte;
    else
        line->overlong = true;
    return false;
}

/* Upper case only: a flipped bit must not turn one valid digit into the same one. */
static int8_t hex_digit(char c)
{
    if (c >= '0' && c <= '9')
        return (int8_t)(c - '0');
    if (c >= 'A' && c <= 'F')
        return (int8_t)(c - 'A' + 10);
    return -1;
}

static bool parse_hex(const char *text, uint16_t *value)
{
    *value = 0;
    for (uint8_t i = 0; i < CHECKSUM_DIGITS; i++) {
        int8_t digit = hex_digit(text[i]);
        if (digit < 0)
            return false;
        *value = (uint16_t)((*value << 4) | (uint8_t)digit);
    }
    return true;
}

/* A decimal of 0 to 65535 without leading zeros, from *at; *at ends behind it. */
static bool parse_field(const char *text, uint8_t length, uint8_t *at, uint16_t *value)
{
    uint8_t first = *at;
    uint32_t number = 0;
    while (*at < length && text[*at] >= '0' && text[*at] <= '9') {
        number = number * 10 + (uint8_t)(text[*at] - '0');
        if (number > UINT16_MAX)
            return false;
        ++*at;
    }
    *value = (uint16_t)number;
    return *at > first && (text[first] != '0' || *at == first + 1);
}

static bool parse_body(const char *text, uint8_t length, struct command *command)
{
    if (length == 0)
        return false;
    command->name = text[0];
    command->count = 0;
    uint8_t at = 1;
    while (at < length) {
        if (text[at++] != ' ' || command->count == FIELDS_MAX)
            return false;
        if (!parse_field(text, length, &at, &command->field[command->count]))
            return false;
        command->count++;
    }
    return true;
}

uint8_t parse_command(const struct line *line, struct command *command)
{
    uint8_t length = line->length;
    if (line->overlong)
        return TOO_LONG;
    if (length && line->text[length - 1] == '\r')
        length--;
    command->name = '-';
    command->sealed = length > CHECKSUM_DIGITS && line->text[length - CHECKSUM_DIGITS - 1] == '*';
    if (command->sealed) {
        uint16_t sent;
        if (!parse_hex(line->text + length - CHECKSUM_DIGITS, &sent))
            return BAD_CHECKSUM;
        length -= CHECKSUM_DIGITS + 1;
        if (sent != crc16((const uint8_t *)line->text, length))
            return BAD_CHECKSUM;
    }
    return parse_body(line->text, length, command) ? ACCEPTED : BAD_FORMAT;
}

/* --- messages to the host --------------------------------------------------------------------- */

void message_clear(struct message *message)
{
    message->length = 0;
    message->full = false;
}

void put_byte(struct message *message, uint8_t byte)
{
    if (message->length < MESSAGE_MAX)
        message->bytes[message->length++] = byte;
    else
        message->full = true;
}

void put_u16(struct message *message, uint16_t value)
{
    put_byte(message, (uint8_t)value);
    put_byte(message, (uint8_t)(value >> 8));
}

void put_u32(struct message *message, uint32_t value)
{
    put_u16(message, (uint16_t)value);
    put_u16(message, (uint16_t)(value >> 16));
}

/* Subtracting powers of ten: a 32 bit division costs an AVR 600 cycles for each digit. */
void put_decimal(struct message *message, uint32_t value)
{
    static const uint32_t powers[] PROGMEM = {1000000000, 100000000, 10000000, 1000000, 100000,
                                              10000,      1000,      100,      10};
    bool started = false;
    for (uint8_t i = 0; i < sizeof powers / sizeof *powers; i++) {
        uint8_t digit = '0';
        uint32_t power = pgm_read_dword(&powers[i]);
        for (; value >= power; value -= power)
            digit++;
        started = started || digit != '0';
        if (started)
            put_byte(message, digit);
    }
    put_byte(message, (uint8_t)('0' + value));
}

void put_signed(struct message *message, int16_t value)
{
    if (value < 0)
        put_byte(message, '-');
    put_decimal(message, value < 0 ? (uint32_t)(-(int32_t)value) : (uint32_t)value);
}

bool seal_text(struct message *message)
{
    uint16_t crc = crc16(message->bytes, message->length);
    put_byte(message, '*');
    for (int8_t shift = 12; shift >= 0; shift -= 4) {
        uint8_t digit = (crc >> shift) & 0xF;
        put_byte(message, (uint8_t)(digit < 10 ? '0' + digit : 'A' + digit - 10));
    }
    put_byte(message, '\n');
    return !message->full;
}

/* Consistent overhead byte stuffing of a body below 254 bytes: every zero becomes the distance to
 * the next one, so that zero is free to end the frame. */
bool seal_binary(struct message *message)
{
    put_u16(message, crc16(message->bytes, message->length));
    put_byte(message, 0);
    put_byte(message, 0);
    if (message->full)
        return false;
    uint8_t distance = 1;
    for (uint8_t i = message->length - 2; i > 0; i--) {
        uint8_t byte = message->bytes[i - 1];
        message->bytes[i] = byte ? byte : distance;
        distance = byte ? (uint8_t)(distance + 1) : 1;
    }
    message->bytes[0] = distance;
    return true;
}

uint16_t duty_of(uint16_t millivolts, uint16_t supply_mv)
{
    if (!millivolts)
        return 0; /* without a division: most channels of most commands */
    if (millivolts >= supply_mv)
        return UINT16_MAX;
    uint32_t ratio = ((uint32_t)millivolts << 16) / supply_mv;
    return (uint16_t)((ratio * ratio + 0x8000) >> 16);
}
