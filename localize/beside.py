"""Recognition beside the odometry: what takes tenths of a second must not hold up a scan."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

from localize.keyframes import Keyframe

Seen = TypeVar("Seen")


class RecognitionBeside(Generic[Seen]):
    """Looks at keyframes in a thread of its own, one after the other.

    A result counts from a fixed number of scans after its keyframe on, however soon it was there, and is waited for if
    it is late: so a recording gives the same bytes on every machine, and no more keyframes wait than came meanwhile.

    Parameters
    ----------
    lag_scans : that number; 0 looks at once, in the caller's thread.
    """

    def __init__(self, lag_scans: int) -> None:
        self.lag_scans = lag_scans
        self._thread = ThreadPoolExecutor(1, "recognition") if lag_scans else None
        self._waiting: deque[tuple[int, Keyframe, Future[Seen]]] = deque()

    def look(self, keyframe: Keyframe, scan: int, recognised: Callable[[], Seen]) -> None:
        """Have a keyframe looked at by ``recognised``; it came with scan number ``scan``."""
        result: Future[Seen]
        if self._thread is not None:
            result = self._thread.submit(recognised)
        else:
            result = Future()
            result.set_result(recognised())
        self._waiting.append((scan + self.lag_scans, keyframe, result))

    def due(self, scan: int | None = None) -> list[tuple[Keyframe, Seen]]:
        """Keyframes whose results count by scan number ``scan``, oldest first; all that wait without a number."""
        found = []
        while self._waiting and (scan is None or self._waiting[0][0] <= scan):
            _, keyframe, result = self._waiting.popleft()
            found.append((keyframe, result.result()))
        return found

    def close(self) -> None:
        """End the thread."""
        if self._thread is not None:
            self._thread.shutdown()
