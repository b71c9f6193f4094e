"""A localizer on a live stream: drivers hand measurements over and go on, a thread of its own does the work."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from queue import Empty, Full, Queue
from threading import Lock, Thread

import numpy as np

from localize.localizer import Localizer
from localize.results import LocalizationResult, Update
from semmap.measurements import Measurement, Scan

_WAITING = 20_000
"""Measurements that may wait: some minute of all of them but scans."""


class LiveLocalizer:
    """Feeds a `Localizer` from a thread.

    Measurements are worked through in the order in which `add` was called, from any thread. What comes faster than that
    waits; when too many scans wait the newest is dropped and counted, so that poses never come late by more.

    Parameters
    ----------
    localizer : not to be touched by anybody else until `close`.
    on_update : called in the thread with each update.
    max_scans : scans that may wait.
    """

    def __init__(
        self, localizer: Localizer, on_update: Callable[[Update], None] | None = None, *, max_scans: int = 5
    ) -> None:
        self._localizer, self._on_update, self.max_scans = localizer, on_update, max_scans
        self._queue: Queue[tuple[Measurement, float] | None] = Queue(_WAITING)
        self._lock = Lock()
        self._scans_waiting = 0
        self._error: Exception | None = None
        self._arrived: dict[int, float] = {}
        self.latency_s: list[float] = []
        """From a scan's arrival to its update."""
        self.dropped_scans = self.dropped_others = 0
        self._thread = Thread(target=self._work, name="localizer", daemon=True)
        self._thread.start()

    def add(self, measurement: Measurement) -> bool:
        """Hand a measurement over; returns whether it was taken. Raises what the localizer raised, if it did."""
        if self._error is not None:
            raise self._error
        scan = isinstance(measurement, Scan)
        with self._lock:
            if scan and self._scans_waiting >= self.max_scans:
                self.dropped_scans += 1
                return False
            try:
                self._queue.put_nowait((measurement, time.monotonic()))
            except Full:
                self.dropped_scans += scan
                self.dropped_others += not scan
                return False
            self._scans_waiting += scan
        return True

    def close(self) -> LocalizationResult:
        """End the stream: work off what waits, and hand everything over. Raises what the localizer raised."""
        self._queue.put(None)
        self._thread.join()
        if self._error is not None:
            raise self._error
        result = self._localizer.finish()
        return replace(result, summary={**result.summary, **self._figures()})

    def _work(self) -> None:
        while (waiting := self._queue.get()) is not None:
            measurement, arrived = waiting
            if isinstance(measurement, Scan):
                self._arrived[measurement.end_ns] = arrived
            try:
                update = self._localizer.add(measurement)
                if update is not None:
                    self._note(update)
            except Exception as error:  # handed to whoever adds next
                self._error = error
                self._drain()
                return
            if isinstance(measurement, Scan):
                with self._lock:
                    self._scans_waiting -= 1

    def _note(self, update: Update) -> None:
        arrived = self._arrived.get(update.stamp_ns)
        if arrived is not None:
            self.latency_s.append(time.monotonic() - arrived)
        self._arrived = {end_ns: at for end_ns, at in self._arrived.items() if end_ns > update.stamp_ns}
        if self._on_update is not None:
            self._on_update(update)

    def _drain(self) -> None:
        """Nobody works any more: nothing shall wait for it."""
        try:
            while True:
                self._queue.get_nowait()
        except Empty:
            return

    def _figures(self) -> dict[str, float | int | None]:
        """For the summary."""
        found: dict[str, float | None] = {}
        for name, percent in (("median", 50), ("p95", 95), ("max", 100)):
            milliseconds = 1e3 * np.percentile(self.latency_s, percent) if self.latency_s else None
            found[f"latency_ms_{name}"] = None if milliseconds is None else round(float(milliseconds), 1)
        return {**found, "live_scans_dropped": self.dropped_scans, "live_others_dropped": self.dropped_others}
