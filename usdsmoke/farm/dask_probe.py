"""A program of its own that finds out whether a Dask scheduler answers at an address.

Dask believes whatever answers: it takes an HTTP server's greeting for a length and asks for that
much memory, or waits for ever. Here that costs a process that its parent gives up after a while.
``ready`` comes first on stdout, when the clock may start, then ``scheduler``, or what is wrong.
"""

import os
import sys

__all__ = ["main"]

_MEMORY = 2 << 30  # bytes of address space; Dask's client takes 0.3 GiB of it


def main(address: str, patience: float) -> None:
    """Say what answers at an address, and end without a word on stderr.

    Args:
        address: of a scheduler, ``tcp://HOST:PORT``.
        patience: seconds for it to answer.
    """
    from distributed import Client

    _limit_memory()
    print("ready", flush=True)
    try:
        client = Client(address, timeout=patience, set_as_default=False)
        client.nthreads()
        found = "scheduler"
    except OSError as error:
        found = " ".join(str(error).split())[:200] or type(error).__name__
    except BaseException:  # whatever Dask makes of the words of somebody else
        found = "something else answers there"
    print(found, flush=True)
    os._exit(0)  # closing a connection that never was may take for ever


def _limit_memory() -> None:
    try:
        import resource

        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        limit = _MEMORY if hard == resource.RLIM_INFINITY else min(_MEMORY, hard)
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    except (ImportError, OSError, ValueError):  # Windows, or a system that does not set it
        return


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
