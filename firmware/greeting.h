/* Who this is and what it allows: the lines of the handshake. */
#ifndef GREETING_H
#define GREETING_H

#include <stdbool.h>
#include <stdint.h>

void greeting_start(uint16_t arming_nonce, bool asked); /* a start tells no nonce */
void add_last_trip(void); /* to the message under construction */
void greet(void); /* in each turn of the loop: sends what is due and has room */

#endif
