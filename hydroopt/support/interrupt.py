"""Ctrl-C (SIGINT): who receives it, and when. No other module installs a handler or a mask."""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

_presses = 0
"""How often Ctrl-C was pressed since `remember`."""


def remember() -> None:
    """From now on Ctrl-C is remembered (`pressed`) besides raising KeyboardInterrupt; a second one ends the process.

    So it is not lost if a library that is being imported makes another error of it, or cannot pass it on.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        return
    usual = sys.unraisablehook

    def raised_again(error: Any) -> None:
        global _presses  # noqa: PLW0603
        if isinstance(error.exc_value, KeyboardInterrupt):  # in a finaliser or callback, which cannot raise
            _presses = 0
            again = threading.Timer(0.05, _send_again)
            again.daemon = True
            again.start()
        elif not _presses:
            usual(error)

    sys.unraisablehook = raised_again
    signal.signal(signal.SIGINT, _interrupt)


def _send_again() -> None:
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)  # which ends a system call
    else:  # Windows
        _thread.interrupt_main()


def pressed() -> bool:
    """Whether Ctrl-C was pressed since `remember`."""
    return _presses > 0


def _interrupt(_: int, __: FrameType | None) -> None:
    global _presses  # noqa: PLW0603
    _presses += 1
    if _presses > 1:
        if os.isatty(2):
            os.write(2, b"\x1b[?25h")  # a progress display hides the cursor
        os.write(2, b"hydroopt: interrupted\n")
        os._exit(130)
    raise KeyboardInterrupt


def end_at_once(code: int) -> None:
    """From now on Ctrl-C ends the process, which has done its work, with this exit code."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, lambda *_: os._exit(code))


@contextmanager
def blocked() -> Iterator[None]:
    """Deliver Ctrl-C only after this block; processes started within it never receive it, their parent stops them."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    from multiprocessing import resource_tracker  # noqa: PLC0415 (import cost)

    resource_tracker.ensure_running()  # which unblocks the signal in the thread that starts it
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def deferred() -> Iterator[Callable[[], bool]]:
    """Record Ctrl-C instead of raising KeyboardInterrupt; the function that is yielded says whether it was pressed.

    A search can then finish its step and keep its result, and no finaliser or callback swallows the exception. In
    another than the main thread nothing changes.

    >>> with deferred() as interrupted:
    ...     signal.raise_signal(signal.SIGINT)
    ...     print(interrupted())
    True
    """
    pressed = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield pressed.is_set
        return
    before = signal.signal(signal.SIGINT, lambda *_: pressed.set())
    try:
        yield pressed.is_set
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def delayed() -> Iterator[None]:
    """Deliver Ctrl-C after this block, which must be short.

    >>> with delayed():
    ...     print("before")
    before
    """
    interrupted: Callable[[], bool] = bool
    try:
        with deferred() as interrupted:
            yield
    finally:
        if interrupted():
            signal.raise_signal(signal.SIGINT)


def ignore() -> None:
    """Ignore Ctrl-C from now on, as a process does whose parent says when to stop."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
