"""Engines: the same results in the same order in this process and on a cluster, and clear words when one fails."""

from __future__ import annotations

import builtins
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from maps import engine as engines
from maps.engine import Engine, engine
from semmap.errors import BuildError, CloudError


def slowly_squared(x: int) -> int:
    time.sleep(0.01 * (x % 3))
    return x * x


def refusing(x: int) -> int:
    if x == 3:
        raise CloudError("shows no floor", file="a.laz", mend="scan it")
    return x


def failing(x: int) -> int:
    return 1 // (x - 2)


def dying(x: int) -> int:
    os._exit(9)


@pytest.fixture(scope="module")
def two() -> Iterator[Engine]:
    with engine(2) as found:
        yield found


@pytest.fixture(params=["this process", "two workers"])
def any_engine(request: pytest.FixtureRequest, two: Engine) -> Engine:
    return engines.ThisProcess() if request.param == "this process" else two


class TestAnyEngine:
    def test_results_come_in_order(self, any_engine: Engine) -> None:
        assert list(any_engine.map(slowly_squared, range(23))) == [x * x for x in range(23)]
        assert list(any_engine.map(slowly_squared, [])) == []

    def test_our_errors_come_out_as_they_are(self, any_engine: Engine) -> None:
        results = any_engine.map(refusing, range(9))
        assert [next(results) for _ in range(3)] == [0, 1, 2]
        with pytest.raises(CloudError, match=r"^a\.laz: shows no floor; scan it$") as caught:
            next(results)
        assert (caught.value.file, caught.value.what, caught.value.mend) == ("a.laz", "shows no floor", "scan it")

    def test_faults_come_out_as_they_are(self, any_engine: Engine) -> None:
        with pytest.raises(ZeroDivisionError):
            list(any_engine.map(failing, range(5)))

    def test_paths_that_are_there_are_seen(self, any_engine: Engine, tmp_path: Path) -> None:
        any_engine.check_sees([tmp_path])


def test_a_worker_that_does_not_see_a_path_is_named(two: Engine, tmp_path: Path) -> None:
    with pytest.raises(BuildError, match=r"^worker tcp://.*: does not see .*nothing; keep maps and output on a file"):
        two.check_sees([tmp_path, tmp_path / "nothing"])


def test_a_worker_with_another_semmap_is_named(two: Engine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("semmap.__version__", "99.0")
    with pytest.raises(BuildError, match=r"runs semmap .*, this is 99\.0; install the same"):
        two.check_sees([tmp_path])


def test_workers_that_die_again_and_again_end_the_build() -> None:
    with engine(2) as found, pytest.raises(BuildError, match="a worker: died several times at the same part"):
        list(found.map(dying, range(2)))


def test_without_dask_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *args: object, **kwargs: object) -> object:
        if name.split(".")[0] in ("dask", "distributed"):
            raise ImportError(name)
        return real(name, *args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(BuildError, match=r"Dask is not installed; pip install 'dask\[distributed\]'"), engine(2):
        pass
    with engine(1) as found:
        assert list(found.map(abs, [-1])) == [1]


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense://a", "tcp://no.such.host.invalid:8786"])
def test_a_scheduler_that_does_not_answer(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "_CONNECT_S", 1.0)
    with pytest.raises(BuildError, match=r"does not answer .*check --scheduler"), engine(scheduler=address):
        pass


@pytest.fixture
def scheduler() -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A scheduler in a process of its own, without workers."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port)]
    process = subprocess.Popen([*command, "--no-dashboard"], stderr=subprocess.DEVNULL, env=_paths())
    while not _answers(port):
        time.sleep(0.05)
    yield f"tcp://127.0.0.1:{port}", process
    process.kill()
    process.wait()


def test_a_scheduler_of_ones_own(
    scheduler: tuple[str, subprocess.Popen[bytes]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """It works with the workers it is given, says when there are none, and when it is lost."""
    address, process = scheduler
    monkeypatch.setattr(engines, "_CONNECT_S", 2.0)
    with engine(scheduler=address) as found:
        with pytest.raises(BuildError, match="the scheduler: has no workers; start some with `dask worker`"):
            found.check_sees([tmp_path])
        monkeypatch.setattr(engines, "_CONNECT_S", 30.0)
        command = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--no-nanny", "--nthreads", "1"]
        worker = subprocess.Popen([*command, "--no-dashboard"], stderr=subprocess.DEVNULL, cwd=tmp_path, env=_paths())
        try:
            found.check_sees([tmp_path])
            assert list(found.map(slowly_squared, range(5))) == [0, 1, 4, 9, 16]
            monkeypatch.setattr(engines, "_LOOK_S", 0.2)
            monkeypatch.setattr(engines, "_PATIENCE", 3)
            results = found.map(time.sleep, [0.01, 60.0])
            next(results)
            worker.send_signal(signal.SIGKILL)
            with pytest.raises(BuildError, match="has lost all its workers; run the same command again"):
                next(results)
        finally:
            worker.kill()
            worker.wait()
        process.kill()
        with pytest.raises(BuildError, match=r"the scheduler: (was lost|has lost)"):
            list(found.map(slowly_squared, range(3)))


def _paths() -> dict[str, str]:
    """The environment of a worker that can import what these tests send it."""
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}


def _answers(port: int) -> bool:
    with socket.socket() as knock:
        return knock.connect_ex(("127.0.0.1", port)) == 0
