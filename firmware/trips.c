#include "trips.h"

#include <stddef.h>

#include "hal.h"
#include "protocol.h"
#include "safety.h"

#define ACKNOWLEDGED 0x80 /* a bit of a record's cause */
#define PLACE(slot) ((uint8_t)(16 + 16 * (slot))) /* a failing supply damages the first bytes most */
#define SLOTS 2
#define BLANK 0xFF
#define DONE (sizeof(struct record) + 1)
#define TENTH_US 100000

/* Its count is written first, as 0, and last again: a record that is half written is not valid. */
struct record {
    uint32_t at;
    uint8_t cause;
    uint8_t count; /* 1 to 255, and again; the newest record's is one more than the other's */
    uint16_t crc;  /* of all before it */
};

#define COUNT offsetof(struct record, count)

_Static_assert(sizeof(struct record) == 8 && offsetof(struct record, crc) == 6, "it has no gaps");
_Static_assert(REASON_LOST < ACKNOWLEDGED, "a cause and a bit do not fit a byte");

/* These survive a reset. `alive.at` is the last time at which the loop ran; `inverse` is its inverse
 * if the device was armed then. */
static struct record last OUTLASTS;
static struct {
    uint32_t at, inverse;
} alive OUTLASTS;

static uint32_t tenth_us; /* when the present tenth of a second began */
static bool is_seen;   /* the present stop has been noted */
static uint8_t step;   /* in writing `last` */
static uint8_t newest; /* slot of the newest valid record; then its count */
static uint8_t count;

static uint16_t check(const struct record *record)
{
    return crc16((const uint8_t *)record, offsetof(struct record, crc));
}

static bool is_open(const struct record *record)
{
    return record->cause && !(record->cause & ACKNOWLEDGED);
}

static bool was_armed(void)
{
    return alive.inverse == ~alive.at;
}

static uint8_t after(uint8_t number)
{
    return number == UINT8_MAX ? 1 : (uint8_t)(number + 1);
}

static void note(uint8_t cause, uint32_t at)
{
    last = (struct record){.at = at, .cause = cause, .count = after(count)};
    last.crc = check(&last);
    step = 0;
}

/* False if nothing was ever written there. */
static bool read_slot(uint8_t slot, struct record *record)
{
    bool used = false;
    for (uint8_t i = 0; i < sizeof *record; i++) {
        uint8_t byte = store_read(PLACE(slot) + i);
        ((uint8_t *)record)[i] = byte;
        used = used || byte != BLANK;
    }
    return used;
}

/* If the valid record is acknowledged, a half-written one must have been a trip, because an
 * acknowledgement is only written after the trip it belongs to. */
void trips_init(bool outlasted)
{
    struct record found[SLOTS];
    bool whole[SLOTS], torn = false;
    for (uint8_t slot = 0; slot < SLOTS; slot++) {
        bool used = read_slot(slot, &found[slot]);
        whole[slot] = found[slot].count && found[slot].crc == check(&found[slot]);
        torn = torn || (used && !whole[slot]);
    }
    newest = whole[1] && (!whole[0] || found[1].count == after(found[0].count));
    struct record kept = whole[newest] ? found[newest] : (struct record){0};
    count = kept.count;
    is_seen = false;

    uint8_t cause = cause_before();
    bool remembered = outlasted && last.crc == check(&last);
    if (outlasted && was_armed()) {
        note(cause ? cause : RESTARTED, alive.at);
    } else if (cause > STOP_BYTE_SEEN && !(remembered && is_open(&last) && last.cause == cause)) {
        note(cause, alive.at);
    } else if (remembered && (last.cause != kept.cause || last.at != kept.at)) {
        note(last.cause, last.at);
    } else if (torn && !is_open(&kept)) {
        note(REASON_LOST, 0);
    } else {
        last = kept;
        step = DONE;
    }
    alive.at = alive.inverse = 0;
    tenth_us = 0; /* the clock starts from 0 a little later */
}

struct trip trips_last(void)
{
    return (struct trip){last.cause & (uint8_t)~ACKNOWLEDGED, is_open(&last), last.at};
}

void trips_look(void)
{
    bool armed = was_armed();
    uint8_t state, cause;
    uint32_t at = alive.at;
    for (; clock_us() - tenth_us >= TENTH_US; tenth_us += TENTH_US)
        at++;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        state = safety_now()->state;
        cause = safety_now()->cause;
    }
    /* Hosts also send stop bytes to be safe: without arming that is no trip. */
    if (state == STOPPED && !is_seen && (armed || cause != STOP_BYTE_SEEN))
        note(cause, at);
    is_seen = state == STOPPED;
    alive.at = at;
    alive.inverse = state == ARMED ? ~at : at;
}

void trips_acknowledge(void)
{
    if (is_open(&last))
        note(last.cause | ACKNOWLEDGED, last.at);
}

void trips_follow(void)
{
    trips_look();
    while (step < DONE && store_is_ready()) {
        uint8_t at = (COUNT + step) % sizeof(struct record), place = PLACE(!newest) + at;
        uint8_t byte = step ? ((const uint8_t *)&last)[at] : 0;
        if (++step == DONE) {
            newest = !newest;
            count = last.count;
        }
        if (store_read(place) != byte)
            store_write(place, byte);
    }
}
