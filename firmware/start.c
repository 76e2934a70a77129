/* The start: its reset cause, the stop before it, memory; and the EEPROM. */
#include <avr/eeprom.h>
#include <avr/io.h>
#include <avr/wdt.h>

#include "hal.h"
#include "parts.h"
#include "trips.h"

#define PAINT 0xA5
#define MARK 0x5AFE

static uint8_t flags_at_reset OUTLASTS;
static uint16_t memory_hash OUTLASTS;
static struct {
    uint16_t mark;
    uint8_t cause;
} remembered OUTLASTS;
extern uint8_t _end;

static uint16_t starts;
static uint8_t before;

/* Before the C runtime: a watchdog stays on after its reset, and would fire again during start-up.
 * Optiboot clears MCUSR and hands its value over in r2. */
void first_of_all(void) __attribute__((naked, used, section(".init3")));
void first_of_all(void)
{
    uint8_t from_loader;
    uint16_t hash = 0;
    __asm__ volatile("mov %0, r2" : "=r"(from_loader));
    flags_at_reset = MCUSR ? MCUSR : from_loader;
    MCUSR = 0;
    wdt_disable();
    for (uint8_t *at = &_end; at <= (uint8_t *)RAMEND; at++) {
        hash = (uint16_t)((hash << 5 | hash >> 11) + *at);
        *at = PAINT;
    }
    memory_hash = hash;
}

/* Counts the starts in EEPROM, so that each has its own number. */
void start_init(void)
{
    static uint16_t *const counter = 0;
    bool outlasted = remembered.mark == MARK && !(flags_at_reset & _BV(PORF));
    before = outlasted ? remembered.cause : 0;
    remember_cause(0);
    trips_init(outlasted); /* first, as EEPROM cannot be read while a byte is written */
    starts = eeprom_read_word(counter) + 1;
    if (!(uint8_t)starts)
        eeprom_write_byte((uint8_t *)counter + 1, (uint8_t)(starts >> 8));
    eeprom_write_byte((uint8_t *)counter, (uint8_t)starts);
}

uint16_t start_entropy(void)
{
    return (uint16_t)(memory_hash ^ starts * 40503u);
}

void remember_cause(uint8_t cause)
{
    remembered.mark = MARK;
    remembered.cause = cause;
}

uint8_t cause_before(void)
{
    return before;
}

bool store_is_ready(void)
{
    return eeprom_is_ready();
}

uint8_t store_read(uint8_t place)
{
    return eeprom_read_byte((const uint8_t *)(uint16_t)place);
}

void store_write(uint8_t place, uint8_t byte)
{
    eeprom_write_byte((uint8_t *)(uint16_t)place, byte);
}

uint8_t reset_flags(void)
{
    return flags_at_reset & (_BV(PORF) | _BV(EXTRF) | _BV(BORF) | _BV(WDRF));
}

/* To within four bytes: checking every one would take half a millisecond. */
uint16_t stack_never_used(void)
{
    uint16_t free = 0;
    for (const uint8_t *at = &_end; at <= (uint8_t *)RAMEND && *at == PAINT; at += 4)
        free += 4;
    return free;
}
