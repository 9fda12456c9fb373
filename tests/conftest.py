"""What all tests share: Hypothesis's patience, and the event loop (`virtual_time`: it leaps to its next timer)."""

import asyncio
import gc
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Generator, Mapping
from contextlib import suppress
from pathlib import Path
from types import FrameType

import async_solipsism
import pytest
from hypothesis import HealthCheck
from hypothesis import settings as hypothesis_settings

from tests.support import runs, schedule
from tests.support.runs import Run
from tests.support.schedule import skip_where_lacking

# A busy machine is no fault of the code under test: what may not take long has a test of its own, with a bound.
hypothesis_settings.register_profile(
    "any machine", hypothesis_settings(), deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
hypothesis_settings.register_profile("quick", hypothesis_settings.get_profile("any machine"), max_examples=20)
hypothesis_settings.load_profile("any machine")
_NICE = os.getpriority(os.PRIO_PROCESS, 0)
_MEMORY = "/dev/shm"  # noqa: S108  where Linux keeps what is in memory


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--shuffle", type=int, metavar="SEED", help="files, and tests within each file, in random order")


def pytest_configure(config: pytest.Config) -> None:
    # A person's shell sets none of these, and development machines do: unbuffered output and a locale hid faults. A
    # start takes twice as long without bytecode.
    for name in [name for name in os.environ if name.startswith(("PYTHON", "LANG", "LC_"))]:
        del os.environ[name]
    sys.dont_write_bytecode = False
    if config.pluginmanager.hasplugin("xdist"):
        config.pluginmanager.import_plugin("tests.support.workers")
    # What `nohup`, or a shell's `&`, lets a program ignore is undone: tests send these signals.
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGQUIT):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
    _let_signals_interrupt()
    _keep_rings(config)
    config.add_cleanup(Run().close)  # what fixtures leave behind: xdist kills a worker some seconds after the signal


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Keep what is collected to the end, so that no garbage collection visits it (pytest's hook)."""
    gc.disable()
    result = yield
    gc.freeze()
    gc.enable()
    return result


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    _let_signals_interrupt()  # asyncio gives a signal back its default behind a loop that had it
    skip_where_lacking(item)


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Fail a test whose process keeps a priority ahead of all others, which would make these wait (pytest's hook)."""
    if nextitem is None or nextitem.path != item.path:
        for ring in Path(os.environ["XDG_RUNTIME_DIR"]).glob("hexapod-gateway-*"):
            with suppress(OSError):  # another user's
                ring.unlink()
    if os.sched_getparam(0).sched_priority or os.getpriority(os.PRIO_PROCESS, 0) < _NICE:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.setpriority(os.PRIO_PROCESS, 0, _NICE)
        pytest.fail("this test leaves its process ahead of all others")


def _keep_rings(config: pytest.Config) -> None:
    """Give this process a folder for black boxes, and remove it at the end.

    A black box outlives its gateway, so a run of all tests would leave gigabytes of memory in use.
    """
    around = os.environ["XDG_RUNTIME_DIR"] if "PYTEST_XDIST_WORKER" in os.environ else _MEMORY
    folder = Path(tempfile.mkdtemp(prefix="hexapod-tests-", dir=around if os.access(around, os.W_OK) else None))
    folder.chmod(0o1777)  # also for gateways of other users
    os.environ["XDG_RUNTIME_DIR"] = str(folder)
    config.add_cleanup(lambda: shutil.rmtree(folder, ignore_errors=True))


def _let_signals_interrupt() -> None:
    """Let SIGTERM, and the end of the terminal, raise KeyboardInterrupt as Ctrl-C does."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _interrupt)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: None)  # once is enough
    raise KeyboardInterrupt


def pytest_asyncio_loop_factories(
    config: pytest.Config, item: pytest.Item
) -> Mapping[str, Callable[[], asyncio.AbstractEventLoop]]:
    del config
    if item.get_closest_marker("virtual_time"):
        return {"virtual": async_solipsism.EventLoop}
    return {"real": asyncio.new_event_loop}


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    return schedule.is_elsewhere(collection_path, config.option.markexpr) or None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    schedule.arrange(items)
    if config.option.shuffle is not None:
        schedule.shuffle(items, config.option.shuffle)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    runs.add(report)
