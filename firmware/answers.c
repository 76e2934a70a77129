#include "answers.h"

#include "hal.h"

struct message out;
static bool binary;

void answer_in_binary(bool frames)
{
    binary = frames;
}

bool answers_are_binary(void)
{
    return binary;
}

bool send_message(void)
{
    return (binary ? seal_binary(&out) : seal_text(&out)) && serial_send(out.bytes, out.length);
}

void begin_message(char name)
{
    message_clear(&out);
    put_byte(&out, (uint8_t)name);
}

void add(uint32_t value)
{
    put_byte(&out, ' ');
    put_decimal(&out, value);
}

void add_text(const char *text)
{
    for (uint8_t c; (c = pgm_read_byte(text)); text++)
        put_byte(&out, c);
}

void add_named(const char *name, uint32_t value)
{
    add_text(name);
    put_decimal(&out, value);
}

void answer(char kind, char name, uint16_t value)
{
    begin_message(kind);
    put_byte(&out, ' ');
    put_byte(&out, (uint8_t)name);
    add(value);
    send_message();
}
