"""The command ``djpt worker``."""

from __future__ import annotations

import asyncio
import signal

import click

from djpt.cli.console import Command, require_positive
from djpt.errors import BackendError, RenderError

__all__ = ["command"]


@click.command("worker", cls=Command)
@click.argument("scheduler", metavar="ADDRESS")
@click.option("--threads", type=int, help="Threads that render. Default: all processors.")
@click.option("--name", help="The worker's name on the dashboard.")
def command(
    scheduler: str,
    threads: int | None,
    name: str | None,
) -> None:
    """Work for a cluster.

    ADDRESS is that of its scheduler, such as tcp://host:8786.

    SIGINT and SIGTERM let the worker hand on what it has and leave. TLS is configured as Dask says.
    """
    require_positive(threads=threads)
    try:
        from distributed import Worker
    except ImportError:
        raise BackendError("clusters need the package 'distributed': pip install 'dask[distributed]'") from None
    import drjit as dr

    import djpt.cluster.work  # noqa: F401 (compiles nothing later than it must)

    if threads is not None:
        dr.set_thread_count(threads)

    async def work() -> None:
        # One task at a time: Dr.Jit's threads share each of them.
        async with Worker(scheduler, nthreads=1, name=name) as worker:
            loop = asyncio.get_running_loop()
            for number in (signal.SIGINT, signal.SIGTERM):
                loop.add_signal_handler(number, lambda: asyncio.ensure_future(worker.close_gracefully()))
            await worker.finished()

    try:
        asyncio.run(work())
    except (OSError, ValueError, TypeError) as error:
        raise RenderError(f"can't work for '{scheduler}': {error}") from None
