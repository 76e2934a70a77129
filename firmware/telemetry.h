/* Readings of a window, in the units of docs/serial_protocol.md. */
#ifndef TELEMETRY_H
#define TELEMETRY_H

#include <stdbool.h>
#include <stdint.h>

bool report(uint16_t sequence); /* false when no window was complete */

#endif
