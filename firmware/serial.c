/* The serial port. The stop byte, anywhere in the stream, stops the bench in the interrupt. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "hal.h"
#include "parts.h"
#include "protocol.h"
#include "safety.h"

#define RECEIVE_SIZE 256 /* what a host sends in 0.2 s */
#define SEND_SIZE 256
#define LINES 32 /* a power of two */
#define DIVIDER (F_CPU / (8 * BAUD_RATE) - 1)

_Static_assert(F_CPU % (8 * BAUD_RATE) == 0, "the baud rate is not exact");
_Static_assert(RECEIVE_SIZE == 256 && SEND_SIZE == 256, "indexes wrap as bytes");

static volatile uint8_t received[RECEIVE_SIZE];
static volatile uint8_t receive_in, receive_out;
static uint8_t sending[SEND_SIZE];
static volatile uint8_t send_in, send_out;
static uint32_t line_times[LINES]; /* arrival of the line ends in `received` */
static volatile uint8_t lines_in, lines_out;
static uint32_t line_time;
static struct serial_counts counts;

void serial_init(void)
{
    UCSR0A = _BV(U2X0); /* first: the emulator reads it when UBRR0 is written */
    UBRR0 = DIVIDER;
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

static void note_line_end(void)
{
    line_times[lines_in % LINES] = clock_us_in_interrupt();
    lines_in++;
}

ISR(USART_RX_vect)
{
    uint8_t overrun = UCSR0A & _BV(DOR0);
    uint8_t byte = UDR0;
    if (byte == STOP_BYTE) {
        safety_stop(STOP_BYTE_SEEN);
        return;
    }
    if (overrun)
        counts.overruns++;
    if ((uint8_t)(receive_in - receive_out) == RECEIVE_SIZE - 1) {
        counts.overruns++;
        return;
    }
    received[receive_in++] = byte;
    if (byte == '\n')
        note_line_end();
}

ISR(USART_UDRE_vect)
{
    if (send_in == send_out)
        UCSR0B &= (uint8_t)~_BV(UDRIE0);
    else
        UDR0 = sending[send_out++];
}

bool serial_take(uint8_t *byte)
{
    if (receive_in == receive_out)
        return false;
    *byte = received[receive_out];
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        receive_out++;
        if (*byte == '\n')
            line_time = line_times[lines_out++ % LINES];
    }
    return true;
}

uint32_t serial_line_time(void)
{
    return line_time;
}

uint8_t serial_queued(void)
{
    return (uint8_t)(send_in - send_out);
}

uint8_t serial_room(void)
{
    return (uint8_t)(SEND_SIZE - 1 - serial_queued());
}

bool serial_send(const uint8_t *bytes, uint8_t length)
{
    if (length > serial_room()) {
        counts.dropped++;
        return false;
    }
    for (uint8_t i = 0, at = send_in; i < length; i++)
        sending[at++] = bytes[i];
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        send_in += length;
        UCSR0B |= _BV(UDRIE0);
    }
    return true;
}

struct serial_counts serial_counts(void)
{
    struct serial_counts copy;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        copy = counts;
    }
    return copy;
}
