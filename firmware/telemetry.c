#include "telemetry.h"

#include "answers.h"
#include "hal.h"
#include "safety.h"

/* Mean reading in 1/64 of the converter's step; 0 when there was none. */
static uint16_t mean_q6(const struct frame *frame, uint8_t input)
{
    uint16_t count = frame->count[input];
    return count ? (uint16_t)(((frame->sum[input] << 6) + count / 2) / count) : 0;
}

uint16_t supply_mv(uint16_t q6, uint16_t reference)
{
    uint16_t at_pin = (uint16_t)(((uint32_t)q6 * reference) >> 16); /* 0.1 mV */
    return (uint16_t)((at_pin * (SUPPLY_DIVIDER * 6554UL)) >> 16); /* a division takes 40 us */
}

static int16_t milliamperes(uint16_t q6, uint16_t mv_per_a)
{
    int32_t from_zero = (int32_t)q6 - (int32_t)(ADC_MIDDLE << 6);
    return (int16_t)((from_zero * ((int32_t)REFERENCE_MV * 500 / mv_per_a) + (1 << 14)) >> 15);
}

/* 0.1 mV at a pin. */
static uint16_t tenths_of_mv(uint16_t q6, uint16_t reference)
{
    return (uint16_t)(((uint32_t)q6 * reference) >> 16);
}

struct telemetry {
    uint16_t supply_mv;
    uint16_t drop_mv[BOARDS];
    int16_t current_ma[BOARDS];
    uint16_t range[2];
    uint16_t duty[CHANNELS];
};

/* The set duty (16 bit) if the output fits it; otherwise as read back (8 bit). */
static uint16_t applied(uint8_t channel, uint16_t set)
{
    return outputs_make(channel, set) ? set : (uint16_t)(outputs_register(channel) << 8);
}

static void convert(const struct frame *frame, const struct safety *safety,
                    struct telemetry *telemetry)
{
    uint16_t reference = sampling_reference();
    telemetry->supply_mv = supply_mv(sampling_supply_of_window(), reference);
    for (uint8_t board = 0; board < BOARDS; board++)
        telemetry->drop_mv[board] = supply_mv(sampling_drop(board), reference);
    for (uint8_t channel = 0; channel < CHANNELS; channel++)
        telemetry->duty[channel] = applied(channel, safety->duty[channel]);
    telemetry->current_ma[0] = milliamperes(mean_q6(frame, FRONT_CURRENT), FRONT_MV_PER_A);
    telemetry->current_ma[1] = milliamperes(mean_q6(frame, BACK_CURRENT), BACK_MV_PER_A);
    telemetry->range[0] = tenths_of_mv(mean_q6(frame, FRONT_RANGE), reference);
    telemetry->range[1] = tenths_of_mv(mean_q6(frame, BACK_RANGE), reference);
}

static void write_text(const struct frame *frame, const struct telemetry *telemetry,
                       const struct safety *safety, uint16_t sequence)
{
    begin_message('T');
    add(frame->sequence);
    add(frame->time_us);
    add(safety->flows ? STILL_FLOWING : safety->state);
    add(safety->cause);
    add(telemetry->supply_mv);
    add(telemetry->drop_mv[0]);
    add(telemetry->drop_mv[1]);
    for (uint8_t board = 0; board < BOARDS; board++) {
        put_byte(&out, ' ');
        put_signed(&out, telemetry->current_ma[board]);
    }
    add(telemetry->range[0]);
    add(telemetry->range[1]);
    for (uint8_t channel = 0; channel < CHANNELS; channel++)
        add(telemetry->duty[channel]);
    add(sequence);
}

static void write_binary(const struct frame *frame, const struct telemetry *telemetry,
                         const struct safety *safety, uint16_t sequence)
{
    begin_message('B');
    put_u16(&out, frame->sequence);
    put_u32(&out, frame->time_us);
    put_byte(&out, safety->flows ? STILL_FLOWING : safety->state);
    put_byte(&out, safety->cause);
    put_u16(&out, telemetry->supply_mv);
    put_u16(&out, telemetry->drop_mv[0]);
    put_u16(&out, telemetry->drop_mv[1]);
    for (uint8_t board = 0; board < BOARDS; board++)
        put_u16(&out, (uint16_t)telemetry->current_ma[board]);
    put_u16(&out, telemetry->range[0]);
    put_u16(&out, telemetry->range[1]);
    for (uint8_t channel = 0; channel < CHANNELS; channel++)
        put_u16(&out, telemetry->duty[channel]);
    put_u16(&out, sequence);
}

bool report(uint16_t sequence)
{
    struct telemetry telemetry;
    struct safety safety;
    const struct frame *taken = sampling_take();
    if (!taken)
        return false;
    /* Release the buffer first: at 500 Hz the next window may end during the conversion. */
    const struct frame frame = *taken;
    sampling_release();
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        safety = *safety_now();
    }
    convert(&frame, &safety, &telemetry);
    if (answers_are_binary())
        write_binary(&frame, &telemetry, &safety, sequence);
    else
        write_text(&frame, &telemetry, &safety, sequence);
    send_message();
    return true;
}
