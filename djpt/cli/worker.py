"""The command ``djpt worker``."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path

import click

from djpt.cli.console import Command, require_positive
from djpt.errors import BackendError, RenderError

__all__ = ["command"]


@click.command("worker", cls=Command)
@click.argument("scheduler", metavar="ADDRESS")
@click.option("--threads", type=int, help="Threads that render. Default: all processors.")
@click.option("--name", help="The worker's name on the dashboard.")
@click.option("--tls-ca-file", type=click.Path(path_type=Path), help="TLS: the certificates of who signs.")
@click.option("--tls-cert", type=click.Path(path_type=Path), help="TLS: the worker's certificate.")
@click.option("--tls-key", type=click.Path(path_type=Path), help="TLS: the worker's key.")
def command(
    scheduler: str,
    threads: int | None,
    name: str | None,
    tls_ca_file: Path | None,
    tls_cert: Path | None,
    tls_key: Path | None,
) -> None:
    """Work for the cluster whose scheduler has ADDRESS, such as tcp://host:8786.

    SIGINT and SIGTERM let the worker hand on what it has and leave.
    """
    require_positive(threads=threads)
    try:
        from distributed import Worker
        from distributed.security import Security
    except ImportError:
        raise BackendError("clusters need the package 'distributed': pip install 'djpt[cluster]'") from None
    import drjit as dr

    import djpt.cluster.work  # noqa: F401 (compiles nothing later than it must)

    if threads is not None:
        dr.set_thread_count(threads)
    security = None
    if tls_ca_file or tls_cert or tls_key:
        files = {"tls_ca_file": tls_ca_file, "tls_worker_cert": tls_cert, "tls_worker_key": tls_key}
        named = {key: str(file) for key, file in files.items() if file is not None}
        security = Security(require_encryption=True, **named)  # type: ignore[no-untyped-call]

    async def work() -> None:
        # One task at a time: Dr.Jit's threads share each of them.
        async with Worker(scheduler, nthreads=1, name=name, security=security) as worker:
            loop = asyncio.get_running_loop()
            for number in (signal.SIGINT, signal.SIGTERM):
                loop.add_signal_handler(number, lambda: asyncio.ensure_future(worker.close_gracefully()))
            await worker.finished()

    try:
        asyncio.run(work())
    except (OSError, ValueError, TypeError) as error:
        raise RenderError(f"can't work for '{scheduler}': {error}") from None
