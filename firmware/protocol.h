/* The protocol of docs/serial_protocol.md. Independent of the hardware: also compiled on the host. */
#ifndef PROTOCOL_H
#define PROTOCOL_H

#include <stdbool.h>
#include <stdint.h>

#include "config.h"

#define STOP_BYTE '!'
#define LINE_MAX 63    /* characters of a host's line, without the line end */
#define FIELDS_MAX 6   /* of a host's line */
#define MESSAGE_MAX 140 /* bytes of a sealed message, its delimiter included */

#define SEAL_TEXT 6    /* bytes: a star, four digits, the line end */

enum reason {
    ACCEPTED = 0,
    BAD_CHECKSUM = 1,
    BAD_FORMAT = 2,
    TOO_LONG = 3,
    NOT_ARMED = 4,
    WRONG_SESSION = 5,
    OLD_SEQUENCE = 6,
    OVER_VOLTAGE = 7,
    OVER_DUTY = 8,
    NO_SUPPLY = 9,
    BAD_RATE = 10,
    IS_STOPPED = 11,
    IS_ARMED = 12,
    CURRENT_FLOWS = 13,
    BEYOND_LIMITS = 14,
};

struct command {
    char name;
    bool sealed; /* it had a checksum */
    uint8_t count;
    uint16_t field[FIELDS_MAX];
};

struct line {
    uint8_t length;
    bool overlong;
    char text[LINE_MAX];
};

/* A message under construction; `full` once something did not fit. */
struct message {
    uint8_t length;
    bool full;
    uint8_t bytes[MESSAGE_MAX];
};

uint16_t crc16(const uint8_t *bytes, uint8_t length);

/* True when `byte` ended the line; the caller clears it with line_clear. */
bool line_add(struct line *line, uint8_t byte);
void line_clear(struct line *line);
uint8_t parse_command(const struct line *line, struct command *command);

void message_clear(struct message *message);
void put_byte(struct message *message, uint8_t byte);
void put_u16(struct message *message, uint16_t value);
void put_u32(struct message *message, uint32_t value);
void put_decimal(struct message *message, uint32_t value);
void put_signed(struct message *message, int16_t value);

/* Turn the body into a line or a frame, ready to send. False when it does not fit. */
bool seal_text(struct message *message);
bool seal_binary(struct message *message);

/* Duty (1/65536) with the same heat as `millivolts` of direct voltage: (V / supply) squared. */
uint16_t duty_of(uint16_t millivolts, uint16_t supply_mv);

#endif
