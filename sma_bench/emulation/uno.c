/* An Uno for Python: simavr's ATmega328P with the bench's electrics at its pins. Built where it is
 * used; simavr is GPL-3, and nothing of it is shipped. */
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <avr_adc.h>
#include <avr_extint.h>
#include <avr_ioport.h>
#include <avr_uart.h>
#include <sim_avr.h>
#include <sim_elf.h>
#include <sim_cycle_timers.h>
#include <sim_interrupts.h>

enum { CHANNELS = 4, BOARDS = 2, INPUTS = 6, QUEUE = 1 << 20 };

#define FREQUENCY 16000000.0
#define REFERENCE 5.0   /* V */
#define BYTE_CYCLES 352 /* simavr's byte is 11 bits at 500 kbaud */
#define STARTED 160000  /* cycles; the start-up has interrupts off */
#define TRAP 0x7000     /* of the flash, beyond the program: a jump to itself */

/* What Python sets and reads between two runs; mirrored in emulated_uno.py. */
struct electrics {
    double supply;                /* V without load */
    double supply_resistance;     /* ohm */
    double resistance[CHANNELS];  /* ohm, wire and switch */
    double volts_per_ampere[BOARDS];
    double filter_time;           /* s, low pass behind the current sensors */
    double range_voltage[2];      /* V */
    double noise;                 /* V, standard deviation at every analog pin */
    double divider;
    double on_time[CHANNELS];     /* s since the start */
    double square_time[CHANNELS]; /* V^2 s over each wire since the start */
    double time;                  /* s of the emulated clock */
    double longest_blocked;       /* s, longest stretch with interrupts off after start-up */
};

struct queue {
    uint8_t bytes[QUEUE];
    uint32_t in, out;
};

struct uno {
    struct electrics electrics;
    avr_t *avr;
    avr_irq_t *uart, *adc, *pins[CHANNELS];
    struct queue to_device, from_device;
    uint8_t on[CHANNELS];
    uint8_t uart_is_full;
    double current[BOARDS];  /* A, now */
    double filtered[BOARDS]; /* A, behind the low pass */
    double sagging;          /* V, now */
    avr_cycle_count_t settled;
    avr_cycle_count_t due; /* how far it was told to run; sleep steps beyond it */
    avr_cycle_count_t blocked_since, longest_blocked;
    uint64_t random;
};

static const struct {
    char port;
    int pin;
    uint8_t compare; /* address of the pin's compare register */
} outputs[CHANNELS] = {{'D', 6, 0x47}, {'D', 5, 0x48}, {'B', 3, 0xB3}, {'D', 3, 0xB4}};

/* --- electrics -------------------------------------------------------------------------------- */

static void switch_over(struct uno *uno)
{
    struct electrics *e = &uno->electrics;
    double conductance = 0.0;
    for (int c = 0; c < CHANNELS; c++)
        conductance += uno->on[c] / e->resistance[c];
    uno->sagging = e->supply / (1.0 + e->supply_resistance * conductance);
    for (int b = 0; b < BOARDS; b++)
        uno->current[b] = uno->sagging * (uno->on[2 * b] / e->resistance[2 * b] +
                                          uno->on[2 * b + 1] / e->resistance[2 * b + 1]);
}

/* Carry all that flows on to the present cycle. */
static void settle(struct uno *uno)
{
    struct electrics *e = &uno->electrics;
    double elapsed = (uno->avr->cycle - uno->settled) / FREQUENCY;
    double share = e->filter_time > 0.0 ? -expm1(-elapsed / e->filter_time) : 1.0;
    for (int b = 0; b < BOARDS; b++)
        uno->filtered[b] += share * (uno->current[b] - uno->filtered[b]);
    for (int c = 0; c < CHANNELS; c++) {
        e->on_time[c] += uno->on[c] * elapsed;
        e->square_time[c] += uno->on[c] * uno->sagging * uno->sagging * elapsed;
    }
    uno->settled = uno->avr->cycle;
}

static double gaussian(struct uno *uno)
{
    double sum = -6.0;
    for (int i = 0; i < 12; i++) {
        uno->random ^= uno->random << 13;
        uno->random ^= uno->random >> 7;
        uno->random ^= uno->random << 17;
        sum += (uno->random >> 11) * 0x1p-53;
    }
    return sum;
}

static void on_pin(struct avr_irq_t *irq, uint32_t value, void *param)
{
    struct uno *uno = param;
    settle(uno);
    for (int c = 0; c < CHANNELS; c++) {
        /* Inverting fast PWM: 255 is constantly low on the chip, constantly high in simavr. */
        if (uno->pins[c] == irq)
            uno->on[c] = (value & 1) && uno->avr->data[outputs[c].compare] != 255;
    }
    switch_over(uno);
}

static double pin_voltage(struct uno *uno, int pin)
{
    const struct electrics *e = &uno->electrics;
    if (pin < BOARDS)
        return REFERENCE / 2.0 + e->volts_per_ampere[pin] * uno->filtered[pin];
    if (pin < BOARDS + 2)
        return e->range_voltage[pin - BOARDS];
    return pin == 4 ? uno->sagging / e->divider : 0.0;
}

static void on_conversion(struct avr_irq_t *irq, uint32_t value, void *param)
{
    struct uno *uno = param;
    union {
        avr_adc_mux_t mux;
        uint32_t v;
    } asked = {.v = value};
    int pin = asked.mux.src;
    (void)irq;
    if (asked.mux.kind != ADC_MUX_SINGLE || pin >= INPUTS)
        return;
    settle(uno);
    double volt = pin_voltage(uno, pin) + uno->electrics.noise * gaussian(uno);
    double code = fmin(fmax(nearbyint(volt / REFERENCE * 1024.0), 0.0), 1023.0);
    /* simavr takes whole millivolts and makes floor(1023 mV / reference) of them. */
    avr_raise_irq(uno->adc + ADC_IRQ_ADC0 + pin, (uint32_t)ceil(code * 1e3 * REFERENCE / 1023.0));
}

/* --- serial ----------------------------------------------------------------------------------- */

static void on_byte_out(struct avr_irq_t *irq, uint32_t value, void *param)
{
    struct queue *queue = &((struct uno *)param)->from_device;
    (void)irq;
    if (queue->in - queue->out < QUEUE)
        queue->bytes[queue->in++ % QUEUE] = (uint8_t)value;
}

/* simavr buffers more than the chip, but not without end. */
static void on_flow_control(struct avr_irq_t *irq, uint32_t value, void *param)
{
    struct uno *uno = param;
    if (value)
        uno->uart_is_full = irq == uno->uart + UART_IRQ_OUT_XOFF;
}

static avr_cycle_count_t on_byte_time(avr_t *avr, avr_cycle_count_t when, void *param)
{
    struct uno *uno = param;
    struct queue *queue = &uno->to_device;
    (void)avr;
    if (queue->in != queue->out && !uno->uart_is_full)
        avr_raise_irq(uno->uart + UART_IRQ_INPUT, queue->bytes[queue->out++ % QUEUE]);
    return queue->in != queue->out ? when + BYTE_CYCLES : 0;
}

/* --- what Python calls ------------------------------------------------------------------------ */

static void no_sleep(avr_t *avr, avr_cycle_count_t cycles)
{
    (void)avr;
    (void)cycles;
}

static void say_nothing(avr_t *avr, const int level, const char *format, va_list arguments)
{
    (void)avr;
    (void)level;
    (void)format;
    (void)arguments;
}

static void wire_up(struct uno *uno)
{
    avr_t *avr = uno->avr;
    uint32_t flags = 0;
    uno->uart = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), 0);
    uno->adc = avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, 0);
    avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
    flags &= ~(uint32_t)(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POLL_SLEEP);
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_register_notify(uno->uart + UART_IRQ_OUTPUT, on_byte_out, uno);
    avr_irq_register_notify(uno->uart + UART_IRQ_OUT_XON, on_flow_control, uno);
    avr_irq_register_notify(uno->uart + UART_IRQ_OUT_XOFF, on_flow_control, uno);
    avr_irq_register_notify(uno->adc + ADC_IRQ_OUT_TRIGGER, on_conversion, uno);
    for (int c = 0; c < CHANNELS; c++) {
        uno->pins[c] =
            avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(outputs[c].port), outputs[c].pin);
        avr_irq_register_notify(uno->pins[c], on_pin, uno);
    }
}

struct uno *uno_new(const char *elf_path, uint64_t seed)
{
    static elf_firmware_t elf; /* too large for a small stack */
    struct uno *uno = calloc(1, sizeof *uno);
    avr_global_logger_set(say_nothing); /* what fails shows in what is returned */
    if (!uno || elf_read_firmware(elf_path, &elf) || !(uno->avr = avr_make_mcu_by_name("atmega328p")))
        return NULL;
    avr_init(uno->avr);
    elf.frequency = (uint32_t)FREQUENCY;
    avr_load_firmware(uno->avr, &elf);
    uno->avr->log = 0;
    uno->avr->vcc = uno->avr->avcc = uno->avr->aref = 5000;
    uno->avr->sleep = no_sleep;
    /* simavr would poll two pins every cycle for interrupts that the firmware never enables. */
    avr_extint_set_strict_lvl_trig(uno->avr, EXTINT_IRQ_OUT_INT0, 0);
    avr_extint_set_strict_lvl_trig(uno->avr, EXTINT_IRQ_OUT_INT1, 0);
    uno->random = seed * 0x9E3779B97F4A7C15u + 1;
    for (int c = 0; c < CHANNELS; c++)
        uno->electrics.resistance[c] = 2.7;
    wire_up(uno);
    return uno;
}

struct electrics *uno_electrics(struct uno *uno)
{
    return &uno->electrics;
}

static void watch_interrupts(struct uno *uno)
{
    avr_cycle_count_t now = uno->avr->cycle;
    if (uno->avr->sreg[S_I] || now < STARTED)
        uno->blocked_since = now;
    else if (now - uno->blocked_since > uno->longest_blocked)
        uno->longest_blocked = now - uno->blocked_since;
}

/* Run until `seconds` later than told before; false when the processor gave up. */
int uno_run(struct uno *uno, double seconds)
{
    avr_cycle_count_t end = uno->due += (avr_cycle_count_t)llround(seconds * FREQUENCY);
    settle(uno);
    switch_over(uno);
    if (uno->to_device.in != uno->to_device.out &&
        !avr_cycle_timer_status(uno->avr, on_byte_time, uno))
        avr_cycle_timer_register(uno->avr, BYTE_CYCLES, on_byte_time, uno);
    while (uno->avr->cycle < end) {
        int state = avr_run(uno->avr);
        if (state == cpu_Done || state == cpu_Crashed)
            return 0;
        watch_interrupts(uno);
    }
    settle(uno);
    uno->electrics.time = uno->avr->cycle / FREQUENCY;
    uno->electrics.longest_blocked = uno->longest_blocked / FREQUENCY;
    return 1;
}

void uno_write(struct uno *uno, const uint8_t *bytes, uint32_t length)
{
    for (uint32_t i = 0; i < length; i++)
        uno->to_device.bytes[uno->to_device.in++ % QUEUE] = bytes[i];
}

uint32_t uno_read(struct uno *uno, uint8_t *bytes, uint32_t size)
{
    uint32_t length = 0;
    while (length < size && uno->from_device.out != uno->from_device.in)
        bytes[length++] = uno->from_device.bytes[uno->from_device.out++ % QUEUE];
    return length;
}

uint8_t uno_outputs(const struct uno *uno)
{
    uint8_t bits = 0;
    for (int c = 0; c < CHANNELS; c++)
        bits |= (uint8_t)(uno->on[c] << c);
    return bits;
}

/* The main loop jumps to nowhere, with interrupts on or off. */
void uno_hang(struct uno *uno, int interrupts)
{
    while (!uno->avr->sreg[S_I])
        avr_run(uno->avr);
    uno->avr->flash[TRAP] = 0xFF; /* rjmp .-2 */
    uno->avr->flash[TRAP + 1] = 0xCF;
    uno->avr->state = cpu_Running; /* it may have slept */
    uno->avr->pc = TRAP;
    uno->avr->sreg[S_I] = interrupts ? 1 : 0;
}
