"""Signals that end a run: noted while it goes on, so that it ends where what was computed can be kept."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def noted_signals() -> Iterator[Callable[[], str]]:
    """Gives a function that returns the name of the signal that has come, SIGINT (Ctrl-C) or SIGTERM, empty before that.

    After the first, signals act as they did before, so that a second one ends the process. Signals reach Python in its main thread
    only; nothing is changed in others, or where such a signal is ignored.
    """
    come: list[str] = []
    before: dict[signal.Signals, object] = {}

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]

    def note(number: int, frame: FrameType | None) -> None:
        come.append(signal.Signals(number).name)
        restore()

    if threading.current_thread() is threading.main_thread():
        for number in SIGNALS:
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                before[number] = signal.signal(number, note)
    try:
        yield lambda: come[0] if come else ""
    finally:
        restore()
