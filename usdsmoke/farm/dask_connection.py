"""The connection to a Dask scheduler: tried out first, quiet, and lost under one name."""

import asyncio
import gc
import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from usdsmoke.base.errors import ClusterError

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["asking", "connected", "lost"]

_CONNECT_S = 5.0  # for the scheduler to answer
_PROBE_S = 10.0  # for all of the first try, whatever answers
_CLOSE_S = 3.0
_PROBE = Path(__file__).with_name("dask_probe.py")
_LOUD = ("distributed", "tornado")  # loggers that tell of a lost connection, at length


@contextmanager
def connected(address: str) -> "Iterator[Client]":
    """A client of the scheduler at an address.

    Args:
        address: ``tcp://HOST:PORT``, or another protocol of Dask's.

    Raises:
        ClusterError: Dask is not installed, or no scheduler answers there; within seconds,
            whatever answers.
    """
    try:
        from distributed import Client
    except ImportError:
        raise ClusterError(
            "--cluster needs the package distributed, which is not installed; "
            'install it with: pip install "usdsmoke[cluster]"'
        ) from None
    if "://" not in address:
        raise ClusterError(f"the cluster {address!r} has no protocol; wanted tcp://HOST:PORT")
    found = _what_answers(address)
    if found != "scheduler":
        raise _no_scheduler(address, found)
    with _quiet():
        client, reason = None, ""
        try:
            client = Client(address, timeout=_CONNECT_S, set_as_default=False)
        except Exception as error:
            reason = " ".join(str(error).split())[:200]
        if client is None:
            # What is left of it ends now: at the beginning of another one its end would wait
            # for ever.
            gc.collect()
            raise _no_scheduler(address, reason)
        # Exceptions that nobody has fetched are told of later, when they are garbage.
        loop = getattr(client.loop, "asyncio_loop", None)
        if loop is not None:
            loop.set_exception_handler(lambda loop, context: None)
        try:
            with client.as_current():
                yield client
        finally:
            with suppress(Exception):  # a scheduler that is gone cannot be taken leave of
                client.close(timeout=_CLOSE_S)


@contextmanager
def asking(limited: bool = False) -> Iterator[None]:
    """Whatever goes wrong between this process and the scheduler is a lost connection.

    For calls of the client only: errors of tasks and of this program have names of their own.

    Args:
        limited: the call has a limit of time of its own.

    Raises:
        ClusterError: the scheduler is gone; finished windows are kept.
        TimeoutError: the call's own limit was reached.
    """
    try:
        yield
    except (Exception, asyncio.CancelledError) as error:
        if limited and isinstance(error, TimeoutError):
            raise
        raise lost("the Dask scheduler is gone, or has dropped the run") from None


def lost(what: str) -> ClusterError:
    """The end of a run that can be taken up again.

    Args:
        what: happened, the beginning of a sentence.
    """
    return ClusterError(
        f"{what}; finished windows are kept: run the same command again, which goes on from there"
    )


def _no_scheduler(address: str, reason: str) -> ClusterError:
    return ClusterError(
        f"no Dask scheduler answers at {address} ({reason}); start "
        "one with 'dask scheduler', or check host, port and firewall"
    )


def _what_answers(address: str) -> str:
    """``scheduler``, or what is wrong, from a process that may die of it."""
    search = os.pathsep.join(entry for entry in sys.path if entry)
    process = subprocess.Popen(
        [sys.executable, "-P", str(_PROBE), address, str(_CONNECT_S)],
        env={**os.environ, "PYTHONPATH": search},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    try:
        process.stdout.readline()  # loading Dask takes its time on a busy machine
        told, _ = process.communicate(timeout=_PROBE_S)
        return told.strip() or "something else answers there"
    except subprocess.TimeoutExpired:
        return f"what is there does not answer as one within {_PROBE_S:.0f} s"
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


@contextmanager
def _quiet() -> Iterator[None]:
    """Without the tracebacks that Dask logs when a connection breaks; the error says it all."""
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in _LOUD]
    found = [logging.getLogger(name) for name in names]
    before = [logger.disabled for logger in found]
    for logger in found:
        logger.disabled = True
    try:
        yield
    finally:
        for logger, was in zip(found, before, strict=True):
            logger.disabled = was
