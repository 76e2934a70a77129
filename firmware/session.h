/* The conversation with the host: commands in, telemetry out. Runs in the main loop. */
#ifndef SESSION_H
#define SESSION_H

#include <stdbool.h>

void session_init(void);
bool session_run(void); /* one turn of the loop, never waits; false if there was nothing to do */

#endif
