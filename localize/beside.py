"""Recognition beside the odometry: what takes tenths of a second must not hold up a scan."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor

from localize.keyframes import Keyframe, stacked
from localize.matcher import Expected, IntersectionMatcher, Sight


class RecognitionBeside:
    """Runs the matcher in a thread of its own, one keyframe after the other.

    A result counts from a fixed number of scans after its keyframe on, however soon it was there, and is waited for if
    it is late: so a recording gives the same bytes on every machine, and no more keyframes wait than came meanwhile.

    Parameters
    ----------
    matcher : the nine steps. lag_scans : that number; 0 runs them at once, in the caller's thread.
    """

    def __init__(self, matcher: IntersectionMatcher, lag_scans: int) -> None:
        self._matcher, self.lag_scans = matcher, lag_scans
        self._thread = ThreadPoolExecutor(1, "recognition") if lag_scans else None
        self._waiting: deque[tuple[int, Keyframe, Future[list[Sight]]]] = deque()

    def look(
        self, keyframes: Sequence[Keyframe], track: Expected | None, others: Sequence[Expected], scan: int
    ) -> None:
        """Look at the last of some keyframes, which came with scan number ``scan``, as `recognise` does."""

        def recognised() -> list[Sight]:
            return self._matcher.recognise(stacked(keyframes), keyframes[-1], track, others)

        result: Future[list[Sight]]
        if self._thread is not None:
            result = self._thread.submit(recognised)
        else:
            result = Future()
            result.set_result(recognised())
        self._waiting.append((scan + self.lag_scans, keyframes[-1], result))

    def due(self, scan: int | None = None) -> list[tuple[Keyframe, list[Sight]]]:
        """Keyframes whose results count by scan number ``scan``, oldest first; all that wait without a number."""
        found = []
        while self._waiting and (scan is None or self._waiting[0][0] <= scan):
            _, keyframe, result = self._waiting.popleft()
            found.append((keyframe, result.result()))
        return found

    def forget(self) -> None:
        """What waits no longer counts, and what was seen is no longer where it was: odom begins anew."""
        self.due()
        self._matcher.forget()

    def close(self) -> None:
        """End the thread."""
        if self._thread is not None:
            self._thread.shutdown()
