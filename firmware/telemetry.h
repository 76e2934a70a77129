/* Readings of a window, in the units of docs/serial_protocol.md. */
#ifndef TELEMETRY_H
#define TELEMETRY_H

#include <stdbool.h>
#include <stdint.h>

bool report(uint16_t sequence); /* sends a window; false if none was complete */

/* mV of the supply from 1/64 steps of the converter at a reference in 0.1 mV. */
uint16_t supply_mv(uint16_t q6, uint16_t reference);

#endif
