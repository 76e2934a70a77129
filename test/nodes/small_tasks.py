"""Tasks for a worker's process, which imports this module."""

import os
import signal

from sma_bench.compiled import threads_to_spare


def too_large(settings, parameters, tell):
    tell(0.5, f"{settings} {parameters.given} {parameters.given_uncertainty}")
    return str(len(bytearray(1 << 46)))


def vanishes(settings, parameters, tell):
    os.kill(os.getpid(), signal.SIGKILL)


def urgency(settings, parameters, tell):
    return f"{os.sched_getscheduler(0)} {os.getpriority(os.PRIO_PROCESS, 0)}"


def threads(settings, parameters, tell):
    return str(threads_to_spare())
