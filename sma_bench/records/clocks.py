"""Clocks of tables: starts that the user states, and several clocks put on one."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.records import cells
from sma_bench.records.tables import Column, TableFile

DAY, _EPOCHS = 86_400.0, (1e9, 2.0**31)  # s; of clocks that count from 1970


def started(table: TableFile, stated: Mapping[str, str]) -> TableFile:
    """The table with clocks that show 0, or begin if they have dates, when the user says: a date, a
    time of day, or s after the first time of the others. InputError: no such clock or time."""
    zeros = {c.name: _zero(c, 1.0) for c in table.columns if c.name not in stated and (
        c.fields or "time" in cells.meanings(c.title, c.unit))}
    first = min((zero for zero in zeros.values() if zero is not None), default=0.0)
    made = dict.fromkeys((name for name, zero in zeros.items() if stated and zero is None), first)
    for name, text in stated.items():
        if moment := cells.moment_of(text):
            made[name] = float(np.nan_to_num(moment.days[0])) * DAY + (moment.seconds or 0.0)
        elif (delay := cells.plain_numbers([text])) is None:
            raise InputError(f"--start {name}: {text!r}, expected a date, a time of day or seconds")
        else:
            made[name] = first + float(delay[0])
    tables = [replace(t, columns=tuple(
        replace(c, start=made[c.name], values=c.values - (_zero(c, 1.0) or 0.0) * (c.start is None))
        if c.name in made else c for c in t.columns)) for t in table.tables]
    return replace(table, tables=tuple(tables))


def _zero(clock: Column, tick: float) -> float | None:
    """Epoch (s) of a clock's 0, or s after midnight; of its first row if it counts from 1970."""
    first = tick * float(next(iter(clock.values[np.isfinite(clock.values)]), np.nan))
    return first if clock.start is None and _EPOCHS[0] < first < _EPOCHS[1] else clock.start


def on_one_clock(table: TableFile,
                 ticks: Mapping[str, float]) -> tuple[dict[str, Array], float, list[str]]:
    """Times (n,) s of each clock of these units (s) on one clock, the epoch (s) of its 0 (0 without
    dates), and what is assumed. InputError: one has dates, another not, or they do not overlap."""
    columns = {c.name: c for c in table.columns if c.name in ticks}
    zeros = {name: _zero(column, ticks[name]) for name, column in columns.items()}
    own = {name: zero for name, zero in zeros.items() if zero is not None}
    base = min([zero for zero in own.values() if zero > DAY] or own.values(), default=0.0)
    times, notes, (first, *_) = dict[str, Array](), list[str](), [*columns, ""]
    for name, column in columns.items():
        times[name], zero = ticks[name] * column.values, zeros[name]
        if own and zero is None:
            undated = cells.message("undated", clock=name, other=next(iter(own)))
            raise InputError(f"{table.path}: {undated}")
        if zero is None:
            if table.is_joined and column.table != columns[first].table:
                notes.append(cells.message("at_once", clock=name, other=first))
            continue
        times[name] -= zero if column.start is None else 0.0  # it counts from 1970
        # A time of day is that of the nearest day.
        times[name] += zero - base + (DAY * round((base - zero) / DAY) if zero < DAY else 0.0)
    ends = {name: float(np.nanmax(time)) for name, time in times.items() if table.is_joined}
    other = min(ends, key=lambda name: ends[name], default="")
    for name in ends:
        if (gap := float(np.nanmin(times[name])) - ends[other]) > 0.0:
            apart = cells.message("apart", clock=name, other=other, gap=gap)
            raise InputError(f"{table.path}: {apart}")
    return times, base, notes
