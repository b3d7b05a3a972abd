"""The command ``djpt worker``."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from typing import Any

import click

from djpt.apps.cli.console import Command, require_positive
from djpt.core.files import reason
from djpt.core.interruption import Terminated, end_at_once
from djpt.errors import RenderError

__all__ = ["command"]

CONNECTION_SECONDS = 6.0
"""The time that a scheduler has to answer a new worker."""

LEAVING_SECONDS = 10.0
"""The time that it has to take over the results of a leaving worker."""

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@click.command("worker", cls=Command)
@click.argument("scheduler", metavar="ADDRESS")
@click.option("--threads", type=int, help="Number of rendering threads. Default: all processors.")
@click.option("--name", help="The worker's name on the dashboard.")
def command(
    scheduler: str,
    threads: int | None,
    name: str | None,
) -> None:
    """Run a worker of a cluster.

    ADDRESS is the address of its scheduler, such as tcp://host:8786.

    On SIGINT or SIGTERM the worker hands over its results and exits; a second signal ends it at once. TLS is configured
    through Dask.
    """
    require_positive(threads=threads)
    if not scheduler.strip():
        raise RenderError("ADDRESS must be that of a scheduler, such as tcp://host:8786; found ''")
    import drjit as dr

    from djpt.apps.cluster.work import distributed  # also the code of its tasks, before they come

    worker = distributed().Worker
    if threads is not None:
        dr.set_thread_count(threads)

    async def start() -> None:
        # One task at a time: Dr.Jit's threads share each of them.
        await work(worker(scheduler, nthreads=1, name=name, death_timeout=CONNECTION_SECONDS))

    try:
        asyncio.run(start())
    except asyncio.TimeoutError:
        raise RenderError(
            f"can't work for '{scheduler}': no scheduler has answered in {CONNECTION_SECONDS:g} s"
        ) from None
    except (OSError, ValueError, TypeError) as error:
        raise RenderError(f"can't work for '{scheduler}': {error}") from None
    except RuntimeError as error:  # by which distributed hides why a worker hasn't started
        cause = error.__cause__
        why = reason(cause) if isinstance(cause, OSError) else "the server at this address isn't a scheduler"
        raise RenderError(f"can't work for '{scheduler}': {why}") from None


async def work(worker: Any) -> None:
    """Run a worker until it ends or a signal arrives; a signal that arrives during startup ends it, too."""
    signals: asyncio.Queue[int] = asyncio.Queue()

    def note(number: int) -> None:
        if not signals.empty() or leaving:
            end_at_once()
        signals.put_nowait(number)

    leaving = False
    for number in SIGNALS:
        asyncio.get_running_loop().add_signal_handler(number, note, number)
    signalled = asyncio.ensure_future(signals.get())
    starting = asyncio.ensure_future(worker.start())
    await asyncio.wait({starting, signalled}, return_when=asyncio.FIRST_COMPLETED)
    if not starting.done():
        leaving = True
        starting.cancel()
        await asyncio.wait({starting})
        await worker.close(timeout=0, executor_wait=False)
        raise KeyboardInterrupt if signalled.result() == signal.SIGINT else Terminated("terminated")
    starting.result()
    working = asyncio.ensure_future(worker.finished())
    await asyncio.wait({working, signalled}, return_when=asyncio.FIRST_COMPLETED)
    if not working.done():
        leaving = True
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(worker.close_gracefully(), LEAVING_SECONDS)
        await worker.close()
    signalled.cancel()
