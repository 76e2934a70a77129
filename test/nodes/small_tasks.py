"""Tasks for a worker's process, which imports this module."""

import os
import signal


def too_large(settings, parameters, tell):
    tell(0.5, f"{settings} {parameters.given} {parameters.given_uncertainty}")
    return str(len(bytearray(1 << 46)))


def vanishes(settings, parameters, tell):
    os.kill(os.getpid(), signal.SIGKILL)


def urgency(settings, parameters, tell):
    return f"{os.sched_getscheduler(0)} {os.getpriority(os.PRIO_PROCESS, 0)}"
