/* One message at a time: begin, add, send; as text or binary, as the host requested last. */
#ifndef ANSWERS_H
#define ANSWERS_H

#include <stdbool.h>
#include <stdint.h>

#include "protocol.h"

extern struct message out; /* the one under construction */

void answer_in_binary(bool frames);
bool answers_are_binary(void);

void begin_message(char name);
void add(uint32_t value);                          /* a space and a decimal */
void add_text(const char *text);                   /* a PSTR */
void add_named(const char *name, uint32_t value);  /* a PSTR and a decimal */
bool send_message(void);                           /* false: no room, dropped whole */

void answer(char kind, char name, uint16_t value); /* all of a short one */

#endif
