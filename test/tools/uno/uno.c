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

enum { CHANNELS = 4, BOARDS = 2, QUEUE = 1 << 20 };
enum { SOUND, STUCK_ON, INVERTED };   /* a switch */
enum { FOLLOWS, WELDED, HELD_OPEN };  /* the relay's contact */
enum { SUPPLY_PIN = 4, BANDGAP = 7, INPUTS = 8 }; /* inputs of the converter; an Uno has no pin for 7 */

#define FREQUENCY 16000000.0
#define NOMINAL 5.0        /* V of the reference, at which sensors have their nominal gain */
#define BYTE_CYCLES 352    /* simavr's byte is 11 bits at 500 kbaud */
#define STARTED 160000     /* cycles; the start-up has interrupts off */
#define TRAP 0x7000        /* of the flash, beyond the program: a jump to itself */
#define CONVERTER_CLOCK 128 /* cycles */
#define SAMPLE_CYCLES (3 * CONVERTER_CLOCK / 2) /* from the start of a conversion */
#define CONVERSION_CYCLES (13 * CONVERTER_CLOCK)
#define FIRST_EXTRA 13 /* clocks that the first one takes longer, with the wait for one */
#define BANDGAP_MUX 14
#define RAM_FIRST 0x100
#define MCUSR 0x54
#define POWER_ON 1
#define UCSR0A 0xC0
#define OVERRUN 8
#define HELD_STEP 16 /* cycles at a time while the processor executes nothing */
#define EECR 0x3F
#define EEDR 0x40
#define EEARL 0x41
#define EEARH 0x42
enum { EERE = 1, EEPE = 2, EEMPE = 4 }; /* bits of EECR */
#define STORE_SIZE 1024
#define STORE_CYCLES 54400  /* 3.4 ms, to erase and write a byte */
#define ENABLED_CYCLES 4    /* in which EEPE must follow EEMPE */

/* What Python sets and reads between two runs; mirrored in emulated_uno.py. */
struct electrics {
    double supply;                /* V without load */
    double supply_resistance;     /* ohm */
    double supply_limit;          /* A, beyond which the supply's voltage collapses */
    double resistance[CHANNELS];  /* ohm, wire and switch */
    double volts_per_ampere[BOARDS];
    double clipping;              /* A, end of the current sensors' range */
    double offset[BOARDS];        /* V of a current sensor's output at 0 A from its middle */
    double filter_time;           /* s, low pass behind the current sensors */
    double range_voltage[2];      /* V */
    double noise;                 /* V, standard deviation at every analog pin */
    double divider;
    double divider_time;          /* s, low pass of the supply's divider */
    double reference;             /* V of the USB port, which the converter compares with */
    double bandgap;               /* V of the chip's own source */
    double relay_time;            /* s, in which the relay follows its pin */
    double bootloader_time;       /* s, in which a reset chip runs no program */
    int32_t switch_is[CHANNELS];
    int32_t relay_is;
    int32_t lost_bytes;           /* overruns of the receiver since the start */
    double on_time[CHANNELS];     /* s that each pin was high since the start */
    double wire_time[CHANNELS];   /* s that each wire was connected to the supply */
    double square_time[CHANNELS]; /* V^2 s over each wire since the start */
    double time;                  /* s of the emulated clock */
    double started;               /* when the program began, on that clock */
    double longest_blocked;       /* s, longest stretch with interrupts off after start-up */
};

struct queue {
    uint8_t bytes[QUEUE];
    uint32_t in, out;
};

/* simavr's EEPROM is written at once; the chip's takes its time, and what becomes of a byte on which
 * the power fails is nobody's choice. */
struct store {
    uint8_t bytes[STORE_SIZE];
    uint16_t place;
    uint8_t byte;
    avr_cycle_count_t done_at; /* 0: nothing is being written */
    avr_cycle_count_t enabled_until;
};

struct uno {
    struct electrics electrics;
    struct store store;
    avr_t *avr;
    avr_irq_t *uart, *adc, *pins[CHANNELS], *coil;
    struct queue to_device, from_device;
    uint8_t high[CHANNELS];    /* pins */
    uint8_t on[CHANNELS];      /* switches */
    uint8_t coil_is_on, contact_is_closed;
    uint8_t uart_is_full, in_bootloader;
    void *converter;         /* simavr's */
    int asked;               /* input of the running conversion */
    avr_cycle_count_t begun; /* when that did */
    uint32_t converted;      /* what it is going to give, in simavr's mV */
    double current[BOARDS];  /* A, now */
    double filtered[BOARDS]; /* A as the sensor gives it, behind the low pass */
    double sagging;          /* V, now */
    double divided;          /* V of the supply behind the divider's low pass */
    avr_cycle_count_t held_until; /* no instruction is executed before */
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

static int contact(const struct uno *uno)
{
    if (uno->electrics.relay_is == FOLLOWS)
        return uno->contact_is_closed;
    return uno->electrics.relay_is == WELDED;
}

static void switch_over(struct uno *uno)
{
    struct electrics *e = &uno->electrics;
    double conductance[BOARDS] = {0.0}, all = 0.0;
    for (int c = 0; c < CHANNELS; c++) {
        uno->on[c] = e->switch_is[c] == STUCK_ON || (e->switch_is[c] == INVERTED) != uno->high[c];
        conductance[c / 2] += contact(uno) * uno->on[c] / e->resistance[c];
    }
    for (int b = 0; b < BOARDS; b++)
        all += conductance[b];
    uno->sagging = e->supply / (1.0 + e->supply_resistance * all);
    if (all > 0.0)
        uno->sagging = fmin(uno->sagging, e->supply_limit / all);
    for (int b = 0; b < BOARDS; b++)
        uno->current[b] = uno->sagging * conductance[b];
}

static double passed(double elapsed, double time_constant)
{
    return time_constant > 0.0 ? -expm1(-elapsed / time_constant) : 1.0;
}

/* Carry all that flows on to the present cycle. */
static void settle(struct uno *uno)
{
    struct electrics *e = &uno->electrics;
    double elapsed = (uno->avr->cycle - uno->settled) / FREQUENCY;
    double share = passed(elapsed, e->filter_time);
    for (int b = 0; b < BOARDS; b++)
        uno->filtered[b] += share * (fmin(uno->current[b], e->clipping) - uno->filtered[b]);
    uno->divided += passed(elapsed, e->divider_time) * (uno->sagging - uno->divided);
    for (int c = 0; c < CHANNELS; c++) {
        double connected = contact(uno) * uno->on[c] * elapsed;
        e->on_time[c] += uno->high[c] * elapsed;
        e->wire_time[c] += connected;
        e->square_time[c] += connected * uno->sagging * uno->sagging;
    }
    uno->settled = uno->avr->cycle;
}

static uint64_t some_bits(struct uno *uno)
{
    uno->random ^= uno->random << 13;
    uno->random ^= uno->random >> 7;
    uno->random ^= uno->random << 17;
    return uno->random;
}

static double gaussian(struct uno *uno)
{
    double sum = -6.0;
    for (int i = 0; i < 12; i++)
        sum += (some_bits(uno) >> 11) * 0x1p-53;
    return sum;
}

static void on_pin(struct avr_irq_t *irq, uint32_t value, void *param)
{
    struct uno *uno = param;
    settle(uno);
    for (int c = 0; c < CHANNELS; c++) {
        /* Inverting fast PWM: 255 is constantly low on the chip, constantly high in simavr. */
        if (uno->pins[c] == irq)
            uno->high[c] = (value & 1) && uno->avr->data[outputs[c].compare] != 255;
    }
    switch_over(uno);
}

static avr_cycle_count_t on_contact(avr_t *avr, avr_cycle_count_t when, void *param)
{
    struct uno *uno = param;
    (void)avr;
    (void)when;
    settle(uno);
    uno->contact_is_closed = uno->coil_is_on;
    switch_over(uno);
    return 0;
}

static void set_coil(struct uno *uno, uint8_t on)
{
    uno->coil_is_on = on;
    avr_cycle_timer_cancel(uno->avr, on_contact, uno);
    avr_cycle_timer_register(
        uno->avr, 1 + (avr_cycle_count_t)(uno->electrics.relay_time * FREQUENCY), on_contact, uno);
}

static void on_coil(struct avr_irq_t *irq, uint32_t value, void *param)
{
    struct uno *uno = param;
    (void)irq;
    if ((value & 1) != uno->coil_is_on)
        set_coil(uno, value & 1);
}

/* The sensors are ratiometric: at 0 A half of the reference, a gain in proportion to it. */
static double pin_voltage(struct uno *uno, int pin)
{
    const struct electrics *e = &uno->electrics;
    if (pin < BOARDS)
        return e->reference * (0.5 + e->volts_per_ampere[pin] * uno->filtered[pin] / NOMINAL) +
               e->offset[pin];
    if (pin < BOARDS + 2)
        return e->range_voltage[pin - BOARDS];
    if (pin == SUPPLY_PIN)
        return uno->divided / e->divider;
    return pin == BANDGAP ? e->bandgap : 0.0;
}

/* simavr counts from an instruction, the chip's converter by its own clock. */
static void end_conversion_at(avr_t *avr, void *converter, avr_cycle_count_t end)
{
    avr_cycle_timer_slot_p timer = avr->cycle_timers.timer;
    while (timer && timer->param != converter)
        timer = timer->next;
    if (timer)
        avr_cycle_timer_register(avr, end - avr->cycle, timer->timer, converter);
}

static avr_cycle_count_t on_sample(avr_t *avr, avr_cycle_count_t when, void *param)
{
    struct uno *uno = param;
    (void)when;
    end_conversion_at(avr, uno->converter, uno->begun + CONVERSION_CYCLES);
    settle(uno);
    double volt = pin_voltage(uno, uno->asked) + uno->electrics.noise * gaussian(uno);
    double code = nearbyint(volt / uno->electrics.reference * 1024.0);
    code = fmin(fmax(code, 0.0), 1023.0);
    /* simavr takes whole millivolts and makes floor(1023 mV / 5000 mV) of them. */
    uno->converted = (uint32_t)ceil(code * 5000.0 / 1023.0);
    return 0;
}

/* In free running one conversion begins as another ends, whose result is then in the register:
 * simavr would convert when it is read, and the input that is chosen by then. */
static void on_conversion(struct avr_irq_t *irq, uint32_t value, void *param)
{
    struct uno *uno = param;
    avr_cycle_count_t now = uno->avr->cycle;
    union {
        avr_adc_mux_t mux;
        uint32_t v;
    } asked = {.v = value};
    int is_first = ((avr_adc_t *)uno->converter)->first;
    (void)irq;
    for (int input = 0; input < INPUTS; input++)
        avr_raise_irq(uno->adc + ADC_IRQ_ADC0 + input, uno->converted);
    if (asked.mux.kind != ADC_MUX_SINGLE)
        return;
    uno->asked = asked.mux.src;
    uno->begun = (now / CONVERTER_CLOCK + is_first * FIRST_EXTRA) * CONVERTER_CLOCK;
    avr_cycle_timer_cancel(uno->avr, on_sample, uno);
    avr_cycle_timer_register(uno->avr, uno->begun + SAMPLE_CYCLES - now, on_sample, uno);
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

/* The chip holds two bytes and receives a third; who keeps interrupts off for longer loses them. */
static int overrun(const struct uno *uno)
{
    return uno->avr->cycle - uno->blocked_since > 2 * BYTE_CYCLES;
}

static avr_cycle_count_t on_byte_time(avr_t *avr, avr_cycle_count_t when, void *param)
{
    struct uno *uno = param;
    struct queue *queue = &uno->to_device;
    if (queue->in == queue->out)
        return 0;
    if (overrun(uno)) {
        queue->out++;
        uno->electrics.lost_bytes++;
        avr->data[UCSR0A] |= OVERRUN;
    } else if (!uno->uart_is_full) {
        avr_raise_irq(uno->uart + UART_IRQ_INPUT, queue->bytes[queue->out++ % QUEUE]);
    }
    return when + BYTE_CYCLES;
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
    uno->coil = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), 4);
    avr_irq_register_notify(uno->coil, on_coil, uno);
}

/* simavr's own 1.1 V knows no noise: the bandgap becomes an input without a pin. */
static void connect_bandgap(struct uno *uno)
{
    avr_io_t *port = uno->avr->io_port;
    while (strcmp(port->kind, "adc"))
        port = port->next;
    uno->converter = port;
    ((avr_adc_t *)port)->muxmode[BANDGAP_MUX] =
        (avr_adc_mux_t){.kind = ADC_MUX_SINGLE, .src = BANDGAP};
}

static int store_is_busy(struct uno *uno)
{
    struct store *store = &uno->store;
    if (store->done_at && uno->avr->cycle >= store->done_at) {
        store->bytes[store->place] = store->byte;
        store->done_at = 0;
    }
    return store->done_at != 0;
}

static uint8_t on_store_read(avr_t *avr, avr_io_addr_t address, void *param)
{
    uint8_t idle = avr->data[address] & (uint8_t)~(EERE | EEPE);
    return store_is_busy(param) ? idle | EEPE : idle;
}

static void on_store_written(avr_t *avr, avr_io_addr_t address, uint8_t value, void *param)
{
    struct store *store = &((struct uno *)param)->store;
    uint16_t place = (uint16_t)(avr->data[EEARL] | avr->data[EEARH] << 8) % STORE_SIZE;
    int busy = store_is_busy(param), enabled = avr->cycle <= store->enabled_until;
    if ((value & EEPE) && enabled && !busy) {
        store->place = place;
        store->byte = avr->data[EEDR];
        store->done_at = avr->cycle + STORE_CYCLES;
        value &= (uint8_t)~EEMPE;
    }
    if ((value & EERE) && !busy)
        avr->data[EEDR] = store->bytes[place];
    store->enabled_until = value & EEMPE ? avr->cycle + ENABLED_CYCLES : 0;
    avr->data[address] = value & (uint8_t)~(EERE | EEPE);
}

/* In place of simavr's. */
static void connect_store(struct uno *uno)
{
    avr_io_addr_t at = AVR_DATA_TO_IO(EECR);
    memset(uno->store.bytes, 0xFF, STORE_SIZE);
    uno->avr->io[at].r.c = on_store_read;
    uno->avr->io[at].w.c = on_store_written;
    uno->avr->io[at].r.param = uno->avr->io[at].w.param = uno;
}

/* What memory holds after power-on is nobody's choice. */
static void forget_memory(struct uno *uno)
{
    for (int at = RAM_FIRST; at <= uno->avr->ramend; at++)
        uno->avr->data[at] = (uint8_t)(some_bits(uno) >> 32);
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
    forget_memory(uno);
    connect_bandgap(uno);
    connect_store(uno);
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
    if (uno->avr->sreg[S_I] || now < uno->electrics.started * FREQUENCY + STARTED)
        uno->blocked_since = now;
    else if (now - uno->blocked_since > uno->longest_blocked)
        uno->longest_blocked = now - uno->blocked_since;
}

static void let_pins_float(struct uno *uno)
{
    settle(uno);
    memset(uno->high, 0, sizeof uno->high);
    switch_over(uno);
    set_coil(uno, 0);
    uno->electrics.started = uno->avr->cycle / FREQUENCY;
}

/* A processor that executes nothing, though its timers, its converter and the world go on. */
static void hold(struct uno *uno, avr_cycle_count_t end)
{
    avr_t *avr = uno->avr;
    while (avr->cycle < end && avr->cycle < uno->held_until) {
        avr->cycle += HELD_STEP;
        avr_cycle_timer_process(avr);
    }
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
        if (uno->avr->cycle < uno->held_until) {
            hold(uno, end);
            continue;
        }
        int state = avr_run(uno->avr);
        if (state == cpu_Done || state == cpu_Crashed)
            return 0;
        if (!uno->avr->pc)
            let_pins_float(uno); /* the watchdog's reset */
        watch_interrupts(uno);
    }
    settle(uno);
    uno->electrics.time = uno->avr->cycle / FREQUENCY;
    uno->electrics.longest_blocked = uno->longest_blocked / FREQUENCY;
    return 1;
}

/* Of the bootloader, for somebody who uploads. */
static void begin_wait(struct uno *uno)
{
    double wait = uno->electrics.bootloader_time;
    uno->in_bootloader = 1;
    uno->held_until = uno->avr->cycle + (avr_cycle_count_t)llround(wait * FREQUENCY);
    uno->electrics.started = uno->held_until / FREQUENCY;
    uno->blocked_since = uno->held_until;
}

/* Reset for the reasons in `flags` (MCUSR's bits); pins float, and then the bootloader waits. */
void uno_reset(struct uno *uno, uint8_t flags)
{
    avr_t *avr = uno->avr;
    settle(uno);
    if (store_is_busy(uno) && flags & POWER_ON) {
        uno->store.bytes[uno->store.place] = (uint8_t)(some_bits(uno) >> 32);
        uno->store.done_at = 0;
    }
    avr_reset(avr);
    if (flags & POWER_ON)
        forget_memory(uno);
    avr->data[MCUSR] = flags;
    let_pins_float(uno);
    uno->uart_is_full = 0;
    uno->to_device.out = uno->to_device.in;
    begin_wait(uno);
}

/* Whether a byte of the EEPROM is under way. */
int uno_is_storing(struct uno *uno)
{
    return store_is_busy(uno);
}

/* A register changes by itself: an interrupt is lost, an output freezes. */
void uno_poke(struct uno *uno, uint16_t address, uint8_t value)
{
    uno->avr->data[address] = value;
}

void uno_write(struct uno *uno, const uint8_t *bytes, uint32_t length)
{
    if (uno->in_bootloader && uno->avr->cycle < uno->held_until) {
        begin_wait(uno); /* it reads what comes, and waits anew */
        return;
    }
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
