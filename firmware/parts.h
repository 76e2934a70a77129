/* Start of the parts that own the hardware. */
#ifndef PARTS_H
#define PARTS_H

#include <stdint.h>

void start_init(void);
void pwm_init(void);
void outputs_follow(const uint16_t *duty); /* each PWM period */
/* Bit mask of boards that are on when a conversion takes its sample, which began `ago` counts of
 * 4 us ago; or UNSURE. */
uint8_t outputs_at_sample(uint8_t ago);
void serial_init(void);
void clock_init(void);
void sampling_init(void);
void sampling_tick(uint32_t time_us); /* from the clock's interrupt, each millisecond */
uint32_t clock_us_in_interrupt(void);
void loop_lives(void);

#endif
