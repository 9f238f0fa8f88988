"""Lines that say how far a computation is, and how long it will still take."""

import time
from typing import TextIO


class Progress:
    """Prints a line every few seconds; nothing for what takes less.

    Parameters
    ----------
    stream : text stream or None
        Receives the lines; None for none.
    """

    QUIET_SECONDS = 2.0         # before the first line and between two lines

    def __init__(self, stream: TextIO | None) -> None:
        self.stream = stream
        self._start = self._shown = time.monotonic()

    def __call__(self, words: str, share: float) -> None:
        """Take note of how far it is, in words, and of the share in (0, 1] that is done."""
        now = time.monotonic()
        if self.stream is None or now - self._shown < self.QUIET_SECONDS:
            return
        self._shown = now
        print(f"{words}: {share:.0%}, {(now - self._start) * (1 - share) / share:.0f} s to go", file=self.stream, flush=True)
