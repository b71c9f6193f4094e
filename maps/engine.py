"""Where the parts of a build are worked on: in this process, or by the workers of Dask.

The only file that knows Dask.
"""

from __future__ import annotations

import logging
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Protocol, TypeVar

import semmap
from semmap.errors import BuildError

Item = TypeVar("Item")
Result = TypeVar("Result")

_CONNECT_S = 15.0
_LOOK_S = 5.0  # how often to see whether workers are left while waiting for one
_PATIENCE = 12  # looks without a worker until the build gives up: a minute
_AHEAD = 2  # tasks queued for each thread
_AGAIN = "run the same command again, it goes on with what is finished"
_INSTALL = "install the same semmap there"
_OF_ITS_OWN = {
    "distributed.scheduler.allowed-failures": 1,
    "distributed.nanny.pre-spawn-environ.DASK_LOGGING__DISTRIBUTED": "critical",
}


class Engine(Protocol):
    """Works on the parts of a build."""

    def map(self, work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """``work`` of each item, in the order of the items.

        Raises what ``work`` raises; `BuildError` where the workers or the scheduler fail.
        """

    def check_sees(self, paths: Sequence[Path]) -> None:
        """Raise `BuildError` where a worker does not see one of the absolute ``paths``, or runs another semmap."""


class ThisProcess:
    """Works on one part after the other."""

    def map(self, work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        return map(work, items)

    def check_sees(self, paths: Sequence[Path]) -> None:
        pass


@contextmanager
def engine(workers: int = 1, scheduler: str | None = None) -> Iterator[Engine]:
    """The engine of a build.

    Parameters
    ----------
    workers : processes on this machine, one thread each; 1 is this process, without Dask.
    scheduler : address of a running Dask scheduler, such as ``tcp://10.0.0.1:8786``, instead of workers of its own.
        Maps and output must be on a file system that its workers share.

    Raises
    ------
    BuildError
        Where Dask is not installed or the scheduler does not answer.
    """
    if scheduler is None and workers == 1:
        yield ThisProcess()
        return
    _check_installed()
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # what matters of it becomes an error of ours
    with _on_this_machine(workers) if scheduler is None else _at(scheduler) as client:
        yield _Cluster(client)


def _check_installed() -> None:
    try:
        import distributed  # noqa: F401
    except ImportError:
        mend = "pip install 'dask[distributed]', or leave out --workers and --scheduler"
        raise BuildError("Dask is not installed", mend=mend) from None


@contextmanager
def _on_this_machine(workers: int) -> Iterator[Any]:
    """A client of so many worker processes, that end with the block."""
    import dask
    from distributed import Client, LocalCluster

    with ExitStack() as stack:
        stack.enter_context(dask.config.set(_OF_ITS_OWN))
        with _uninterrupted():
            cluster = stack.enter_context(LocalCluster(workers, threads_per_worker=1, dashboard_address=":0"))
        yield stack.enter_context(Client(cluster))


@contextmanager
def _at(scheduler: str) -> Iterator[Any]:
    """A client of a scheduler that runs already."""
    from distributed import Client

    try:
        client = Client(scheduler, timeout=_CONNECT_S)
    except (OSError, ValueError) as reason:
        what = f"does not answer ({str(reason).splitlines()[0]})"
        raise BuildError(what, file=scheduler, mend="check --scheduler, or start one with `dask scheduler`") from None
    with client:
        yield client


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Processes started in the block leave Ctrl-C to this one."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


class _Cluster:
    """Works on as many parts at once as a Dask cluster has threads."""

    def __init__(self, client: Any) -> None:
        self._client = client

    def map(self, work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        waiting: deque[Any] = deque()
        for item in items:
            while len(waiting) >= _AHEAD * max(1, self._threads()):
                yield self._result(waiting.popleft())
            waiting.append(self._client.submit(work, item, pure=False))
        while waiting:
            yield self._result(waiting.popleft())

    def check_sees(self, paths: Sequence[Path]) -> None:
        self._wait_for_workers()
        try:
            self._client.run_on_scheduler(_look, [])
            seen = self._client.run(_look, [str(path) for path in paths])
        except Exception as reason:  # it lacks semmap, or what semmap needs
            what = f"cannot run semmap ({type(reason).__name__}: {str(reason).splitlines()[0]})"
            raise BuildError(what, field="the scheduler or a worker", mend=_INSTALL) from None
        for worker, (version, missing) in seen.items():
            if version != semmap.__version__:
                what = f"runs semmap {version}, this is {semmap.__version__}"
                raise BuildError(what, field=f"worker {worker}", mend=_INSTALL)
            if missing:
                mend = "keep maps and output on a file system that all workers share"
                raise BuildError(f"does not see {missing[0]}", field=f"worker {worker}", mend=mend)

    def _threads(self) -> int:
        """Threads of all workers; 0 where there is no worker, or no scheduler to ask."""
        try:
            return sum(self._client.nthreads().values())
        except OSError:
            return 0

    def _wait_for_workers(self) -> None:
        try:
            self._client.wait_for_workers(1, timeout=_CONNECT_S)
        except Exception:
            raise BuildError("has no workers", field="the scheduler", mend="start some with `dask worker`") from None

    def _result(self, future: Any) -> Any:
        """What a task gives, or raises; a cluster that dies meanwhile is a `BuildError`."""
        from distributed import wait

        lonely = 0
        while not future.done():
            try:
                wait([future], timeout=_LOOK_S)
            except TimeoutError:
                lonely = 0 if self._threads() else lonely + 1
            if lonely > _PATIENCE:
                raise BuildError("has lost all its workers", field="the scheduler", mend=_AGAIN)
        return _outcome(future)


def _outcome(future: Any) -> Any:
    from distributed import CancelledError, KilledWorker

    try:
        return future.result()
    except KilledWorker:
        what = "died several times at the same part, perhaps for lack of memory"
        raise BuildError(what, field="a worker", mend=f"give fewer --workers or a smaller --tile; {_AGAIN}") from None
    except CancelledError:
        raise BuildError("was lost", field="the scheduler", mend=_AGAIN) from None


def _look(paths: Sequence[str]) -> tuple[str, list[str]]:
    """On a worker: its version of semmap, and those of the paths it does not see."""
    return semmap.__version__, [path for path in paths if not Path(path).exists()]
