"""Ctrl-C and SIGTERM that arrive inside a Zenoh callback on the main thread are delivered again.

Zenoh calls a callback in the thread that asks where nobody else has to answer. An exception in a callback is only
logged, so what a signal's handler raises there would be lost, and the program would go on.
"""

import logging
import os
import signal
import threading
from typing import Final

_SIGNALS: Final = {KeyboardInterrupt: signal.SIGINT, SystemExit: signal.SIGTERM}
"""What handlers raise, and for which signal."""
_AGAIN_S: Final = 0.01
"""Long after the callback has returned. A signal that meets another callback is delivered once more."""


def keep_signals() -> None:
    """Begin, for all sessions of this process. A second call changes nothing."""
    logging.getLogger("zenoh.handlers").addFilter(_is_no_signal)


def _is_no_signal(record: logging.LogRecord) -> bool:
    raised = record.exc_info[1] if record.exc_info else None
    for error, number in _SIGNALS.items():
        if isinstance(raised, error) and threading.current_thread() is threading.main_thread():
            again = threading.Timer(_AGAIN_S, os.kill, (os.getpid(), number))  # to the process: it ends a wait, too
            again.daemon = True
            again.start()
            return False
    return True
