/* Replaces the chip, to run the firmware's C files on a computer. */
#ifndef FAKE_HARDWARE_H
#define FAKE_HARDWARE_H

#include <stdbool.h>
#include <stdint.h>

#include "config.h"

void fake_start(uint16_t entropy); /* the first start: nothing is stored */
void fake_restart(void);           /* by a reset: memory stays as it is */
void fake_cut_power(uint8_t garbage); /* the power returns at once */
bool fake_byte_is_under_way(void);    /* a byte is being written to the store */
void fake_end_byte(void);
void fake_lose_byte(uint8_t garbage);
void fake_fill_store(uint8_t byte);
void fake_receive(const uint8_t *bytes, uint32_t length); /* as the serial interrupt would */
void fake_run_ms(uint32_t milliseconds);
void fake_hang_ms(uint32_t milliseconds); /* interrupts run, the main loop does not */
void fake_lose_pwm_interrupt(void);
void fake_set_output(uint8_t channel, uint16_t duty); /* a register changes by itself */
uint32_t fake_take_sent(uint8_t *bytes, uint32_t size);
void fake_forget_sent(void);

void fake_set_supply(uint16_t reading);
void fake_set_loaded_supply(uint16_t reading); /* the supply during a pulse */
void fake_set_drop(uint8_t board, uint16_t sixty_fourths);
void fake_set_current(uint8_t board, uint16_t reading);
void fake_set_converter(bool runs);
extern void (*fake_before_conversion)(void); /* may set the reading; NULL: none */

uint16_t fake_output(uint8_t channel); /* duty in 1/65536 at the pin */
bool fake_any_output(void);
bool fake_relay(void); /* closed */
uint8_t fake_remembered_cause(void);
uint32_t fake_time_us(void);
uint16_t fake_nonce(void); /* the newest one in the sent messages */

#endif
