/* The lines of the handshake: the device's identity and limits. */
#ifndef GREETING_H
#define GREETING_H

#include <stdbool.h>
#include <stdint.h>

void greeting_start(uint16_t arming_nonce, bool asked); /* contains the nonce only if asked for */
void add_last_trip(void); /* to the message under construction */
void greet(void); /* in each turn of the loop: sends the lines that are due and fit */

#endif
