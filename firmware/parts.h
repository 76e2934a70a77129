/* Start of the parts that own the hardware. */
#ifndef PARTS_H
#define PARTS_H

#include <stdint.h>

void pwm_init(void);
void serial_init(void);
void clock_init(void);
void sampling_init(void);
void sampling_tick(uint32_t time_us); /* from the clock's interrupt, each millisecond */
uint32_t clock_us_in_interrupt(void);
void loop_lives(void);

#endif
