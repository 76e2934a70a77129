"""Every case of a set put to one program; what is answered stays answered."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from functools import partial
from pathlib import Path

from sma_bench.blind.examinee import Examinee, Given
from sma_bench.blind.kept import is_kept, keep, read_kept

# Called with the number of cases done so far and the last one's failure line, "" if it answered.
Report = Callable[[int, str], None]


def open_cases(cases: Sequence[str], answers: Path, again: bool = False) -> list[str]:
    """The cases that have no answer yet.

    Args:
        cases: names of all.
        answers: folder of the examinee.
        again: whether a failed case counts as open.
    """
    waiting = [case for case in cases if not is_kept(answers, case)]
    if again:
        kept = (case for case in cases if is_kept(answers, case))
        waiting += [case for case in kept if read_kept(answers, case).answer is None]
    return sorted(waiting)


def examine(
    examinee: Examinee,
    cases: Sequence[str],
    folder: Path,
    answers: Path,
    jobs: int = 1,
    report: Report = lambda done, line: None,
) -> None:
    """Put `cases` to a program, `jobs` at a time, and keep each answer as soon as it is there.

    Interrupted, it ends the running programs and leaves their cases open.

    Args:
        cases: names below `folder`.
        answers: folder of the examinee.
        report: told after each case.

    Raises:
        InputError: a case cannot be read or an answer not be written.
    """
    ask = {case: partial(examinee.ask, folder / case) for case in cases}
    ask_all(examinee, ask, answers, jobs, report)


def ask_all(
    examinee: Examinee,
    ask: Mapping[str, Callable[[], Given]],
    answers: Path,
    jobs: int,
    report: Report,
) -> None:
    """Do every call of `ask`, and keep what it gives under its name in `answers`."""
    waiting = list(ask)[::-1]
    running: dict[Future[Given], str] = {}
    done = 0
    with ThreadPoolExecutor(jobs) as pool:
        try:
            while waiting or running:
                while waiting and len(running) < jobs:
                    case = waiting.pop()
                    running[pool.submit(ask[case])] = case
                finished, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in finished:
                    case, given = running.pop(future), future.result()
                    keep(answers, case, given.result, given.line, given.seconds, given.improved)
                    done += 1
                    report(done, f"{case}: {given.line}" if given.line else "")
        except BaseException:
            examinee.stop()
            raise
